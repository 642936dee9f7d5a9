# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's recursion, taken literally, beside the sweep on the same push in the same run."""

from __future__ import annotations

import time

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool, native

SIZE, AIR, RADIUS, STEP, STEPS = 256, 28, 16.0, 0.5, 120
SECONDS = 15.0
"""After this long the recursion is stopped; the early steps that it did are the cheaper ones."""
DIRECTIONS = {"on axis": (1.0, 0.0, 0.0), "(1,1,1)": (1.0, 1.0, 1.0), "(.8,.5,.33)": (0.8, 0.5, 0.33)}


def half_space(u: np.ndarray) -> np.ndarray:
    """Density .5 beyond a plane across ``u``, less a frame of air: in all directions the tool meets a flat face."""
    axes = np.ogrid[:SIZE, :SIZE, :SIZE]
    along = sum(np.float32(c) * (a - SIZE / 2).astype(np.float32) for c, a in zip(u, axes))
    density = np.where(along > -60.0, np.float32(0.5), np.float32(0.0))
    inside = np.zeros_like(density)
    inside[AIR:-AIR, AIR:-AIR, AIR:-AIR] = density[AIR:-AIR, AIR:-AIR, AIR:-AIR]
    return inside


def steps(
    density: np.ndarray, u: np.ndarray, method: str, most: int, seconds: float
) -> tuple[list[float], list[bool], str]:
    """Seconds of each step, whether density moved in it, and why it ended."""
    push = Push(DensityGrid(density), SphereTool(RADIUS), Material(3.3, 0.1), method=method, border="open")
    start = SIZE / 2 - (60.0 + RADIUS) * u
    spent, moved = [], []
    for number in range(most):
        began = time.perf_counter()
        try:
            contact = push.move_to(start + number * STEP * u)
        except ValueError as error:
            return spent, moved, str(error)
        spent.append(time.perf_counter() - began)
        moved.append(contact.moved_mass > 0.0)
        if sum(spent) > seconds:
            return spent, moved, f"stopped after {seconds:g} s"
    return spent, moved, "reached the end"


def bookkeeping(density: np.ndarray) -> float:
    """Seconds that the recursive method spends on the whole array, not on recursion: its copy, and what changed."""
    began = time.perf_counter()
    np.nonzero(density.copy() != density)
    return time.perf_counter() - began


@pytest.mark.skipif(not native.available(), reason="compares compiled kernels")
@pytest.mark.parametrize("way", DIRECTIONS)
def test_against_the_recursion(benchmark, figures, way):
    u = np.array(DIRECTIONS[way]) / np.linalg.norm(DIRECTIONS[way])
    density = half_space(u)
    result = benchmark.pedantic(steps, args=(density, u, "recursive", STEPS, SECONDS), rounds=1)
    recursive, moved, ended = result
    swept, _, _ = steps(density, u, "sweep", len(recursive), np.inf)
    moved = np.array(moved)
    assert moved.any(), "the recursion never moved anything: there is nothing to compare"
    own = min(bookkeeping(density) for _ in range(3))
    mean = max(float(np.array(recursive)[moved].mean()) - own, 0.0)
    ratio = mean / float(np.array(swept)[moved].mean())
    last = max(float(np.array(recursive)[moved][-5:].mean()) - own, 0.0) / float(np.array(swept)[moved][-5:].mean())
    benchmark.extra_info.update(
        steps=len(recursive),
        ended=ended,
        recursive_ms=1000 * mean,
        bookkeeping_ms=1000 * own,
        ratio=ratio,
        ratio_last_five=last,
    )
    figures.add(
        "against the recursion, d0 = .5",
        f"{way}, {len(recursive)} of {STEPS} steps ({ended})",
        {"times slower": ratio, "in the last five": last, "recursion, ms": 1000 * mean},
        "",
        {"times slower": 1000.0} if way == "on axis" else None,
        at_least=True,
    )
