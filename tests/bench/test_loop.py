# SPDX-License-Identifier: GPL-3.0-or-later
"""The arm's loop for a minute, through the unmodified hidapi: its rate, its period, and what it computes in one.

The emulated arm is a process of its own, and a third one keeps a core busy meanwhile.
"""

import os
import subprocess
import sys
import time
from contextlib import contextmanager, nullcontext

import pytest

from repousse.device import reports
from repousse.device.profile import builtin_profiles
from tests.device.engaged import Engaged
from tests.device.shim.log import Kind
from tests.device.shim.served_arm import ServedArm

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the shim is for Linux")

PREMIUM = builtin_profiles()["phantom-premium-1.5"]
SECONDS = 60.0


@contextmanager
def busy_core():
    """An ordinary process that computes without end."""
    process = subprocess.Popen([sys.executable, "-I", "-c", "while True: pass"])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def stolen():
    """Seconds that a hypervisor has given to others, of all that there were, summed over the cores."""
    with open("/proc/stat") as file:
        times = [int(field) for field in file.readline().split()[1:]]
    return times[7], sum(times)


@pytest.mark.parametrize("load", [busy_core, nullcontext])
@pytest.mark.parametrize("scheduling", ["SCHED_FIFO", "ordinary"])
def test_a_minute_of_force(benchmark, figures, tmp_path, scheduling, load):
    """1 N rendered for a minute; every report that was sent is accounted for."""
    still = tmp_path / "still.jsonl"
    still.write_text('{"intention": 1}\n{"time": 0.0, "position": [0.0, 0.0, 0.0]}\n')
    with (
        ServedArm(PREMIUM, script=still, number=100 + os.getpid() % 900, log_states=False) as arm,
        Engaged(PREMIUM, arm.path, arm.environment) as engaged,
        load(),
    ):
        loop = engaged.loop
        if scheduling == "ordinary":
            os.sched_setscheduler(loop.process_id, os.SCHED_OTHER, os.sched_param(0))
        for bins in (loop._memory.periods, loop._memory.work):
            for index in range(len(bins)):
                bins[index] = 0
        began, first, stolen_before = time.perf_counter(), loop.state().tick, stolen()

        def run():
            time.sleep(SECONDS)

        benchmark.pedantic(run, rounds=1)
        last, ended, stolen_after = loop.state(), time.perf_counter(), stolen()
        health = loop.health()
        told = arm.order("state")
        received = [entry for entry in arm.log() if entry.kind is Kind.RECEIVED]
        assert loop.running, loop.failure
    assert all(reports.decode_output(loop.link, entry.data[1:]) for entry in received)
    values = {"rate": (last.tick - first) / (ended - began)}
    section = f"arm's loop, a minute, {'a core busy' if load is busy_core else 'machine at rest'}"
    figures.add(section, scheduling, values, "/s", {"rate": 990.0}, True)
    p50, p99, p999 = (1e3 * share for share in health.period)
    period = {"p50": p50, "p99": p99, "p99.9": p999, "longest": 1e3 * health.figures.longest}
    figures.add(section, f"{scheduling}: period", period, "ms", {"p99.9": 1.3} if scheduling == "SCHED_FIFO" else {})
    work = {"p50": 1e6 * health.work[0], "p99": 1e6 * health.work[1], "p99.9": 1e6 * health.work[2]}
    figures.add(section, f"{scheduling}: arithmetic", work, "us", {"p99": 60.0})
    lost = {"lost": health.figures.lost - told["dropped"], "dropped by the arm": told["dropped"]}
    figures.add(section, f"{scheduling}: reports", lost, f"of {told['sent']}", {"lost": 0.0})
    theft, whole = (after - before for before, after in zip(stolen_before, stolen_after))
    figures.add(section, f"{scheduling}: time that the hypervisor gave to others", {"": 100.0 * theft / whole}, "%")
    parts = {name: 1e6 * getattr(health.figures, name) for name in ("read", "pose", "force", "write", "tell")}
    figures.add(section, f"{scheduling}: parts, mean of the last second", parts, "us")
    benchmark.extra_info.update(values, state=last.state.name, period=period, work=work, lost=lost, parts=parts)


SLEEPER = """
import gc, os, sys, time
from time import perf_counter as clock
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))
gc.disable()
periods, last = [], clock()
due, end = last + 1e-3, last + float(sys.argv[1])
while last < end:
    time.sleep(max(0.0, due - clock()))
    now = clock()
    periods.append(now - last)
    last, due = now, max(due + 1e-3, now)
print(sorted(periods)[int(0.999 * len(periods))])
"""


def test_what_the_machine_can(benchmark, figures):
    """A process in real time that does nothing but sleep for a millisecond, a core busy: no loop can be steadier."""

    def run():
        done = subprocess.run([sys.executable, "-I", "-c", SLEEPER, "10"], capture_output=True, text=True, check=True)
        return 1e3 * float(done.stdout)

    before = stolen()
    with busy_core():
        longest = benchmark.pedantic(run, rounds=1)
    theft, whole = (after - former for former, after in zip(before, stolen()))
    values = {"p99.9": longest, "stolen": theft / whole}
    benchmark.extra_info.update(values)
    figures.add("arm's loop", "a process that only sleeps, SCHED_FIFO, a core busy: period", {"p99.9": longest}, "ms")
    figures.add("arm's loop", "meanwhile the hypervisor gave to others", {"": 100.0 * theft / whole}, "%")
