# SPDX-License-Identifier: GPL-3.0-or-later
"""How often the material is felt while a stroke runs, and how long a stroke takes to begin and to end."""

from __future__ import annotations

import time
from itertools import count, islice

import numpy as np
import pytest

from repousse.core import DensityGrid, Engine, Material, Push, Sample, SphereTool, native

from .test_speed import CLAY, block

compiled_only = pytest.mark.skipif(not native.available(), reason="asks how fast the compiled kernels are")
SECONDS = 2.0
REACHED = 300.0
"""Local models a second that issue 3 asks for while Blender redraws on two cores."""
WORK = {
    "elastic, 1000 poses/s": (Material(full_force=3.3, yield_ratio=5.0), 1, 1e-3),
    "a push, 100 poses/s": (CLAY, 1, 1e-2),
    "solves without a gap": (CLAY, 200, 1e-2),
}
"""A material, how many poses are fed when the last are solved, and every how many seconds that is looked at."""


def rest(until: float) -> None:
    """A main thread that is Blender waiting for the next event."""
    time.sleep(max(0.0, until - time.perf_counter()))


def compute(until: float) -> None:
    """A main thread that is busy in Python, and lets nobody in but when it must."""
    while time.perf_counter() < until:
        sum(number * number for number in range(100))


def stroke(number: int) -> Sample:
    """Back and forth inside the block, always a little deeper: half a voxel at a time."""
    phase = number % 160
    across = 0.5 * (phase if phase < 80 else 160 - phase)
    return Sample(1e-3 * number, (90.0 + across, 128.0, 200.0 - 0.02 * number))


@compiled_only
@pytest.mark.filterwarnings("ignore:this material may never yield")
@pytest.mark.parametrize("main", [rest, compute])
@pytest.mark.parametrize("work", WORK)
def test_collision_rate(benchmark, figures, work, main):
    """Local models a second, and the longest that one had to serve, at 256³ with a tool of 32."""
    material, poses, between = WORK[work]
    push = Push(DensityGrid(block(256, 200, 0.5), copy=False), SphereTool(16.0), material, border="wall")
    times: list[float] = []

    class Timed(Engine):
        def _publish(self, pose):
            published = super()._publish(pose)
            if published:
                times.append(time.perf_counter())
            return published

    running = Timed(push)

    def run():
        numbers, began = count(), time.perf_counter()
        while (now := time.perf_counter()) < began + SECONDS:
            if running.settle(0.0):
                for number in islice(numbers, poses):
                    running.feed(stroke(number))
            main(now + between)
        return running.health

    with running:
        health = benchmark.pedantic(run, rounds=1)
    gaps = 1e3 * np.diff(times)
    values = {
        "rate": len(times) / SECONDS,
        "gap p99": float(np.percentile(gaps, 99)),
        "longest": float(gaps.max()),
        "solves/s": health.solves / SECONDS,
    }
    benchmark.extra_info.update(values, estimates=health.estimates, discarded=health.discarded)
    who = "main thread at rest" if main is rest else "main thread busy in Python"
    figures.add("engine, 256³, tool 32", f"{work}, {who}", {"rate": values["rate"]}, "Hz", {"rate": REACHED}, True)
    figures.add("engine, 256³, tool 32", f"{work}, {who}", {k: values[k] for k in ("gap p99", "longest")}, "ms")


@compiled_only
def test_stroke_begins_and_ends(benchmark, figures):
    """From a grid alone to threads that wait for poses; and from the last pose solved to no threads."""
    grid = DensityGrid(block(256, 200, 0.5), copy=False)
    begin, end = [], []

    def run():
        began = time.perf_counter()
        running = Engine(Push(grid, SphereTool(16.0), CLAY, border="wall"))
        running.start()
        begin.append(time.perf_counter() - began)
        for number in range(40):
            running.feed(stroke(number))
        running.settle(60.0)
        began = time.perf_counter()
        running.finish()
        end.append(time.perf_counter() - began)

    benchmark.pedantic(run, rounds=20)
    for what, spent in (("begins", begin), ("ends", end)):
        values = {"p50": 1e3 * float(np.median(spent)), "max": 1e3 * max(spent)}
        benchmark.extra_info[what] = values
        figures.add("engine, 256³, tool 32", f"a stroke {what}", values, "ms", {"max": 100.0})
