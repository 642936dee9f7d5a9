# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults, injected into the whole: a process like Blender, the loop's, the unmodified hidapi, and an emulated arm.

What the arm's motors really had is read off the arm's own record, by the clock that all these processes share. The
times within which there must be no force are those of the safety module; SLACK is for a machine that does other things
as well (the exact number of periods is asserted without a clock in test_loop.py).
"""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from repousse.device import HapticLoop
from repousse.device.lock import lock_file
from repousse.device.profile import builtin_profiles, to_json
from repousse.device.protocol import ForceModel
from repousse.device.safety import Fault, State, fault_text

from .engaged import PATIENCE, Engaged
from .shim.log import Kind, moment
from .shim.served_arm import ServedArm

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the shim is for Linux")

PREMIUM = builtin_profiles()["phantom-premium-1.5"]
SLACK = 0.05
"""Seconds."""
NO_CURRENT = 1e-9


@pytest.fixture(autouse=True)
def nothing_is_left():
    """No process of ours, no descriptor and nothing in shared memory outlives a test."""
    shared, descriptors = set(os.listdir("/dev/shm")), len(os.listdir("/proc/self/fd"))
    yield
    assert set(os.listdir("/dev/shm")) == shared
    assert len(os.listdir("/proc/self/fd")) == descriptors
    assert children(os.getpid()) == []


def children(process):
    """Processes whose parent is this one, zombies among them."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                status = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(status[1]) == process:
                found.append(int(folder.name))
    return found


