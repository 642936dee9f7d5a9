# SPDX-License-Identifier: GPL-3.0-or-later
"""A tool that moves fast, or far, or by next to nothing, or to and fro."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from repousse.core import Material
from repousse.core.quality import LONGEST_STEP

from ..contact import (
    FULL_FORCE,
    MIDDLE,
    RADIUS,
    SIDE,
    SURFACE,
    VOXEL,
    YIELD_RATIO,
    Run,
    above,
    block,
    coming,
    excess,
    pushed,
    run,
    total,
)
from ..figure import Figure

MASS = 1e-7
"""Share of all mass that may be lost or won: DESIGN 7."""
SWEEPS = 4
"""To a solve, at most: the first, and three that correct (core/push.py)."""
JND, LEAST_STEP = 0.08, 0.05
"""Share of a force, and newtons, below which a hand does not feel a step (facts/physics.md 3)."""

THICKNESSES = (1, 2, 3)
SPEED = 1.0
"""Metres a second: two voxels a millisecond, so four solves at least."""
SAME_FORCE = 0.02
"""Share of the greatest force of a slow pass by which a fast one may differ at the same depth: a quarter of what a hand
can tell apart, for steps of a quarter and half a voxel round the path differently."""


def thin_sheets() -> Iterator[Figure]:
    """1 m/s right through a sheet, a pose each millisecond, four and eight, beside a slow pass."""
    for thickness in THICKNESSES:
        for band in (None, float(RADIUS)):
            case = f"sheet of {thickness}, band {band}"
            slow = _through(thickness, band, 0.25)
            fast = [_through(thickness, band, SPEED * ms * 1e-3 / VOXEL) for ms in (1, 4, 8)]
            slow_at = [np.interp(-one.place[:, 2], -slow.place[:, 2], slow.force[:, 2]) for one in fast]
            inside = [one.place[:, 2] < SURFACE + RADIUS - 1.0 for one in fast]
            least = min(float(one.force[met, 2].min()) for one, met in zip(fast, inside, strict=True))
            apart = max(float(np.abs(one.force[:, 2] - at).max()) for one, at in zip(fast, slow_at, strict=True))
            share = min(
                float((one.force[m, 2] / at[m]).min()) for one, at, m in zip(fast, slow_at, inside, strict=True)
            )
            yield Figure(case, "least force against the motion", least, "N", at_least=1e-3)
            yield Figure(case, "of the slow pass's force, at least", share, "", at_least=1.0 - JND)
            yield Figure(case, "apart from the slow pass", apart / slow.strength.max(), "of its greatest", SAME_FORCE)


def _through(thickness: int, band: float | None, step: float) -> Run:
    """Along -z, from clear above a sheet to where the ball's middle is a radius beyond it but for a voxel."""
    grid = block(0.0)
    grid.density[:, :, int(SURFACE) - thickness : int(SURFACE)] = 1.0
    heights = np.arange(SURFACE + RADIUS + 2.0, SURFACE - RADIUS + 1.0, -step)
    return run(pushed(grid, band=band), [(MIDDLE, MIDDLE, z) for z in heights], continuous=True)


def fast_entry_and_exit() -> Iterator[Figure]:
    """1 m/s into a block by 6 voxels and out again, a pose each millisecond to eight: the same as slowly."""
    for density, band in ((0.5, None), (1.0, float(RADIUS))):
        slow = _in_and_out(density, band, 0.5)
        for ms in (1, 4, 8):
            case = f"1 m/s in and out, {ms} ms, density {density}"
            fast = _in_and_out(density, band, SPEED * ms * 1e-3 / VOXEL)
            yield Figure(case, "mass moved, apart from slowly", abs(fast.moved / slow.moved - 1.0), "", SAME_FORCE)
            yield Figure(case, "force into the material", max(0.0, -float(fast.force[:, 2].min())), "N", 0.0)
            yield Figure(case, "force when it is out", float(fast.strength[-1]), "N", 0.0)
            yield Figure(case, "work of the hand", fast.work, "J", at_least=0.0)
            solves = SPEED * ms * 1e-3 / VOXEL / LONGEST_STEP
            yield Figure(case, "sweeps to a solve", fast.sweeps / solves, "", SWEEPS)


def _in_and_out(density: float, band: float | None, step: float) -> Run:
    down, up = (coming(*ends, step) for ends in ((-4.0, 6.0), (6.0, -4.0)))
    return run(pushed(block(density), band=band), [above(depth) for depth in (*down, *up[1:])])


