# SPDX-License-Identifier: GPL-3.0-or-later
"""Which HID devices are ours, what their owner is told, and how one is read and written."""

import json
import sys
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.device import child, hid_bus
from repousse.device.hid_bus import LONGEST_DRAIN, OpenError, UnpluggedError, Wire, input_length, recognised, udev_rule
from repousse.device.profile import builtin_links, builtin_profiles

TEENSY = builtin_links()["teensy-64"]
MBED = builtin_links()["mbed-14"]


def descriptor(length):
    """That of the mbed firmware: a vendor's page, one input and one output report of `length` bytes."""
    return (
        bytes.fromhex("06abff0a0002a1017508150025ff95")
        + bytes([length])
        + bytes.fromhex("0901810295")
        + bytes([length])
        + bytes.fromhex("09029102c0")
    )


def device(**changes):
    """One of hidapi's enumeration."""
    return {
        "path": b"/dev/null",
        "vendor_id": 0x16C0,
        "product_id": 0x0486,
        "usage_page": 0xFFAB,
        "product_string": "An arm",
    } | changes


@pytest.mark.parametrize("length", [8, 14, 64])
def test_the_length_of_a_report_is_read_from_its_descriptor(length):
    assert input_length(descriptor(length)) == length


def test_inputs_of_several_items_add_up_and_outputs_do_not_count():
    """Three bits of buttons and five of padding, then two bytes: a mouse."""
    mouse = "05010902a1010901a1000509190129031500250195037501810295017505810305010930093115812 57f750895028106c0c0"
    assert input_length(bytes.fromhex(mouse.replace(" ", ""))) == 3


@given(st.binary(max_size=200))
def test_any_bytes_are_a_descriptor_of_some_length(data):
    assert input_length(data) >= 0


def test_an_arm_is_found_with_all_the_profiles_that_fit():
    (found,) = recognised([device()], builtin_profiles().values())
    assert found.state == hid_bus.READY and found.name == "An arm"
    assert ("phantom-premium-1.5", "own-64") in found.candidates
    assert ("woodenhaptics-2015", "teensy-64") in found.candidates


def test_a_device_of_another_page_is_not_ours():
    """A Teensy in RawHID mode has a second interface; a mouse is no arm at all."""
    others = [device(usage_page=0xFFC9), device(vendor_id=0x046D, usage_page=1)]
    assert recognised(others, builtin_profiles().values()) == []


def test_libusb_tells_no_page_and_still_it_is_found():
    (found,) = recognised([device(usage_page=0, path=b"1-1:1.0")], builtin_profiles().values())
    assert found.candidates and found.path == "1-1:1.0"


def test_the_vendors_own_arm_is_recognised_and_cannot_be_chosen():
    (found,) = recognised([device(vendor_id=0x2988, product_id=0x0304, usage_page=1)], builtin_profiles().values())
    assert found.state == hid_bus.VENDOR_DRIVER and found.candidates == ()
    assert "driver" in found.message


def test_an_arm_that_may_not_be_used_says_so(tmp_path):
    """A node that is not there may not be read either."""
    (found,) = recognised([device(path=b"/dev/hidraw-none")], builtin_profiles().values())
    assert found.state == hid_bus.NO_PERMISSION and "udev" in found.message


def test_the_rule_names_each_device_once_in_small_letters():
    rule = udev_rule([TEENSY, MBED, replace(TEENSY, name="again")])
    assert rule.splitlines() == [
        'KERNEL=="hidraw*", ATTRS{idVendor}=="1234", ATTRS{idProduct}=="0006", TAG+="uaccess"',
        'KERNEL=="hidraw*", ATTRS{idVendor}=="16c0", ATTRS{idProduct}=="0486", TAG+="uaccess"',
    ]


class FakeDevice:
    """hidapi's device: what it is to say is put into `reports`, what is written is kept."""

    def __init__(self, length=64):
        self.reports, self.written, self.opened, self.closed, self.length = [], [], [], 0, length
        self.accepts = True

    def device(self):
        return self

    def open_path(self, path):
        self.opened.append(path)

    def set_nonblocking(self, flag):
        self.nonblocking = flag

    def get_report_descriptor(self):
        return list(descriptor(self.length))

    def read(self, length):
        report = self.reports.pop(0) if self.reports else []
        if isinstance(report, Exception):
            raise report
        return report

    def write(self, data):
        self.written.append(bytes(data))
        return len(data) if self.accepts else -1

    def close(self):
        self.closed += 1


@pytest.fixture
def hid():
    return FakeDevice()


def test_a_pause_leaves_reports_behind_and_the_newest_counts(hid):
    """The kernel hands out the oldest first."""
    wire = Wire.open(hid, "/dev/hidraw3", TEENSY)
    assert hid.opened == [b"/dev/hidraw3"] and hid.nonblocking == 1
    assert wire.newest() is None
    hid.reports = [[1], [2], [3]]
    assert wire.newest() == [3] and wire.superseded == 2
    assert wire.newest() is None and wire.superseded == 2


def test_reports_that_never_end_do_not_keep_the_loop(hid):
    wire = Wire.open(hid, "/dev/hidraw3", TEENSY)
    hid.reports = [[i] for i in range(1, 1000)]
    assert wire.newest() == [LONGEST_DRAIN]


def test_unplugging_is_told(hid):
    wire = Wire.open(hid, "/dev/hidraw3", TEENSY)
    hid.reports = [[1], OSError("read error")]
    with pytest.raises(UnpluggedError, match="read error"):
        wire.newest()
    hid.accepts = False
    assert wire.write(b"\0" * 65) is False


def test_an_arm_that_speaks_otherwise_is_refused_and_let_go(hid):
    with pytest.raises(OpenError, match=r"/dev/hidraw3: sends reports of 64 bytes, not 14 as mbed-14 does"):
        Wire.open(hid, "/dev/hidraw3", MBED)
    assert hid.closed == 1 and hid.written == []


def test_one_that_cannot_be_opened_is_told_by_its_path(hid):
    def refuse(path):
        raise OSError("open failed")

    hid.open_path = refuse
    with pytest.raises(OpenError, match="/dev/hidraw3: cannot be opened"):
        Wire.open(hid, "/dev/hidraw3", TEENSY)
    assert hid.closed == 1


def test_the_list_is_made_by_a_process_of_its_own():
    """With the real hidapi, on whatever this machine has."""
    hidapi = child.find_hidapi()
    assert hidapi is not None, "the hidapi wheel is a development dependency"
    with child.start("hid_bus", {"hidapi": hidapi, "profiles": None}) as process:
        said, complained = process.communicate(timeout=60)
    assert process.returncode == 0, complained
    assert isinstance(json.loads(said), list)


@pytest.mark.parametrize("config", [{}, {"hidapi": ["os", "/nowhere/os.py"]}, {"hidapi": None}, {"hidapi": [1]}])
def test_a_list_that_cannot_be_made_says_why_in_one_line(config):
    with child.start("hid_bus", config) as process:
        said, complained = process.communicate(timeout=60)
    assert process.returncode == 1 and said == ""
    assert complained.startswith("the devices cannot be listed") and len(complained.splitlines()) == 1


def test_hidraw_comes_before_libusb():
    """On Linux the wheel has both; libusb takes the device away from the kernel's driver."""
    name, origin = child.find_hidapi()
    assert name == ("hidraw" if sys.platform == "linux" else "hid") and name in origin
