# SPDX-License-Identifier: GPL-3.0-or-later
"""The pace holds to absolute deadlines, and what goes first goes back where it was."""

import gc
import os

import pytest

from repousse.device import pace
from repousse.device.pace import Pace, first_in_line


class Clock:
    """A time that passes only in sleep, which is always a little too long."""

    def __init__(self, late=0.0):
        self.now, self.late, self.slept = 100.0, late, []

    def perf_counter(self):
        return self.now

    def sleep(self, seconds):
        assert seconds >= 0.0
        self.slept.append(seconds)
        self.now += seconds + self.late


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(pace, "time", clock)
    return clock


def test_what_a_sleep_is_late_by_does_not_add_up(clock):
    clock.late = 2e-4
    pacing = Pace(1e-3)
    times = [pacing.wait() for _ in range(1000)]
    assert times == pytest.approx([100.0 + 1e-3 * (n + 1) + 2e-4 for n in range(1000)], abs=1e-9)


def test_a_period_that_took_too_long_is_followed_at_once_and_then_in_step(clock):
    pacing = Pace(1e-3)
    pacing.wait()
    clock.now += 1.5e-3
    late = clock.now
    assert pacing.wait() == late
    assert pacing.wait() == pytest.approx(100.003)


def test_deadlines_that_were_missed_are_not_made_up_for(clock):
    """After a stall there is no burst of periods without a pause: it would be a burst of forces."""
    pacing = Pace(1e-3)
    pacing.wait()
    clock.now += 0.5
    stalled = clock.now
    times = [pacing.wait() for _ in range(4)]
    assert times == pytest.approx([stalled + 1e-3 * n for n in range(4)])


def test_garbage_is_not_collected_meanwhile_and_afterwards_again():
    scheduling = os.sched_getscheduler(0) if hasattr(os, "sched_getscheduler") else None
    try:
        assert gc.isenabled()
        with first_in_line() as agreed:
            assert not gc.isenabled() and isinstance(agreed, bool)
            if scheduling is not None:
                assert (os.sched_getscheduler(0) == os.SCHED_FIFO) is agreed
        assert gc.isenabled()
    finally:
        gc.unfreeze()
        if scheduling is not None:
            os.sched_setscheduler(0, scheduling, os.sched_param(0))


def test_a_system_that_does_not_agree_is_taken_as_it_is(monkeypatch):
    def refuse(*_):
        raise PermissionError("not for you")

    monkeypatch.setattr(os, "sched_setscheduler", refuse, raising=False)
    with first_in_line() as agreed:
        assert agreed is False
    gc.unfreeze()
