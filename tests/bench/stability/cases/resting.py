# SPDX-License-Identifier: GPL-3.0-or-later
"""A tool that rests: nothing creeps, however long, and little however the encoders tremble."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from repousse.core import DensityGrid
from repousse.core.poses import LEAST_MOVE
from tests.core.volumes import net_moved

from ..contact import MIDDLE, RADIUS, SIDE, VOXEL, above, block, coming, pushed, run
from ..figure import Figure, exactly

MINUTE = 60_000
"""Milliseconds: a pose each."""
COUNT = 55e-6 / VOXEL
"""Voxels of the coarsest arm's encoder step (an Omni's)."""
SETTLED = 1000
"""Milliseconds after which a trembling tool has been at every corner of its tremble."""
PRESSED_ON = 0.1
"""Share of what a press of 5 voxels moved that trembling by a count moves once: it presses by a count, 2 %, deeper, and
as much wider."""
CREEP = 1e-4
"""Share of what the press moved that may move in the rest of the minute: not to be seen after an hour."""


def resting(minute: int = MINUTE) -> Iterator[Figure]:
    """A minute at one pose; and a minute in which each axis is off by a count up or down at random."""
    for density, band in ((0.5, None), (1.0, float(RADIUS))):
        case = f"at rest for {minute / 1000:g} s, density {density}"
        grid = block(density)
        push, start = pushed(grid, band=band), grid.density.copy()
        run(push, [above(depth) for depth in coming(-1.0, 5.0, 0.25)])
        pressed, made = grid.density.copy(), net_moved(start, grid.density)
        forces = {push.move_to(above(5.0)).force.tobytes() for _ in range(minute)}
        yield exactly(case, "voxels that changed", float((grid.density != pressed).sum()), 0.0)
        yield exactly(case, "forces that were felt", len(forces), 1.0)
        random = np.random.default_rng(1)
        counts = random.integers(-1, 2, (minute, 3))
        last, settled = np.full(3, np.inf), pressed
        for millisecond, place in enumerate(np.array(above(5.0)) + COUNT * counts):
            if np.linalg.norm(place - last) >= LEAST_MOVE:  # as core/poses.py lets them wait
                push.move_to(place)
                last = place
            if millisecond == SETTLED:
                settled = grid.density.copy()
        case = f"trembling by a count for {minute / 1000:g} s, density {density}"
        yield Figure(case, "moved in the first second", net_moved(pressed, settled) / made, "of the press", PRESSED_ON)
        yield Figure(case, "moved in the rest", net_moved(settled, grid.density) / made, "of the press", CREEP)


def resting_overloaded() -> Iterator[Figure]:
    """At rest where the overload could not be relaxed, for there is no room: it is not tried again and again."""
    grid = DensityGrid(np.ones((SIDE,) * 3, np.float32))
    push = pushed(grid)
    for step in range(5):
        contact = push.move_to((MIDDLE + 0.4 * step, MIDDLE + 0.3 * step, MIDDLE))
    before = grid.density.copy()
    moved = sum(push.move_to(push.position).sweeps for _ in range(1000))
    yield Figure("at rest, overloaded", "overload", contact.residual, "N", at_least=0.1)
    yield exactly("at rest, overloaded", "sweeps in a thousand poses", float(moved), 0.0)
    yield exactly("at rest, overloaded", "voxels that changed", float((grid.density != before).sum()), 0.0)


CASES = (resting, resting_overloaded)
