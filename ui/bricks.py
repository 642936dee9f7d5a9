# SPDX-License-Identifier: GPL-3.0-or-later
"""Density by the brick: how much there is at most, so that empty bricks are passed in one step, and how much on the
whole, which is what a surface is shaded by: voxel by voxel it would be a staircase."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.grid import BRICK

ROUNDED = 1.0 + 2.0**-9
"""Half floats round, and some drivers cut off; what is told of the most is an upper bound."""

Index = Sequence[int]


def bricks_of(shape: Index, edge: int = BRICK) -> tuple[int, ...]:
    """How many bricks of this edge along each axis hold a grid of ``shape`` voxels."""
    return tuple(-(-n // edge) for n in shape)


def maxima(density: np.ndarray, first: Index, last: Index) -> np.ndarray:
    """The most there is in bricks from ``first`` up to ``last`` (indices of bricks), float32.

    No density that is interpolated within a brick exceeds it, so the voxels that touch it count as well.
    """
    low = [max(b * BRICK - 1, 0) for b in first]
    most = density[tuple(slice(a, b * BRICK + 1) for a, b in zip(low, last))]
    for axis in range(3):
        start, count = first[axis] * BRICK - low[axis], last[axis] - first[axis]
        most = _folded(np.maximum, most, axis, BRICK, start, count, range(-1, BRICK + 1))
    return most * np.float32(ROUNDED)


def means(density: np.ndarray, edge: int, first: Index, last: Index) -> np.ndarray:
    """The mean of each brick of ``edge`` voxels from ``first`` up to ``last`` (indices of such bricks), float32.

    Outside the grid there is 0.
    """
    total = density[tuple(slice(a * edge, b * edge) for a, b in zip(first, last))]
    for axis in range(3):
        total = _folded(np.add, total, axis, edge, 0, last[axis] - first[axis], range(edge))
    return total * np.float32(edge**-3)


def _folded(
    operation: np.ufunc, values: np.ndarray, axis: int, edge: int, start: int, count: int, offsets: range
) -> np.ndarray:
    """An axis by the brick: what the operation makes of the slices at ``offsets`` from where each brick begins."""
    slices = np.moveaxis(values, axis, 0)
    folded = np.zeros((count, *slices.shape[1:]), np.float32)
    for offset in offsets:
        skipped = int(start + offset < 0)  # before the first brick there is nothing
        met = slices[start + offset + skipped * edge :: edge][: count - skipped]
        part = folded[skipped : skipped + len(met)]
        operation(part, met, out=part)
    return np.moveaxis(folded, 0, axis)