MICROMETRE = 1e-6 / VOXEL
STIFF = Material(10.0 * FULL_FORCE, YIELD_RATIO)
"""Ten times an arm's force: so that what hands feel, and 0.05 N, are not met by a force that is small anyway."""


def small_moves() -> Iterator[Figure]:
    """Moves of one micrometre, in through yield, to and fro, and out, straight and aslant: no step that is felt."""
    for density, band in ((0.5, None), (1.0, float(RADIUS))):
        for slant in (0.0, 0.6):
            case = f"1 um moves, density {density}, slant {slant}"
            depths = _there_and_back((-0.2, 1.0, 0.9, 1.2, 0.4), MICROMETRE)
            push = pushed(block(density), material=STIFF, band=band)
            met = run(push, [above(depth, slant * depth) for depth in depths])
            steps = np.linalg.norm(np.diff(met.force, axis=0), axis=1)
            allowed = np.maximum(JND * met.strength[:-1], LEAST_STEP)
            steepest = push.k_t * np.pi * RADIUS**2 * MICROMETRE  # all of the ball's section meets full material
            yield Figure(case, "greatest step over what is felt", float((steps / allowed).max()), "", 1.0)
            yield Figure(case, "greatest step over the steepest slope's", float(steps.max()) / steepest, "", 2.0)
            yield Figure(case, "force that was reached", float(met.strength.max()), "N", at_least=0.2)


def _there_and_back(ends: tuple[float, ...], step: float) -> np.ndarray:
    return np.concatenate([coming(a, b, step) for a, b in pairwise(ends)])


CYCLES = 100
DRIFT_FORCE = 1e-3
"""Share of the force at the deepest point by which the last cycle may differ from the second."""
DRIFT_MASS = 1.0
"""Voxels' worth that may move in the 99 cycles after the first (facts/physics.md 2: one voxel's mass)."""


def load_cycles() -> Iterator[Figure]:
    """A hundred times in by 5 voxels and out again: the first press makes the pit, and no other deepens it."""
    for density, band in ((0.5, None), (1.0, float(RADIUS))):
        case = f"{CYCLES} load cycles, density {density}"
        push = pushed(block(density), band=band)
        peaks, moved = [], []
        for _ in range(CYCLES):
            push.lift()
            met = run(push, [above(depth) for depth in (*coming(-0.5, 5.0, 0.5), *coming(5.0, -0.5, 0.5)[1:])])
            peaks.append(met.strength.max())
            moved.append(met.moved)
        yield Figure(case, "drift of the peak force", abs(peaks[-1] / peaks[1] - 1.0), "", DRIFT_FORCE)
        yield Figure(case, "moved by cycles 2 to 100", sum(moved[1:]), "voxels", DRIFT_MASS)
        yield Figure(case, "moved by the first", moved[0], "voxels", at_least=10.0)


def sliding() -> Iterator[Figure]:
    """Three voxels deep along a surface; and skimming it, so little deep that it stays elastic."""
    for density, band in ((0.5, None), (1.0, float(RADIUS))):
        for depth in (0.4, 3.0):
            case = f"sliding {depth} voxels deep, density {density}"
            grid = block(density, side=SIDE + 24)
            push = pushed(grid, material=STIFF, band=band)
            before, first = total(grid), (SIDE + 24 - 1) / 2
            aside = coming(-16.0, 16.0, 0.25)
            place = [(first + x, first, SURFACE - 0.5 + RADIUS - depth) for x in aside]
            run(push, [(place[0][0], first, z) for z in coming(SURFACE + RADIUS, place[0][2], 0.25)])
            met = run(push, place[1:])
            steady = met.force[len(met.force) // 2 :]
            mean, ripple = float(steady[:, 2].mean()), float(np.ptp(steady[:, 2])) / 2.0
            yield Figure(case, "ripple of the force over what is felt", ripple / max(JND * mean, LEAST_STEP), "", 1.0)
            yield Figure(case, "pull along the motion", max(0.0, float(met.force[:, 0].max())) / mean, "of it", JND)
            yield Figure(case, "mass won or lost", abs(total(grid) - before) / before, "of all", MASS)
            yield Figure(case, "density out of [0, 1]", excess(grid), "", 0.0)


CASES = (thin_sheets, fast_entry_and_exit, small_moves, load_cycles, sliding)
