# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoothing: density evens out inside the tool and none is made or lost."""

from __future__ import annotations

from ctypes import byref, c_double, c_int64
from math import ceil

import numpy as np

from .native.state import Workspace, no_box
from .tool import Tool

TRAVEL = 0.25
"""Tool radii of travel from one smoothing to the next: holding still does nothing more."""

GREATEST_SHARE = 1.0 / 12.0
"""What two neighbours exchange of their difference, at full strength and wholly inside the tool. Up to 1/6 it is
stable; up to 1/12 no wave of density changes its sign either, so what is smoothed only ever gets smoother."""

NEGLIGIBLE = np.float32(1e-4)
"""Voxels whose densities differ by less exchange nothing, or a trace of density would creep into the air."""


def passes_of(tool: Tool) -> int:
    """Passes of one smoothing: a larger tool has coarser bumps to even out."""
    return ceil(tool.radius / 2.0)


def smooth(work: Workspace, strength: float, passes: int) -> float:
    """Let face neighbours exchange density inside the tool, ``passes`` times; returns the mass that was exchanged.

    A pair with coverages v and w exchanges ``strength`` v w / 12 of its difference: as much as one gains the other
    loses, and nothing crosses the tool's skin or the grid's border. ``work.sweep.dirty`` becomes the box that changed.
    """
    work.lay_box(0)
    work.sweep.dirty[:] = no_box()
    share = GREATEST_SHARE * strength
    if not work.library:
        exchanged = _smooth_numpy(work, share, passes)
    else:
        exchanged = float(
            work.library.repousse_smooth(
                byref(work.grid),
                byref(work.tool),
                c_double(share),
                c_int64(passes),
                byref(work.emptied),
                byref(work.sweep.dirty),
            )
        )
    (i, j, k), (ni, nj, nk) = work.emptied.low, work.emptied.n
    work.settle(((i, j, k), (i + ni, j + nj, k + nk)))  # more were marked than have changed
    return exchanged


def _smooth_numpy(work: Workspace, share: float, passes: int) -> float:
    low = [max(at, 0) for at in work.emptied.low]
    high = [
        min(at + n, limit) for at, n, limit in zip(work.emptied.low, work.emptied.n, work.density.shape, strict=True)
    ]
    if any(a >= b for a, b in zip(low, high, strict=True)):
        return 0.0
    offsets = np.ix_(*(np.arange(a, b) - c for a, b, c in zip(low, high, work.tool.centre, strict=True)))
    covered = work.volume.coverage(*offsets).astype(np.float32)
    inside = np.nonzero(covered)
    if not len(inside[0]):
        return 0.0
    work.keep(
        [int(i.min()) + a for i, a in zip(inside, low, strict=True)],
        [int(i.max()) + a + 1 for i, a in zip(inside, low, strict=True)],
    )
    density = work.density[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    weights, exchanged = np.pad(covered, 1), 0.0
    for _ in range(passes):
        former = np.pad(density, 1)
        x, y, z = (_brought(former, weights, axis) for axis in range(3))
        density[:] = former[1:-1, 1:-1, 1:-1] + np.float32(share) * weights[1:-1, 1:-1, 1:-1] * ((x + y) + z)
        change = np.abs(density - former[1:-1, 1:-1, 1:-1])
        exchanged += float(change.sum(dtype=np.float64)) / 2.0
        changed = np.nonzero(change)
        for a, index in enumerate(changed if len(changed[0]) else ()):
            work.sweep.dirty[a] = min(work.sweep.dirty[a], int(index.min()) + low[a])
            work.sweep.dirty[3 + a] = max(work.sweep.dirty[3 + a], int(index.max()) + low[a] + 1)
    return exchanged


def _brought(density: np.ndarray, weights: np.ndarray, axis: int) -> np.ndarray:
    """What both neighbours along an axis bring to each voxel, for each unit of what is exchanged."""
    inner = [slice(1, -1)] * 3
    here, both = density[tuple(inner)], []
    for side in (slice(None, -2), slice(2, None)):
        inner[axis] = side
        more = density[tuple(inner)] - here
        both.append(np.where(np.abs(more) > NEGLIGIBLE, weights[tuple(inner)] * more, np.float32(0.0)))
    return both[0] + both[1]
