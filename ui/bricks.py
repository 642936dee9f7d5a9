# SPDX-License-Identifier: GPL-3.0-or-later
"""Density by the brick: how much there is at most, so that empty bricks are passed in one step, and how much on the
whole, which is what a surface is shaded by: voxel by voxel it would be a staircase."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.bricks import BRICK, FULL, MIXED, BrickMap

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


def all_maxima(bricks: BrickMap) -> np.ndarray:
    """The `maxima` of a whole grid; read for them is only what its map does not tell."""
    most = (bricks.states == FULL).astype(np.float32) * np.float32(ROUNDED)
    first, last = uneven(bricks.states)
    most[_part(first, last)] = maxima(bricks.density, first, last)
    return most


def all_means(bricks: BrickMap, edge: int) -> np.ndarray:
    """The `means` of a whole grid; read for them is only what its map does not tell."""
    count = bricks_of(bricks.density.shape, edge)
    inside = [np.minimum(n - edge * np.arange(c), edge) / edge for n, c in zip(bricks.density.shape, count)]
    held = [np.arange(c) * edge // BRICK for c in count]
    full = (bricks.states == FULL)[np.ix_(*held)].astype(np.float32)
    total = full * np.multiply.outer(np.multiply.outer(*inside[:2]), inside[2]).astype(np.float32)
    uneven_bricks = uneven(bricks.states)
    first = [b * BRICK // edge for b in uneven_bricks[0]]
    last = [min(-(-b * BRICK // edge), c) for b, c in zip(uneven_bricks[1], count)]
    total[_part(first, last)] = means(bricks.density, edge, first, last)
    return total


def uneven(states: np.ndarray) -> tuple[Index, Index]:
    """A box around all bricks that are neither empty nor full, or are beside one that is something else: (first, last).

    All that lies within a voxel of any other brick, or in it, is as that is.
    """
    least = most = np.pad(states, 1, mode="edge")
    for axis in range(3):
        least, most = (np.moveaxis(side, axis, 0) for side in (least, most))
        least = np.minimum(np.minimum(least[:-2], least[1:-1]), least[2:])
        most = np.maximum(np.maximum(most[:-2], most[1:-1]), most[2:])
        least, most = (np.moveaxis(side, 0, axis) for side in (least, most))
    odd = np.nonzero((least != most) | (states == MIXED))
    if not len(odd[0]):
        return (0, 0, 0), (0, 0, 0)
    return tuple(int(i.min()) for i in odd), tuple(int(i.max()) + 1 for i in odd)


def _part(first: Index, last: Index) -> tuple[slice, ...]:
    return tuple(slice(a, b) for a, b in zip(first, last))


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
