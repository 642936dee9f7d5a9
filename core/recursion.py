# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's recursive dispersion, literally (section 7): the reference that the sweep is measured against.

The innermost voxel gives up its density to its forward neighbours; what one of them cannot hold goes on to that one's
forward neighbours, and so on, depth first. Exponential through saturated material, and its result depends on the order
of equally deep voxels, so it is for small grids, and a budget ends it with a clear error.
"""

from __future__ import annotations

import sys
from ctypes import byref, c_int64
from dataclasses import dataclass, field

import numpy as np

from .grid import Box
from .native.state import Workspace, box_from, pointer
from .native.structures import RecursionState
from .plasticity import RELAXED, box_around, overloaded

BUDGET = 50_000_000
"""Calls of the recursion in one move before it gives up; the sweep does not need one."""
SMALLEST = 1e-5
"""Voxels' worth of overflow that is not passed on but kept aside: 3 % less than this is ever noticed in the result."""
FORWARD = 0.5
"""A neighbour is forward when the cosine of its angle to u is above this."""


@dataclass(frozen=True)
class Outcome:
    """What a recursive dispersion did: masses in voxels' worth, and the density before it."""

    emptied: float
    mass_out: float
    kept: float
    calls: int
    before: np.ndarray = field(repr=False)
    dirty: Box | None


def forward_neighbours(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (n, 3) int64 of the forward neighbours among the 26, and their shares (n,), by cosine."""
    offsets = np.array([o for o in np.ndindex(3, 3, 3) if o != (1, 1, 1)], np.int64) - 1
    cosine = offsets @ direction / np.linalg.norm(offsets, axis=1)
    forward = cosine > FORWARD + 1e-9
    return offsets[forward], cosine[forward] / cosine[forward].sum()


def innermost_first(work: Workspace) -> np.ndarray:
    """Flat indices (int64) of the tool's voxels that hold density, the deepest first."""
    box, offsets = box_around(work.volume, work.tool.centre[:], work.density.shape)
    distance = work.volume.distance(*offsets)
    inside = np.nonzero((distance < 0.5) & (work.density[box] > 0.0))
    order = np.argsort(distance[inside], kind="stable")
    index = tuple(i[order] + s.start for i, s in zip(inside, box, strict=True))
    return np.ravel_multi_index(index, work.density.shape).astype(np.int64)


def disperse_recursively(work: Workspace, direction: np.ndarray, kappa: float, outside: str) -> Outcome:
    """Empty voxel after voxel, innermost first, until sigma <= sigma_f, each by recursion (paper 7, steps 1 to 4).

    ``outside`` says what density does that reaches the border: "leave" or "keep" (it goes back into the tool).

    Raises
    ------
    ValueError
        When the recursion would take more than the budget; the density is as it was.
    """
    before = work.density.copy()
    work.keep((0, 0, 0), work.density.shape)
    voxels = innermost_first(work)
    offsets, weights = forward_neighbours(direction)
    state = RecursionState(
        voxels=pointer(voxels, c_int64), count=len(voxels), forward=len(weights), wall=outside == "keep", budget=BUDGET
    )
    state.kappa, state.relaxed, state.smallest = kappa, RELAXED, SMALLEST
    state.offsets[: offsets.size] = offsets.ravel().tolist()
    state.weights[: len(weights)] = weights.tolist()
    if work.library:
        work.library.repousse_recursive(byref(work.grid), byref(work.tool), byref(work.estimate), byref(state))
    else:
        _recursive_python(work, state, voxels, offsets, weights)
    if state.calls > state.budget:
        work.density[:] = before
        work.settle(None)
        raise ValueError(
            f"the recursive method gave up after {state.budget} calls: use a smaller grid, or the method sweep"
        )
    kept = _return_aside(work, before, voxels, state.aside)
    work.settle(None)
    changed = np.nonzero(work.density != before)
    dirty = None
    if len(changed[0]):
        dirty = box_from([int(i.min()) for i in changed] + [int(i.max()) + 1 for i in changed])
    return Outcome(state.emptied, state.mass_out, kept, state.calls, before, dirty)


def _return_aside(work: Workspace, before: np.ndarray, voxels: np.ndarray, aside: float) -> float:
    """What was kept aside goes back into the emptied voxels, outermost first."""
    left = aside
    flat, former = work.density.reshape(-1), before.reshape(-1)
    for voxel in voxels[::-1]:
        if left <= 0.0:
            break
        back = min(left, max(float(former[voxel]) - float(flat[voxel]), 0.0))
        flat[voxel] += np.float32(back)
        left -= back
    return aside - left


def _weights_at(work: Workspace, index: tuple[int, ...]) -> tuple[float, float]:
    """(w_t, w_s - w_t) of one voxel."""
    at = [np.array(i - c) for i, c in zip(index, work.tool.centre, strict=True)]
    inside = float(work.volume.coverage(*at))
    return inside, float(work.surroundings.coverage(*at)) - inside


def _recursive_python(
    work: Workspace, state: RecursionState, voxels: np.ndarray, offsets: np.ndarray, weights: np.ndarray
) -> None:
    density, masses, shape = work.density, work.estimate, work.density.shape

    def pass_on(voxel: tuple[int, ...], amount: float) -> None:
        state.calls += 1
        for offset, weight in zip(offsets.tolist(), weights.tolist(), strict=True):
            if state.calls > state.budget:
                return
            share = amount * weight
            beside = (voxel[0] + offset[0], voxel[1] + offset[1], voxel[2] + offset[2])
            if not all(0 <= i < n for i, n in zip(beside, shape, strict=True)):
                if state.wall:
                    state.aside += share
                else:
                    state.mass_out += share
                continue
            former = float(density[beside])
            density[beside] = former + min(share, 1.0 - former)
            taken = float(density[beside]) - former
            inside, around = _weights_at(work, beside)
            masses.tool_mass += inside * taken
            masses.reach_mass += around * taken
            if share - taken > state.smallest:
                pass_on(beside, share - taken)
            else:
                state.aside += share - taken

    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(max(limit, 4 * sum(shape) + 1000))
    try:
        for flat in voxels.tolist():
            if not overloaded(masses.tool_mass, state.kappa * masses.reach_mass) or state.calls > state.budget:
                break
            voxel = tuple(int(i) for i in np.unravel_index(flat, shape))
            inside, around = _weights_at(work, voxel)
            former = float(density[voxel])
            density[voxel] = former - inside * former
            taken = former - float(density[voxel])
            masses.tool_mass -= inside * taken
            masses.reach_mass -= around * taken
            state.emptied += taken
            pass_on(voxel, taken)
    finally:
        sys.setrecursionlimit(limit)
