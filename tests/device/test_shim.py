# SPDX-License-Identifier: GPL-3.0-or-later
"""The unmodified hidapi wheel drives an emulated arm in another process, byte for byte, as it would a real one."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import pytest

from repousse.device import reports
from repousse.device.emulated import QUEUE
from repousse.device.profile import builtin_links, builtin_profiles

if sys.platform != "linux" or not all(map(importlib.util.find_spec, ("hidraw", "ziglang"))):
    pytest.skip("the shim needs Linux, hidapi and zig", allow_module_level=True)

from .shim.log import Kind, moment
from .shim.served_arm import ServedArm, ServedArmError

PREMIUM = builtin_profiles()["phantom-premium-1.5"]
LINKS = builtin_links()
OWN = PREMIUM.links[0]
PATIENCE = 30.0

# A program with hidapi that evaluates what it is sent, a line at a time: what a test wants to see done elsewhere.
PROGRAM = """
import hidraw, sys, os, time
device = hidraw.device()
def tried(call):
    try:
        return call()
    except Exception as error:
        return type(error).__name__, str(error)
def echo(count):
    "Read so many reports; answer each with its own first bytes. What was read and written, in order."
    seen, written = [], []
    for _ in range(count):
        data = bytes(device.read(100, 1000))
        answer = bytes([0, data[10], data[11] % 4]) + bytes(len(data) - 2)
        assert device.write(answer) == len(answer)
        seen.append(data); written.append(answer)
    return seen, written
def drain():
    seen = []
    while data := device.read(100):
        seen.append(bytes(data))
    return seen
for line in sys.stdin:
    print(repr(tried(lambda: eval(line))), flush=True)
"""


class Program:
    """It, with an arm's environment."""

    def __init__(self, arm):
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-c", PROGRAM],
            env=arm.environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.path = arm.path.encode()

    def __call__(self, expression):
        self._process.stdin.write(expression + "\n")
        self._process.stdin.flush()
        return eval(self._process.stdout.readline())

    def open(self):
        assert self(f"device.open_path({self.path!r})") is None
        assert self("device.set_nonblocking(1)") == 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        with self._process as process:
            process.stdin.close()


@pytest.fixture
def arm():
    with ServedArm(PREMIUM) as arm:
        yield arm


@pytest.fixture
def program(arm):
    with Program(arm) as program:
        yield program


def until(true):
    """Wait for a condition."""
    deadline = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.01)


def gone(process_id):
    try:
        os.kill(process_id, 0)
    except ProcessLookupError:
        return True
    return Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"


def test_hidapi_finds_it_and_knows_it_by_its_usage_page(arm, program):
    (found,) = program("hidraw.enumerate()")
    assert found["path"] == b"/dev/hidraw0"
    assert (found["vendor_id"], found["product_id"]) == (OWN.vendor, OWN.product)
    assert (found["usage_page"], found["usage"]) == (OWN.usage_page, OWN.usage)
    assert found["product_string"] == PREMIUM.name
    assert program(f"hidraw.enumerate({OWN.vendor}, {OWN.product})") == [found]
    assert program("hidraw.enumerate(0x1234, 6)") == []
    program.open()
    assert program("device.get_report_descriptor()")[:8] == [0x06, 0xAB, 0xFF, 0x0A, 0x00, 0x02, 0xA1, 0x01]
    assert program("device.get_product_string()") == PREMIUM.name


def test_reports_are_exact_both_ways_and_none_is_lost(arm, program):
    program.open()
    program("drain() and None")
    seen, written = program("echo(2000)")
    arm.order("silence")  # so that the last of them are in the log
    log = arm.log()
    sent = [entry.data for entry in log if entry.kind is Kind.SENT]
    received = [entry.data for entry in log if entry.kind is Kind.RECEIVED]
    start = sent.index(seen[0])
    assert sent[start : start + 2000] == seen
    assert received == written
    answered = [entry.time for entry in log if entry.kind is Kind.RECEIVED]
    assert not any(entry.kind is Kind.DROPPED and entry.time <= answered[-1] for entry in log)
    numbers = [reports.decode(OWN, data).counter for data in seen]
    assert all((after - before) % 65536 == 1 for before, after in pairwise(numbers))