def is_there(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_for(condition, patience=PATIENCE):
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


@pytest.fixture
def still(tmp_path):
    """The script of a hand that holds the arm where it is."""
    script = tmp_path / "still.jsonl"
    lines = [{"intention": 1}, {"time": 0.0, "position": [0.0, 0.0, 0.0]}]
    script.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return script


@pytest.fixture
def arm(still):
    number = 100 + os.getpid() % 900  # a lock is by path, and other runs on this machine have arms as well
    with ServedArm(PREMIUM, script=still, number=number) as arm:
        yield arm


@pytest.fixture
def engaged(arm):
    with Engaged(PREMIUM, arm.path, arm.environment) as engaged:
        yield engaged


def motors(arm, since):
    """(time after `since`, largest current) of each millisecond of the arm."""
    for entry in arm.log():
        if entry.kind is Kind.STATE and entry.time >= since:
            yield entry.time - since, max(map(abs, moment(entry).currents))


def assert_let_go(arm, since, within):
    """From `within` seconds after `since` on the motors had no current, and before that they had some."""
    seen = list(motors(arm, since - 0.05))
    assert max(current for when, current in seen if when <= 0.05) > 0.1, "there was no force to begin with"
    late = [(when - 0.05, current) for when, current in seen if when - 0.05 > within + SLACK]
    assert late, "the arm was not watched for long enough"
    assert max(current for _, current in late) <= NO_CURRENT
    return max((when - 0.05 for when, current in seen if current > NO_CURRENT), default=0.0)


def test_one_newton_asked_is_one_newton_at_the_tip(arm, engaged):
    """Through the memory, the loop, hidapi and the reports to the motors: within one per cent."""
    state = engaged.loop.state()
    assert state.force == pytest.approx((0.0, 0.0, 1.0), abs=0.01)
    told = arm.order("state")["currents"]
    assert told == pytest.approx(state.currents, abs=0.002)
    assert max(map(abs, told)) > 0.1


def test_unplugged(arm, engaged):
    order = arm.order("unplug")
    wait_for(lambda: not engaged.loop.running)
    state = engaged.loop.state()
    assert state.time - order["time"] <= 0.001 + SLACK
    assert engaged.loop.failure == fault_text(Fault.UNPLUGGED)
    assert state.fault is Fault.UNPLUGGED and state.state is State.CLOSED and state.force == (0.0, 0.0, 0.0)


def test_plugged_in_again_it_has_to_be_connected_homed_and_armed(arm, still):
    with Engaged(PREMIUM, arm.path, arm.environment) as engaged:
        arm.order("unplug")
        wait_for(lambda: not engaged.loop.running)
    arm.order("plug")
    with HapticLoop(PREMIUM, path=arm.path, environment=arm.environment) as again:
        wait_for(lambda: again.state().tick > 20)
        again.send(ForceModel(time.perf_counter(), stress=0.1, yield_stress=1.0, normal=(0.0, 0.0, 1.0), scene=1))
        again.arm()
        wait_for(lambda: again.state().fault is Fault.NOT_HOMED)
        assert again.state().state is State.OPEN


@pytest.mark.parametrize(
    "order, values, told, within",
    [
        ("silence", {}, Fault.SILENT, 0.020),
        ("instead", {"data": "00" * 13, "count": 5}, Fault.WRONG_REPORT, 0.001),
        ("jump", {"counts": [3000, 0, 0]}, Fault.ENCODER_JUMP, 0.001),
    ],
    ids=["silent", "wrong length", "encoder jump"],
)
def test_an_arm_that_fails_is_let_go(arm, engaged, order, values, told, within):
    since = arm.order(order, **values)["time"]
    engaged.until(lambda state: state.state is State.SAFE)
    assert engaged.loop.state().fault is told
    wait_for(lambda: time.perf_counter() > since + within + 3 * SLACK)
    print(f"let go after {1e3 * assert_let_go(arm, since, within):.1f} ms")
    engaged.loop.arm()
    engaged.loop.home()
    engaged.until(lambda state: state.state is not State.RUN)


def test_firmware_that_stood_still_gets_zeros_when_it_goes_on(arm, engaged):
    since = arm.order("stall", seconds=0.3)["time"]
    engaged.until(lambda state: state.state is State.SAFE)
    assert engaged.loop.state().fault is Fault.SILENT
    assert engaged.loop.state().time - since <= 0.020 + SLACK
    wait_for(lambda: time.perf_counter() > since + 0.3 + 2 * SLACK)
    assert max(current for when, current in motors(arm, since) if when > 0.3 + 0.002) <= NO_CURRENT


def test_a_model_that_is_no_number(arm, engaged):
    engaged.model = engaged.model._replace(stress=float("nan"))
    since = time.perf_counter()
    engaged.until(lambda state: state.state is State.SAFE)
    assert engaged.loop.state().fault is Fault.MODEL_NOT_FINITE
    wait_for(lambda: time.perf_counter() > since + 3 * SLACK)
    print(
        f"let go after {1e3 * assert_let_go(arm, since, 0.002):.1f} ms"
    )  # a period of the sender's, and one of the loop's


def test_torn_writes_are_not_rendered(arm, engaged):
    """A writer that was stopped in the middle of a record: the last good one fades as it ages, as if it had ended."""
    engaged._over.set()
    engaged._sender.join()
    sequence = engaged.loop._memory.model._sequence
    sequence[0] += 1
    engaged.loop._memory.model._payload[:16] = b"\xff" * 16
    since = time.perf_counter()
    engaged.until(lambda state: state.state is State.ARMED)
    assert engaged.loop.state().fault is Fault.MODEL_STALE
    wait_for(lambda: time.perf_counter() > since + 0.1 + 3 * SLACK)
    print(f"let go after {1e3 * assert_let_go(arm, since, 0.1):.1f} ms")


def test_the_shared_memory_is_given_up(arm, engaged):
    """Blender's side says that it keeps it no longer; on Linux it cannot be taken away otherwise."""
    since = time.perf_counter()
    engaged.loop._memory._open[0] = 0
    wait_for(lambda: not engaged.loop.running)
    assert engaged.loop.failure == fault_text(Fault.MEMORY_GONE)
    wait_for(lambda: time.perf_counter() > since + 3 * SLACK)
    print(f"let go after {1e3 * assert_let_go(arm, since, 0.002):.1f} ms")


def test_the_loop_is_killed(arm, engaged):
    """What is left is the firmware's own watchdog."""
    since = time.perf_counter()
    os.kill(engaged.loop.process_id, signal.SIGKILL)
    wait_for(lambda: not engaged.loop.running)
    assert "ended from outside" in engaged.loop.failure
    within = engaged.loop.link.firmware_watchdog_ms / 1000.0
    wait_for(lambda: time.perf_counter() > since + within + 3 * SLACK)
    print(f"let go after {1e3 * assert_let_go(arm, since, within):.1f} ms")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_the_loop_is_asked_to_end(arm, engaged, number):
    since = time.perf_counter()
    os.kill(engaged.loop.process_id, number)
    wait_for(lambda: not engaged.loop.running)
    wait_for(lambda: time.perf_counter() > since + 3 * SLACK)
    assert_let_go(arm, since, 0.005)
    assert engaged.loop.state().state is State.CLOSED


def test_an_interrupt_at_the_terminal_is_blenders_affair(arm, engaged):
    os.kill(engaged.loop.process_id, signal.SIGINT)
    tick = engaged.loop.state().tick
    engaged.until(lambda state: state.tick > tick + 50)
    assert engaged.loop.state().state is State.RUN


def test_stopped_in_order(arm, engaged):
    process, since = engaged.loop.process_id, time.perf_counter()
    engaged.loop.stop()
    assert not is_there(process) and engaged.loop.failure == ""
    assert engaged.loop.state().state is State.CLOSED
    wait_for(lambda: time.perf_counter() > since + 3 * SLACK)
    assert_let_go(arm, since, 0.02)


@contextmanager
def blender_like(arm):
    """A process of its own with the arm in hand; yields it and the id of its loop's process."""
    code = "import sys; import runpy; runpy.run_path(sys.argv[1], run_name='__main__')"
    boot = (
        "import sys, types, importlib.util as u; root = types.ModuleType('repousse'); "
        f"root.__path__ = [{str(Path(__file__).resolve().parents[2])!r}]; sys.modules['repousse'] = root; {code}"
    )
    command = [sys.executable, "-B", "-c", boot, str(Path(__file__).with_name("engaged.py"))]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    config = {"profile": to_json(PREMIUM), "path": arm.path, "environment": arm.environment, "script": None}
    try:
        process.stdin.write(json.dumps(config) + "\n")
        process.stdin.flush()
        said = process.stdout.readline().split()
        assert said[:1] == ["engaged"]
        yield process, int(said[1])
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait()
        process.stdin.close()
        process.stdout.close()


def test_blender_is_killed(arm):
    with blender_like(arm) as (blender, loop):
        since = time.perf_counter()
        blender.kill()
        wait_for(lambda: not is_there(loop))
        wait_for(lambda: time.perf_counter() > since + 0.1 + 3 * SLACK)
        print(f"let go after {1e3 * assert_let_go(arm, since, 0.1):.1f} ms")


def test_blender_is_stalled_for_two_seconds(arm):
    """The whole process; when it goes on there is no force until the hand has left the material."""
    with blender_like(arm) as (blender, loop):
        blender.send_signal(signal.SIGSTOP)
        since = time.perf_counter()
        wait_for(lambda: time.perf_counter() > since + 2.0)
        blender.send_signal(signal.SIGCONT)
        wait_for(lambda: time.perf_counter() > since + 3.0)
        print(f"let go after {1e3 * assert_let_go(arm, since, 0.1):.1f} ms")
        assert is_there(loop)


def test_a_second_session_is_refused(arm, engaged):
    with HapticLoop(PREMIUM, path=arm.path, environment=arm.environment) as second:
        wait_for(lambda: not second.running)
        assert "in use by another session" in second.failure and arm.path in second.failure
    tick = engaged.loop.state().tick
    engaged.until(lambda state: state.tick > tick + 50)
    assert engaged.loop.state().state is State.RUN
    engaged.loop.stop()
    with HapticLoop(PREMIUM, path=arm.path, environment=arm.environment) as third:
        wait_for(lambda: third.state().tick > 5)


def test_a_lock_of_another_users_is_told(arm, monkeypatch):
    file = lock_file("/dev/hidraw-of-another")
    file.mkdir()
    try:
        with HapticLoop(PREMIUM, path="/dev/hidraw-of-another", environment=arm.environment) as refused:
            wait_for(lambda: not refused.running)
            assert "lock" in refused.failure and "another user" in refused.failure
    finally:
        file.rmdir()


@pytest.mark.parametrize(
    "path, said", [("/dev/hidraw77", "cannot be opened"), ("/nowhere", "cannot be opened"), ("", "cannot be opened")]
)
def test_an_arm_that_is_not_there(arm, path, said):
    with HapticLoop(PREMIUM, path=path, environment=arm.environment) as loop:
        wait_for(lambda: not loop.running)
        assert said in loop.failure and len(loop.failure.splitlines()) == 1


def test_an_arm_that_speaks_otherwise_than_its_profile(arm):
    woody = builtin_profiles()["woodenhaptics-2015"]
    link = next(link for link in woody.links if link.report_length == 14)
    with HapticLoop(woody, link, path=arm.path, environment=arm.environment) as loop:
        wait_for(lambda: not loop.running)
        assert "sends reports of 64 bytes, not 14" in loop.failure
    assert not [entry for entry in arm.log() if entry.kind is Kind.RECEIVED], "nothing may have been written to it"


def test_reports_that_are_lost_on_their_way_are_counted_exactly(arm, engaged):
    arm.order("drop", count=7)
    tick = engaged.loop.state().tick
    engaged.until(lambda state: state.tick > tick + 2200)
    assert engaged.loop.health().figures.lost == 7
