# SPDX-License-Identifier: GPL-3.0-or-later
"""HapticLoop owns a subprocess: how it begins, what it says of its end, and that nothing is left of it.

Here with the arm in software within the subprocess, as on systems without the shim; test_faults.py has the rest.
"""

import json
import os
import time

import pytest

from repousse.device import HapticLoop, child, haptic_loop, lock
from repousse.device.profile import builtin_profiles
from repousse.device.protocol import ArmState
from repousse.device.safety import State

PREMIUM = builtin_profiles()["phantom-premium-1.5"]
PATIENCE = 20.0


def wait_for(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_the_emulated_arm_is_driven_from_home_to_home():
    with HapticLoop(PREMIUM) as loop:
        wait_for(lambda: loop.state().tick > 10)
        assert loop.running and loop.state().state is State.OPEN
        loop.home()
        wait_for(lambda: loop.state().state is State.HOMED)
        start = loop.state().position
        wait_for(lambda: max(abs(a - b) for a, b in zip(start, loop.state().position)) > 0.01)  # its hand moves it
        loop.arm()
        wait_for(lambda: loop.state().state is State.ARMED)
        loop.disarm()
        wait_for(lambda: loop.state().state is State.HOMED)
        wait_for(lambda: loop.health().figures.ticks > 0)
        process = loop.process_id
        assert sum(loop._memory.periods) > 100
    assert not loop.running and loop.failure == "" and loop.state().state is State.CLOSED
    assert loop.health().period[0] > 0.0
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
    loop.stop()


def test_it_can_be_started_again_but_not_twice():
    loop = HapticLoop(PREMIUM)
    for _ in range(2):
        loop.start()
        with pytest.raises(RuntimeError, match="driven already"):
            loop.start()
        wait_for(lambda: loop.state().tick > 0)
        loop.stop()


def test_before_it_starts_and_after_it_stops_it_is_closed_and_takes_orders_without_harm():
    loop = HapticLoop(PREMIUM)
    assert loop.state() == ArmState() and not loop.running and loop.failure == "" and loop.process_id is None
    loop.send(None)
    loop.home()
    loop.set_clutch(True)
    loop.stop()


@pytest.mark.parametrize("scale", [-0.1, 1.1, float("nan")])
def test_a_force_scale_is_from_0_to_1(scale):
    with pytest.raises(ValueError, match="from 0 to 1"):
        HapticLoop(PREMIUM).set_force_scale(scale)


def test_without_hidapi_there_is_still_the_emulated_arm(monkeypatch):
    monkeypatch.setattr(child, "find_hidapi", lambda: None)
    with pytest.raises(RuntimeError, match="hidapi module is missing"):
        HapticLoop(PREMIUM, path="/dev/hidraw0").start()
    with HapticLoop(PREMIUM) as loop:
        wait_for(lambda: loop.state().tick > 0)


def test_a_python_that_is_not_there_is_told(monkeypatch):
    monkeypatch.setattr(child.sys, "executable", "/nowhere/python")
    before = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0
    loop = HapticLoop(PREMIUM)
    with pytest.raises(RuntimeError, match="cannot be started"):
        loop.start()
    assert not loop.running
    if before:
        assert len(os.listdir("/proc/self/fd")) == before


def test_a_script_that_is_none_is_told_in_one_line(tmp_path):
    script = tmp_path / "script.jsonl"
    script.write_text("nonsense")
    with HapticLoop(PREMIUM, script=str(script)) as loop:
        wait_for(lambda: not loop.running)
        assert "script.jsonl" in loop.failure and len(loop.failure.splitlines()) == 1


def test_a_profile_that_is_only_recognised_is_never_driven():
    touch = next(profile for profile in builtin_profiles().values() if not profile.driven and profile.links)
    with HapticLoop(touch, path="/dev/hidraw0") as loop:
        wait_for(lambda: not loop.running)
        assert "driven" in loop.failure


@pytest.mark.parametrize(
    "said, complained, code, reason",
    [
        ('{"ended": ""}\n', "", 0, ""),
        ('{"ended": "it was unplugged"}\n', "", 1, "it was unplugged"),
        ('noise\n{"ended": "last"}\nnoise\n', "", 1, "last"),
        ("", "Traceback\n  line\nMemoryError: no more\n", 1, "The arm's loop failed: MemoryError: no more"),
        ("", "", -9, "exit code -9"),
        ("[1]\n3\nnull\n", "", 1, "exit code 1"),
    ],
)
def test_why_it_ended_is_one_line(said, complained, code, reason):
    told = haptic_loop._reason(said, complained, code)
    assert reason in told and len(told.splitlines()) <= 1
    assert bool(told) is bool(reason)


def test_one_that_cannot_be_read_is_refused_by_its_process():
    """What stands in the first line is no configuration."""
    for line in ("", "nonsense", "[1]", "{}", json.dumps({"profile": 3, "address": "x", "link": "y", "path": "z"})):
        process = child.subprocess.Popen(
            child.command("loop"), stdin=child.subprocess.PIPE, stdout=child.subprocess.PIPE, text=True
        )
        said, _ = process.communicate(line + "\n", timeout=60)
        assert process.returncode == 1 and json.loads(said)["ended"]


def test_a_lock_is_held_by_one_and_given_back(tmp_path, monkeypatch):
    monkeypatch.setattr(lock.tempfile, "gettempdir", lambda: str(tmp_path))
    with lock.held("/dev/hidraw0"):
        with lock.held("/dev/hidraw1"):
            pass
        with pytest.raises(lock.InUseError, match="/dev/hidraw0: is in use"), lock.held("/dev/hidraw0"):
            pass
    with lock.held("/dev/hidraw0"):
        pass


def test_a_lock_that_is_a_link_to_elsewhere_is_not_followed(tmp_path, monkeypatch):
    """In a folder that all may write to, it may be another user's trap."""
    monkeypatch.setattr(lock.tempfile, "gettempdir", lambda: str(tmp_path))
    target = tmp_path / "precious"
    lock.lock_file("/dev/hidraw0").symlink_to(target)
    with pytest.raises(lock.InUseError, match="cannot be had"), lock.held("/dev/hidraw0"):
        pass
    assert not target.exists()
