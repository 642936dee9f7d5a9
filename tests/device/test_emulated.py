# SPDX-License-Identifier: GPL-3.0-or-later
"""The arm in software says and does what a real one's controller would, and hidapi's calls reach it in process."""

import time
from dataclasses import replace
from itertools import pairwise
from math import floor

import pytest

from repousse.device import kinematics, reports
from repousse.device.emulated import (
    APPROACH,
    PATH,
    QUEUE,
    EmulatedArm,
    EmulatedHid,
    Hand,
    Intention,
    Keyframe,
    report_descriptor,
)
from repousse.device.hid_bus import input_length
from repousse.device.profile import builtin_links, builtin_profiles

PREMIUM = builtin_profiles()["phantom-premium-1.5"]
LINKS = builtin_links()
OWN = PREMIUM.links[0]
ZERO = (0.0, 0.0, 0.0)
DRAW = Intention((Keyframe(0.5, (0.02, 0.03, -0.02)), Keyframe(1.0, (-0.02, -0.03, 0.02), button=True)), loop=True)


def arm_with(link=OWN, hand=None, profile=PREMIUM):
    return EmulatedArm(profile, link, hand)


def told(arm, amperes):
    arm.output_report(reports.encode_currents(arm.link, amperes)[1:])


def read(arm):
    return reports.decode(arm.link, arm.input_report())


@pytest.fixture(params=[name for name, link in LINKS.items() if link.layout != "none"])
def link(request):
    return LINKS[request.param]


def test_it_starts_at_home_with_its_counters_at_zero_and_its_motors_off(link):
    arm = arm_with(link)
    assert arm.angles == kinematics.joint_angles(PREMIUM, PREMIUM.home_counts)
    assert arm.counts == (0, 0, 0) and not arm.enabled and arm.currents == ZERO


def test_reports_are_whole_encoder_steps_of_where_it_is():
    arm = arm_with(hand=Hand.firm(DRAW))
    arm.begin()
    seen = set()
    for _ in range(2500):
        arm.step()
        report = read(arm)
        exact = kinematics.counts_of(PREMIUM, arm.angles)
        assert report.counts == tuple(floor(count) for count in exact)
        seen.add(report.counts)
    assert len(seen) > 1000  # it did move
    assert max(abs(count) for counts in seen for count in counts) > 500


@pytest.mark.parametrize("home", [(0, 0, 0), (32760, -32760, 20), (-32768, 32767, 0)])
def test_set_counters_count_on_from_there_and_wrap(home):
    arm = arm_with(hand=Hand.firm(DRAW))
    arm.press_calibration()
    assert read(arm).calibrate
    arm.output_report(reports.encode_home(OWN, home)[1:])
    assert read(arm).counts == home and not read(arm).calibrate
    totals, wrapped = list(home), False
    start = kinematics.counts_of(PREMIUM, arm.angles)
    for _ in range(3000):
        arm.step()
        raw = read(arm).counts
        wrapped = wrapped or any(abs(new - old) > 30000 for new, old in zip(raw, totals))
        totals = [reports.unwrap(total, count) for total, count in zip(totals, raw)]
    gone = [now - then for now, then in zip(kinematics.counts_of(PREMIUM, arm.angles), start)]
    assert all(abs(total - first - way) <= 1 for total, first, way in zip(totals, home, gone))
    assert wrapped == (home != (0, 0, 0))


def test_counters_are_set_wherever_the_arm_is():
    arm = arm_with(hand=Hand.firm(DRAW))
    arm.begin()
    for _ in range(1300):
        arm.step()
    assert all(read(arm).counts)
    arm.output_report(reports.encode_home(OWN, (7, -8, 9))[1:])
    assert read(arm).counts == (7, -8, 9)


def test_currents_are_a_force_at_the_tip_by_the_inverse_of_the_transposed_jacobian():
    """A hand's spring, held against a force of the motors, is drawn out by it: but for what friction holds."""
    hand = Hand(0.1, 3.0, 300.0, Intention((Keyframe(0.0, ZERO),)))
    slippery = replace(PREMIUM, emulated=replace(PREMIUM.emulated, coulomb=ZERO))
    arm = arm_with(hand=hand, profile=slippery)
    rest, force = arm.position, (0.4, -0.5, 0.7)
    for _ in range(2000):
        told(arm, kinematics.currents(PREMIUM, arm.angles, force))
        arm.step()
    pull = [300.0 * (now - then) for now, then in zip(arm.position, rest)]
    assert pull == pytest.approx(force, abs=2e-3)  # a milliampere is some 1.5 mN


def test_the_firmware_lets_go_when_it_is_not_spoken_to(link):
    arm = arm_with(link)
    told(arm, (0.5, 0.0, -0.5))
    watchdog = round(link.firmware_watchdog_ms)
    for _ in range(watchdog):
        arm.step()
        assert arm.enabled and arm.currents == (0.5, 0.0, -0.5)
    arm.step()
    assert not arm.enabled and arm.currents == ZERO
    told(arm, (0.25, 0.0, 0.0))
    assert arm.enabled and arm.currents == (0.25, 0.0, 0.0)


