# SPDX-License-Identifier: GPL-3.0-or-later
"""History: before-images of the bricks that a stroke changes, from which a grid is restored bit for bit.

The kernels copy a brick just before its first voxel is written. The arrays are as large as the grid, but memory is
taken only for the bricks that are kept: the system gives a page when it is first written.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_float, c_int64, c_uint8

import numpy as np

from .grid import BRICK, DensityGrid
from .native.state import Workspace, pointer


class History:
    """What a grid was when this was made, for as long as every change goes through the workspace it is attached to."""

    def __init__(self, grid: DensityGrid, carry: float = 0.0) -> None:
        self.carry = carry  # what rounding owed when this began: a push that is restored goes on as it would have
        self._density = grid.density
        self._shape, self._transform = grid.shape, grid.transform.copy()
        self._offset = np.zeros(3, np.int64)
        self._images = np.empty((0, BRICK, BRICK, BRICK), np.float32)
        self._bricks = np.empty(0, np.int64)
        self._count = np.zeros(1, np.int64)
        self._lay_out(np.empty((0, 3), np.int64))

    def _lay_out(self, places: np.ndarray) -> None:
        """Make tables for the present array; ``places`` (n, 3) are where the bricks kept so far now are."""
        self._layout = tuple(-(-n // BRICK) for n in self._density.shape)
        total = int(np.prod(self._layout))
        images, bricks = np.empty((total, BRICK, BRICK, BRICK), np.float32), np.empty(total, np.int64)
        kept = np.zeros(total, np.uint8)
        images[: len(places)] = self._images[: len(places)]
        bricks[: len(places)] = np.ravel_multi_index(tuple(places.T), self._layout)
        kept[bricks[: len(places)]] = 1
        self._images, self._bricks, self._kept = images, bricks, kept

    @property
    def bricks(self) -> int:
        """How many bricks have been kept."""
        return int(self._count[0])

    @property
    def nbytes(self) -> int:
        """Memory that the kept bricks take."""
        return self.bricks * BRICK**3 * 4

    def origin_in(self, origin: tuple[int, int, int]) -> tuple[int, int, int]:
        """Where the first voxel lay when this began, in the frame in which it now lies at ``origin``."""
        x, y, z = (int(o + b) for o, b in zip(origin, self._offset, strict=True))
        return x, y, z

    def attach(self, work: Workspace) -> None:
        """From now on the kernels keep bricks here."""
        work.history = self
        work.grid.kept, work.grid.images = pointer(self._kept, c_uint8), pointer(self._images, c_float)
        work.grid.bricks, work.grid.kept_count = pointer(self._bricks, c_int64), pointer(self._count, c_int64)

    def detach(self, work: Workspace) -> None:
        """The kernels keep no more bricks."""
        work.history = None
        work.grid.kept = None

    def keep(self, low: Sequence[int], high: Sequence[int]) -> None:
        """Copy the bricks of the half-open box [low, high) that are not kept yet (the numpy kernels' door)."""
        first, last = np.array(low) // BRICK, (np.array(high) - 1) // BRICK + 1
        block = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
        for offset in np.argwhere(self._kept.reshape(self._layout)[block] == 0):
            place = first + offset
            brick = np.ravel_multi_index(tuple(place), self._layout)
            image = self._density[tuple(slice(p * BRICK, (p + 1) * BRICK) for p in place)]
            self._images[self.bricks][tuple(slice(0, n) for n in image.shape)] = image
            self._bricks[self.bricks] = brick
            self._kept[brick] = 1
            self._count[0] += 1

    def grew(self, density: np.ndarray, below: tuple[int, int, int]) -> None:
        """The grid now lives in ``density``, with ``below`` voxels (whole bricks) before its former first ones."""
        places = np.stack(np.unravel_index(self._bricks[: self.bricks], self._layout), axis=1)
        self._density = density
        self._offset += below
        self._lay_out(places + np.array(below) // BRICK)

    def restore(self, grid: DensityGrid) -> None:
        """Make ``grid`` what it was when this history began: density, shape and transform, bit for bit."""
        begin, end = self._offset, self._offset + self._shape
        for image, brick in zip(self._images[: self.bricks], self._bricks, strict=False):
            low = np.array(np.unravel_index(brick, self._layout)) * BRICK
            a, b = np.maximum(low, begin), np.minimum(low + BRICK, end)
            if (a < b).all():
                inside = tuple(slice(p - q, r - q) for p, q, r in zip(a, low, b, strict=True))
                grid.density[tuple(slice(p, r) for p, r in zip(a, b, strict=True))] = image[inside]
        if grid.shape != self._shape:
            grid.density = np.ascontiguousarray(
                grid.density[tuple(slice(a, b) for a, b in zip(begin, end, strict=True))]
            )
        grid.transform = self._transform.copy()
