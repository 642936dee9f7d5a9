# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports byte by byte, as the firmware's source has them, and both ends against each other."""

from dataclasses import replace
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.device import reports
from repousse.device.profile import builtin_links, builtin_profiles

LINKS = list(builtin_links().values())
SILENT = [link for profile in builtin_profiles().values() for link in profile.links if link.layout == "none"]

each_link = pytest.mark.parametrize("link", LINKS, ids=lambda link: link.name)
count = st.integers(-32768, 32767)
counts = st.tuples(count, count, count)


def the(name):
    return builtin_links()[name]


def test_currents_of_protocol_2():
    """A report number of 0, three milliamperes, command 0, no attributes; little-endian. hidapi returns 15."""
    written = reports.encode_currents(the("mbed-14"), (1.0, -0.5, 0.0254))
    assert written == bytes.fromhex("00 e803 0cfe 1900 0000 0000 0000 0000")


def test_currents_of_protocol_1():
    assert reports.encode_currents(the("mbed-8"), (-0.001, 3.0, 0.0)) == bytes.fromhex("00 ffff b80b 0000 0000")


def test_the_teensy_takes_64_bytes_of_the_same():
    written = reports.encode_currents(the("teensy-64"), (1.0, -0.5, 0.0254))
    assert written == bytes.fromhex("00 e803 0cfe 1900") + bytes(58)
    assert len(written) == 65


def test_home_of_protocol_2():
    """Command 1 with counters a to c as attributes; d to f, where the currents were, to zero."""
    assert reports.encode_home(the("mbed-14"), (0, 7700, -2)) == bytes.fromhex("00 0000 0000 0000 0100 0000 141e feff")


def test_protocol_1_cannot_be_told_its_home():
    assert reports.encode_home(the("mbed-8"), (0, 0, 6000)) is None


def test_input_of_protocol_2():
    """Encoders a to f, info. Encoder d over 5000 is the button, info 1 the calibration button."""
    link = the("mbed-14")
    plain = bytes.fromhex("0100 feff 0080 8813 0000 0700 0000")
    assert reports.decode(link, plain) == ((1, -2, -32768), False, False, None)
    pressed = bytes.fromhex("0100 feff 0080 8913 0000 0700 0100")
    assert reports.decode(link, pressed) == ((1, -2, -32768), True, True, None)
    assert reports.decode(replace(link, counted=True), pressed).counter == 7


def test_protocol_1_counts_the_other_way_round_and_numbers_its_reports():
    """Its firmware's table is the reverse of the later one's, and the later host negates what it counts."""
    report = reports.decode(the("mbed-8"), bytes.fromhex("0100 feff 7017 feff"))
    assert report == ((-1, 2, -6000), False, False, 65534)


def test_a_link_that_turns_counts_round_turns_its_home_round_too():
    link = replace(the("mbed-14"), encoder_sign=-1)
    written = reports.encode_home(link, (1, -2, 6000))
    assert written[9:] == bytes.fromhex("ffff 0200 90e8")
    assert reports.decode_output(link, written[1:]).home == (1, -2, 6000)


@each_link
@given(counts=counts, button=st.booleans(), calibrate=st.booleans(), counter=st.integers(0, 2**32))
def test_what_the_arm_sends_is_what_is_read(link, counts, button, calibrate, counter):
    sent = reports.encode_input(link, counts, button, calibrate, counter)
    assert len(sent) == link.report_length
    report = reports.decode(link, list(sent))  # as hidapi gives it
    if link.encoder_sign < 0:  # the lowest count has no opposite in 16 bits
        counts = tuple(-32768 if c == -32768 else c for c in counts)
    assert report.counts == counts
    assert report.counter == (counter & 0xFFFF if link.counted else None)
    protocol_2 = link.layout == "protocol-2"
    assert (report.button, report.calibrate) == (button and protocol_2, calibrate and protocol_2)


@each_link
@given(data=st.data())
def test_what_is_written_is_what_the_arm_reads(link, data):
    """To half a milliampere, up to what the firmware takes."""
    most = link.firmware_current_limit
    amperes = tuple(data.draw(st.floats(-most, most)) for _ in range(3))
    written = reports.encode_currents(link, amperes)
    assert written[0] == 0
    assert len(written) == link.report_length + 1
    output = reports.decode_output(link, written[1:])
    assert output.command == 0
    assert output.currents == pytest.approx(amperes, abs=0.000501)


@pytest.mark.parametrize("name", ["mbed-14", "teensy-64", "own-64"])
@given(home=counts)
def test_home_reaches_the_arm_and_its_motors_get_nothing(name, home):
    output = reports.decode_output(the(name), reports.encode_home(the(name), home)[1:])
    assert output == ((0.0, 0.0, 0.0), 1, home)


def test_what_stands_in_the_currents_place_at_home_is_no_current():
    """There it sets encoders d to f."""
    output = reports.decode_output(the("mbed-14"), bytes.fromhex("e803 e803 e803 0100 0000 0000 0000"))
    assert output.currents == (0.0, 0.0, 0.0)


@each_link
@pytest.mark.parametrize("wrong", [nan, inf, -inf, "over", "under"])
@pytest.mark.parametrize("at", range(3))
def test_no_current_over_the_firmwares_limit_is_ever_written(link, wrong, at):
    most = link.firmware_current_limit
    ampere = {"over": most + 0.001, "under": -most - 0.001}.get(wrong, wrong)
    with pytest.raises(ValueError, match=f"over the {most:g} A of {link.name}"):
        reports.encode_currents(link, tuple(ampere if n == at else 0.0 for n in range(3)))


@each_link
@given(length=st.integers(0, 130))
def test_a_report_of_another_length_is_refused(link, length):
    if length != link.report_length:
        for call in (reports.decode, reports.decode_output):
            with pytest.raises(ValueError, match=f"a report of {length} bytes .* {link.report_length}"):
                call(link, bytes(length))


@pytest.mark.parametrize("link", SILENT, ids=lambda link: link.name)
def test_nothing_can_be_said_to_an_arm_that_is_only_recognised(link):
    for call in (
        lambda: reports.encode_currents(link, (0.0, 0.0, 0.0)),
        lambda: reports.encode_home(link, (0, 0, 0)),
        lambda: reports.encode_input(link, (0, 0, 0), False, False, 0),
        lambda: reports.decode(link, b""),
        lambda: reports.decode_output(link, b""),
    ):
        with pytest.raises(ValueError, match="no public protocol"):
            call()


@given(start=count, steps=st.lists(st.integers(-32767, 32767), max_size=50))
def test_a_counter_is_followed_round_its_ends(start, steps):
    """As long as it moves less than half a turn of its 16 bits between two reports."""
    total = true = start
    for step in steps:
        true += step
        total = reports.unwrap(total, reports.wrapped(true))
        assert total == true


def test_wrapped_is_16_bit():
    assert [reports.wrapped(n) for n in (32767, 32768, -32768, -32769, 65536)] == [32767, -32768, -32768, 32767, 0]