def test_released_by_the_watchdog_it_slows_down_as_one_without_motors():
    pushed, free = arm_with(), arm_with()
    told(pushed, (2.0, 0.0, 0.0))
    for _ in range(102):
        pushed.step()
    free.plant.angles, free.plant.rates = pushed.angles, pushed.plant.rates
    for _ in range(50):
        pushed.step()
        free.step()
    assert pushed.angles == pytest.approx(free.angles, abs=1e-4)


def test_a_current_over_the_firmwares_limit_drops_out_and_one_over_the_motors_saturates(link):
    arm = arm_with(link, profile=replace(PREMIUM, max_current=2.0))
    limit = link.firmware_current_limit
    told(arm, (limit, -limit, 0.1))
    assert arm.currents == (2.0, -2.0, 0.1)
    too_much = round(limit * 1000) + 1
    data = too_much.to_bytes(2, "little", signed=True) + (100).to_bytes(2, "little") * 2
    arm.output_report(data.ljust(link.report_length, b"\0"))
    assert arm.currents == (0.0, 0.1, 0.1)


def test_a_report_of_another_length_is_not_for_it(link):
    arm = arm_with(link)
    for length in (0, 1, link.report_length - 1, link.report_length + 1, 4096):
        arm.output_report(b"\x01" * length)
    assert not arm.enabled and arm.currents == ZERO


def test_firmware_in_lock_step_answers_each_report_once_in_the_frame_after():
    arm = arm_with(LINKS["mbed-14"])
    for _ in range(20):
        arm.step()
        assert arm.input_report() is None
    answers = []
    for _ in range(1000):
        if not answers or answers[-1] is not None:
            told(arm, ZERO)
        arm.step()
        answers.append(arm.input_report())
    assert sum(answer is not None for answer in answers) == 500
    arm.step()
    arm.step()
    assert arm.input_report() is None


@pytest.mark.parametrize("name", ["mbed-8", "own-64"])
def test_streamed_reports_are_numbered(name):
    arm = arm_with(LINKS[name])
    numbers = [read(arm).counter for _ in range(70000)]
    assert all((after - before) % 65536 == 1 for before, after in pairwise(numbers))


def test_the_hand_holds_still_until_the_arm_is_homed_and_then_follows_its_script():
    arm = arm_with(hand=Hand.firm(DRAW))
    for _ in range(300):
        told(arm, ZERO)
        arm.step()
    assert arm.counts == (0, 0, 0) and not read(arm).button
    arm.output_report(reports.encode_home(OWN, PREMIUM.home_counts)[1:])
    begun = arm.time
    centre = PREMIUM.workspace_centre
    for _ in range(5000):
        arm.step()
        wanted, _, button = DRAW.at(arm.time - begun - APPROACH) if arm.time > begun + APPROACH else (None, None, False)
        assert read(arm).button == button
        if wanted and arm.time > begun + APPROACH + 0.1:
            assert arm.position == pytest.approx([a + b for a, b in zip(wanted, centre)], abs=1.5e-3)


def test_where_nothing_says_that_it_is_homed_the_first_report_does():
    arm = arm_with(LINKS["mbed-8"], Hand.firm(DRAW))
    for _ in range(1200):
        arm.step()
    assert arm.counts == (0, 0, 0)
    told(arm, ZERO)
    for _ in range(1200):
        arm.step()
    assert max(map(abs, arm.counts)) > 100


def test_the_button_is_the_scripts_unless_it_is_pressed_from_outside():
    arm = arm_with(hand=Hand.soft(DRAW))
    arm.pressed = True
    assert read(arm).button
    arm.pressed = None
    assert not read(arm).button


def test_switched_off_and_on_it_counts_from_where_it_is():
    arm = arm_with(hand=Hand.firm(DRAW))
    arm.begin()
    for _ in range(1300):
        arm.step()
    told(arm, (0.1, 0.0, 0.0))
    place = arm.angles
    assert any(arm.counts)
    arm.power_up()
    assert arm.counts == (0, 0, 0) and not arm.enabled and arm.currents == ZERO and arm.angles == place
    assert read(arm).counter == 1


def test_lost_steps_are_only_in_the_counters():
    arm = arm_with()
    place = arm.angles
    arm.jump((500, 0, -3))
    assert read(arm).counts == (500, 0, -3) and arm.angles == place


def test_it_is_the_same_every_time():
    def run():
        arm = arm_with(hand=Hand.soft())
        arm.begin()
        for number in range(2000):
            told(arm, (0.3 * (number % 7 > 3), 0.0, -0.2))
            arm.step()
        return arm.angles, arm.plant.rates, arm.input_report()

    assert run() == run()