@pytest.mark.parametrize("name", ["mbed-8", "mbed-14", "teensy-64"])
def test_every_firmwares_reports_go_through_in_their_own_length(name):
    link = LINKS[name]
    with ServedArm(PREMIUM, link) as arm, Program(arm) as program:
        program.open()
        order = reports.encode_currents(link, (0.25, -0.125, 0.5))
        assert program(f"device.write({order!r})") == len(order) == link.report_length + 1
        data = program("device.read(100, 1000)")
        assert max(map(abs, reports.decode(link, data).counts)) < 20  # it has just begun to move
        until(lambda: (0.25, -0.125, 0.5) in [moment(one).currents for one in arm.log() if one.kind is Kind.STATE])


def test_a_program_that_does_not_read_finds_the_oldest_reports_as_linux_keeps_them(arm, program):
    program.open()
    until(lambda: arm.order("state")["dropped"] >= 20)
    arm.order("silence")
    dropped = arm.order("state")["dropped"]
    numbers = [reports.decode(OWN, data).counter for data in program("drain()")]
    assert numbers == list(range(numbers[0], numbers[0] + QUEUE))
    arm.order("silence", on=False)
    until(lambda: program("device.read(100, 1000)"))
    arm.order("silence")
    lost = {reports.decode(OWN, entry.data).counter for entry in arm.log() if entry.kind is Kind.DROPPED}
    assert lost == set(range(numbers[0] + QUEUE, numbers[0] + QUEUE + dropped))


def test_two_programs_that_have_it_open_both_get_all_reports(arm, program):
    arm.order("silence")
    with Program(arm) as other:
        program.open()
        other.open()
        arm.order("silence", on=False)
        until(lambda: arm.order("state")["sent"] >= 40)
        arm.order("silence")
        mine = program("drain()")
        assert len(mine) >= 20 and other("drain()") == mine


def test_unplugged_a_read_fails_a_write_says_so_and_nothing_can_be_opened(arm, program):
    program.open()
    assert program("len(device.read(100, 1000))") == OWN.report_length
    arm.order("unplug")
    assert program("tried(drain)") == ("OSError", "read error")
    assert program("device.write(bytes(65))") == -1
    assert program("device.error()") == "No such device"
    assert program("hidraw.enumerate()") == []
    assert program(f"tried(lambda: hidraw.device().open_path({program.path!r}))") == ("OSError", "open failed")
    assert arm.order("state")["currents"] == [0.0, 0.0, 0.0]
    arm.order("plug")
    program("device.close()")
    program.open()
    data = program("device.read(100, 1000)")
    assert reports.decode(OWN, data).counter < 2000  # it counts anew


def test_killed_it_is_gone_as_if_unplugged(arm, program):
    program.open()
    arm.kill()
    assert program("tried(lambda: [device.read(100, 1000) for _ in range(99)] and None)") == ("OSError", "read error")
    assert program("device.write(bytes(65))") == -1


def test_a_node_that_may_not_be_opened(arm, program):
    (arm.folder / "hidraw0.denied").touch()
    assert program(f"tried(lambda: device.open_path({program.path!r}))") == ("OSError", "open failed")
    assert program(f"os.access({program.path!r}, os.R_OK | os.W_OK)") is False
    assert len(program("hidraw.enumerate()")) == 1
    (arm.folder / "hidraw0.denied").unlink()
    assert program(f"os.access({program.path!r}, os.R_OK | os.W_OK)") is True
    program.open()


def test_what_is_written_last_arrives_though_reports_are_unread(arm, program):
    """As the kernel sends on what was written before a close: here the zeros of a loop that ends."""
    for _ in range(10):
        program.open()
        program("device.write(bytes([0, 232, 3]) + bytes(62))")
        until(lambda: arm.order("state")["currents"] == [1.0, 0.0, 0.0])
        program("[device.write(bytes(65)), device.close()] and None")
        until(lambda: not arm.order("state")["open"])
        assert arm.order("state")["currents"] == [0.0, 0.0, 0.0]


