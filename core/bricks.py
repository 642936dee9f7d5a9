# SPDX-License-Identifier: GPL-3.0-or-later
"""BrickMap: which bricks of a grid hold nothing, which are wholly full, and which have to be looked at."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_int64, c_void_p
from typing import TYPE_CHECKING, Any

import numpy as np

from .native import library

if TYPE_CHECKING:
    from .grid import Box

BRICK = 8
"""Edge of a brick in voxels. A grid grows, and remembers what it was, in whole bricks (OpenVDB's leaf is 8 as well)."""

EMPTY, FULL, MIXED = 0, 1, 2
"""What a brick may be: all its voxels are 0, all are exactly 1, or neither is known."""

_ONE = np.float32(1.0).view(np.uint32)


class BrickMap:
    """A byte for each brick of an array: what its voxels inside the grid are.

    Who writes voxels marks their bricks before, and settles them when done; a kernel does the first itself. What is not
    MIXED is so, or changes while mass is in flight, as the voxels themselves do: a thread that reads without a lock
    and heeds the push's epoch may go by it. A settled map is what a new one would be.

    Parameters
    ----------
    density
        The array, float32, C-contiguous; looked through once, unless ``states`` are given, uint8, a byte a brick.

    :attr:`looked_at` counts the bricks that were looked into.
    """

    def __init__(self, density: np.ndarray, states: np.ndarray | None = None) -> None:
        self.density = density
        self.looked_at = 0
        if states is None:
            self.states = np.full(layout_of(density.shape), MIXED, np.uint8)
            self.settle(None)
        else:
            self.states = np.ascontiguousarray(states)

    @property
    def empty(self) -> bool:
        """Whether there is nothing in the grid."""
        return not self.states.any()

    def mark(self, low: Sequence[int], high: Sequence[int]) -> None:
        """The voxels of the half-open box [low, high) may be written from here on (the numpy kernels' door)."""
        self.states[_bricks_in(low, high, self.density.shape)] = MIXED

    def settle(self, box: Box | None) -> None:
        """Find out anew what the marked bricks of a half-open box are; None: of the grid. The others are not read."""
        shape = self.density.shape
        part = _bricks_in(*(box or ((0, 0, 0), shape)), shape)
        kernels = library()
        if not kernels:
            self.looked_at += _classify_numpy(self.density, self.states, part)
            return
        first, last = (c_int64 * 3)(*(s.start for s in part)), (c_int64 * 3)(*(s.stop for s in part))
        density, states = c_void_p(self.density.ctypes.data), c_void_p(self.states.ctypes.data)
        self.looked_at += kernels.repousse_classify(density, (c_int64 * 3)(*shape), states, first, last)

    def changed(self, box: Box | None) -> None:
        """The voxels of a half-open box were written by somebody who did not mark them; None: any may have been."""
        low, high = box or ((0, 0, 0), self.density.shape)
        self.mark(low, high)
        self.settle((low, high))

    def grown(self, density: np.ndarray, below: tuple[int, int, int]) -> BrickMap:
        """The map of ``density``, which is this array with ``below`` empty voxels, whole bricks, before its first ones,
        and any number after its last."""
        states = np.zeros(layout_of(density.shape), np.uint8)
        first = [b // BRICK for b in below]
        kept = states[tuple(slice(f, f + n) for f, n in zip(first, self.states.shape, strict=True))]
        kept[...] = self.states
        for axis, (n, b, now) in enumerate(zip(self.density.shape, below, density.shape, strict=True)):
            if n % BRICK and now > n + b:  # the border cut these bricks; now they are longer by empty voxels
                cut = np.moveaxis(kept, axis, 0)[-1]
                cut[cut == FULL] = MIXED
        return BrickMap(density, states)


def layout_of(shape: Sequence[int]) -> tuple[int, ...]:
    """How many bricks along each axis hold ``shape`` voxels."""
    return tuple(-(-n // BRICK) for n in shape)


def boxes_of(chosen: np.ndarray) -> list[Box]:
    """Boxes that together hold what is true in an array with three axes, each once: rows that are alike are joined."""
    edges = np.diff(np.pad(chosen, ((0, 0), (0, 0), (1, 1))).astype(np.int8), axis=2)
    rows: list[list[list[tuple[int, int]]]] = [[[] for _ in plane] for plane in chosen]
    starts, ends = np.argwhere(edges > 0).tolist(), np.argwhere(edges < 0).tolist()
    for (x, y, z0), (_, _, z1) in zip(starts, ends, strict=True):
        rows[x][y].append((z0, z1))
    boxes = _unbroken([_unbroken(plane) for plane in rows])
    return [((x0, y0, z0), (x1, y1, z1)) for (((z0, z1), y0, y1), x0, x1) in boxes]


def _unbroken(layers: Sequence[Sequence[Any]]) -> list[tuple[Any, int, int]]:
    """What is in one layer after the other, each with the first of these and one past the last."""
    since: dict[Any, int] = {}
    found = []
    for number, layer in enumerate([*layers, ()]):
        ended = [key for key in since if key not in set(layer)]
        found += [(key, since.pop(key), number) for key in ended]
        since = dict.fromkeys(layer, number) | since
    return found


def _bricks_in(low: Sequence[int], high: Sequence[int], shape: Sequence[int]) -> tuple[slice, ...]:
    """The bricks that a half-open box touches, as far as it lies in the grid."""
    ends = ((max(a, 0) // BRICK, -(-min(b, n) // BRICK)) for a, b, n in zip(low, high, shape, strict=True))
    return tuple(slice(first, max(first, last)) for first, last in ends)


def _classify_numpy(density: np.ndarray, states: np.ndarray, part: tuple[slice, ...]) -> int:
    """Make the marked bricks of a part of the map what they are; returns how many those were."""
    marked = states[part] == MIXED
    if marked.any():
        bits = density[tuple(slice(s.start * BRICK, s.stop * BRICK) for s in part)].view(np.uint32)
        empty, full = _all_of(bits == 0), _all_of(bits == _ONE)
        states[part] = np.where(marked, np.where(empty, EMPTY, np.where(full, FULL, MIXED)), states[part])
    return int(marked.sum())


def _all_of(true: np.ndarray) -> np.ndarray:
    """By the brick, whether it is so in each of its voxels."""
    for axis in range(3):
        true = np.logical_and.reduceat(true, np.arange(0, true.shape[axis], BRICK), axis=axis)
    return true