def test_a_millisecond_costs_less_than_a_quarter_of_one():
    arm = arm_with(hand=Hand.soft())
    arm.begin()
    costs = []
    for _ in range(10):
        start = time.process_time()
        for _ in range(200):
            told(arm, ZERO)
            arm.step()
            arm.input_report()
        costs.append((time.process_time() - start) / 200)
    assert min(costs) < 0.25e-3


def test_its_descriptor_is_the_firmwares_and_tells_the_length(link):
    descriptor = report_descriptor(link)
    assert descriptor[:8] == bytes.fromhex("06abff0a0002a101") and descriptor[-1] == 0xC0
    assert len(descriptor) == 27  # as mbed's USBHID example has it
    assert input_length(descriptor) == link.report_length


class Clock:
    """Time that a test lets pass."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now

    def wait(self, seconds):
        self.now += max(seconds, 1e-6)


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def hid(clock):
    return EmulatedHid(PREMIUM, OWN, Hand.soft(), clock, clock.wait)


@pytest.fixture
def device(hid):
    device = hid.device()
    device.open_path(PATH)
    device.set_nonblocking(1)
    return device


def counter(data):
    return reports.decode(OWN, data).counter


def test_hidapis_own_device_has_every_call_that_it_has():
    hidraw = pytest.importorskip("hidraw")
    for name in ("open", "open_path", "close", "read", "write", "error", "set_nonblocking", "get_report_descriptor"):
        assert hasattr(hidraw.device, name)
    offered = {name for name in dir(EmulatedHid(PREMIUM, OWN).device()) if not name.startswith("_")}
    assert offered <= set(dir(hidraw.device))


def test_it_is_found_and_told_from_others(hid):
    (found,) = hid.enumerate()
    assert (found["vendor_id"], found["product_id"], found["usage_page"]) == (OWN.vendor, OWN.product, OWN.usage_page)
    assert hid.enumerate(OWN.vendor, OWN.product) == [found] == hid.enumerate(OWN.vendor)
    assert hid.enumerate(0x1234) == []


def test_a_report_comes_each_millisecond_and_none_twice(clock, device):
    numbers = []
    for _ in range(1000):
        clock.now += 1e-3
        data = device.read(65)
        assert len(data) == OWN.report_length and all(isinstance(byte, int) for byte in data)
        numbers.append(counter(data))
        assert device.read(65) == []
    assert numbers == list(range(numbers[0], numbers[0] + 1000))


def test_of_what_is_not_read_the_oldest_are_kept(hid, clock, device):
    for _ in range(20):
        clock.now += 5e-3
        device.write(bytes(65))
    numbers = []
    while data := device.read(65):
        numbers.append(counter(data))
    assert len(numbers) == QUEUE and numbers == list(range(numbers[0], numbers[0] + QUEUE))
    assert hid.dropped == 100 - QUEUE
    clock.now += 1e-3
    assert counter(device.read(65)) == numbers[0] + 100


def test_an_arm_that_nobody_asked_for_long_stood_still(hid, clock, device):
    before = hid.arm.time
    clock.now += 3600.0
    device.read(65)
    assert hid.arm.time - before < 0.1


def test_a_read_waits_as_long_as_it_is_told_to(hid, clock, device):
    start = clock.now
    silent = EmulatedHid(PREMIUM, LINKS["mbed-14"], None, clock, clock.wait).device()
    silent.open_path(PATH)
    assert silent.read(65, 20) == []
    assert clock.now - start == pytest.approx(0.02, abs=1e-4)
    while device.read(65):
        pass
    device.set_nonblocking(0)
    start = clock.now
    assert device.read(65) != []
    assert 0.0 < clock.now - start <= 1e-3 + 1e-5


def test_written_currents_flow(hid, device):
    report = reports.encode_currents(OWN, (0.5, -0.25, 0.125))
    assert device.write(report) == len(report)
    assert hid.arm.currents == (0.5, -0.25, 0.125) and hid.arm.enabled


def test_unplugged_a_read_fails_and_a_write_says_so(hid, clock, device):
    clock.now += 5e-3
    hid.unplug()
    assert hid.enumerate() == []
    with pytest.raises(OSError, match="read error"):
        device.read(65)
    assert device.write(bytes(65)) == -1
    assert device.error() == "No such device"
    with pytest.raises(OSError, match="open failed"):
        hid.device().open_path(PATH)


def test_what_is_not_open_or_open_already_is_refused(hid, device):
    with pytest.raises(RuntimeError, match="already open"):
        device.open_path(PATH)
    with pytest.raises(OSError, match="open failed"):
        hid.device().open_path(b"/dev/hidraw0")
    with pytest.raises(OSError, match="open failed"):
        hid.device().open(0x1234, 6)
    device.close()
    device.close()
    for call in (
        lambda: device.read(65),
        lambda: device.write(b"\0\0"),
        device.error,
        lambda: device.set_nonblocking(1),
    ):
        with pytest.raises(ValueError, match="not open"):
            call()