def test_what_is_not_a_report_is_not_taken(arm, program):
    program.open()
    assert program("device.write(b'\\0')") == -1
    assert program("device.write(bytes(20000))") == -1
    assert program("device.write(bytes(15))") == 15  # the kernel takes it, the firmware does not
    assert not arm.order("state")["enabled"]


def test_other_files_are_opened_as_ever(arm, program, tmp_path):
    path = tmp_path / "hidraw0"
    program(f"open({str(path)!r}, 'w').write('clay') and None")
    assert path.read_text() == "clay"
    assert program(f"open({str(path)!r}).read()") == "clay"
    assert program("tried(lambda: open('/dev/hidrawx'))")[0] == "FileNotFoundError"
    assert program("tried(lambda: open('/dev/hidraw1'))")[0] == "FileNotFoundError"
    assert program("os.access('/dev/null', os.R_OK)") is True


def test_faults_are_what_they_say(arm, program):
    program.open()
    arm.order("instead", data="0102030405", count=3)
    data = [program("device.read(100, 1000)") for _ in range(100)]
    assert data.count([1, 2, 3, 4, 5]) == 3
    arm.order("jump", counts=[1000, 0, 0])
    until(lambda: reports.decode(OWN, program("device.read(100, 1000)")).counts == (1000, 0, 0))
    arm.order("press")
    until(lambda: reports.decode(OWN, program("device.read(100, 1000)")).button)
    arm.order("calibrate")
    until(lambda: reports.decode(OWN, program("device.read(100, 1000)")).calibrate)
    arm.order("silence")
    program("drain() and None")
    assert program("device.read(100, 50)") == []
    with pytest.raises(ServedArmError, match="do_dance"):
        arm.order("dance")
    with pytest.raises(ServedArmError, match="hexadecimal"):
        arm.order("instead", data="xyz")


def test_the_firmwares_watchdog_ends_the_current_of_a_program_that_stops(arm, program):
    program.open()
    order = reports.encode_currents(OWN, (0.5, 0.0, 0.0))
    program(f"device.write({order!r})")
    until(lambda: arm.order("state")["enabled"])
    until(lambda: not arm.order("state")["enabled"])
    log = arm.log()
    (received,) = (entry.time for entry in log if entry.kind is Kind.RECEIVED)
    flowing = [entry.time for entry in log if entry.kind is Kind.STATE and moment(entry).currents[0] == 0.5]
    # In the arm's own time: so many milliseconds, whenever the process came to them.
    assert len(flowing) == OWN.firmware_watchdog_ms
    assert flowing[0] == received
    assert flowing[-1] - received == pytest.approx(0.1, abs=0.05)


def test_nothing_is_left_when_it_is_stopped():
    arm = ServedArm(PREMIUM)
    arm.start()
    folder, process_id = arm.folder, arm.process_id
    arm.stop()
    arm.stop()
    assert not folder.exists() and gone(process_id)


def test_nothing_is_left_when_it_cannot_start(tmp_path):
    arm = ServedArm(PREMIUM, script=tmp_path / "none.jsonl")
    with pytest.raises(ServedArmError, match=r"none\.jsonl: is no file"):
        arm.start()
    assert not arm.folder.exists()


def test_it_ends_and_cleans_up_when_its_owner_is_killed():
    owner = subprocess.Popen(
        [sys.executable, "-c", OWNER, str(Path(__file__).parents[2])], stdout=subprocess.PIPE, text=True
    )
    with owner:
        folder, process_id = owner.stdout.readline().split()
        os.kill(owner.pid, signal.SIGKILL)
    until(lambda: gone(int(process_id)))
    until(lambda: not Path(folder).exists())


OWNER = """
import os, sys, time
os.chdir(sys.argv[1])
from repousse.device.profile import builtin_profiles
from tests.device.shim.served_arm import ServedArm
arm = ServedArm(builtin_profiles()["phantom-premium-1.5"])
arm.start()
print(arm.folder, arm.process_id, flush=True)
time.sleep(60)
"""
