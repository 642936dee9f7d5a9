# SPDX-License-Identifier: GPL-3.0-or-later
"""History: before-images of the bricks that a stroke changes, from which a grid is restored bit for bit.

The kernels copy a brick just before its first voxel is written; of one that is empty or full they only note that. The
arrays are as large as the grid, but memory is taken only for what is kept: the system gives a page when it is first
written.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_float, c_int64, c_uint8
from threading import Lock

import numpy as np

from .bricks import BRICK, EMPTY, FULL, MIXED, BrickMap
from .grid import Box, DensityGrid
from .native.state import Workspace, pointer

AS_EMPTY, AS_FULL = -1 - EMPTY, -1 - FULL
"""Entries of kept bricks that have no image; others are the image's number, from 1."""


class _Bricks:
    """The bricks of one array, and the images of those that were kept: by number, as they came, in ``entries``.

    When the grid grows it lives in another array, which gets its own; who still reads the former finds it as it was.
    """

    def __init__(self, density: np.ndarray, begin: np.ndarray, former: _Bricks | None = None) -> None:
        self.density = density
        self.begin = begin  # of the grid as it was when the history began, in this array
        self.layout = tuple(-(-n // BRICK) for n in density.shape)
        total = int(np.prod(self.layout))
        self.images = np.empty((total, BRICK, BRICK, BRICK), np.float32)
        self.bricks, self.entries = np.empty((2, total), np.int64)
        self.kept = np.zeros(total, np.uint8)
        self.count, self.image_count = np.zeros((2, 1), np.int64)
        self._numbers = np.zeros(total, np.int32)  # each brick's entry; 0 as long as nobody asked
        self._numbered = 0
        self._asking = Lock()
        if former is not None:
            n, moved = int(former.count[0]), former.places() + (begin - former.begin) // BRICK
            self.image_count[0] = images = int(former.image_count[0])
            self.images[:images] = former.images[:images]
            self.entries[:n] = former.entries[:n]
            self.bricks[:n] = np.ravel_multi_index(tuple(moved.T), self.layout)
            self.kept[self.bricks[:n]] = 1
            self.count[0] = n

    def places(self) -> np.ndarray:
        """Where the kept bricks are in this array, counted in bricks: shape (n, 3)."""
        return np.stack(np.unravel_index(self.bricks[: self.count[0]], self.layout), axis=1)

    def numbers(self, bricks: np.ndarray) -> np.ndarray:
        """The entry of each of these bricks (flat indices), or 0 where it is not kept yet."""
        with self._asking:
            count = int(self.count[0])
            fresh = slice(self._numbered, count)
            self._numbers[self.bricks[fresh]] = self.entries[fresh]
            self._numbered = count
        return self._numbers[bricks]


class History:
    """What a grid was when this was made, for as long as every change goes through the workspaces it is attached to."""

    def __init__(self, grid: DensityGrid, carry: float = 0.0) -> None:
        self.carry = carry  # what rounding owed when this began: a push that is restored goes on as it would have
        self._shape, self._transform = grid.shape, grid.transform.copy()
        self._now = _Bricks(grid.density, np.zeros(3, np.int64))

    @property
    def bricks(self) -> int:
        """How many bricks have been kept."""
        return int(self._now.count[0])

    @property
    def images(self) -> int:
        """How many of them have an image."""
        return int(self._now.image_count[0])

    @property
    def nbytes(self) -> int:
        """Memory that the kept bricks take: their images, and where each is and what."""
        return self.images * BRICK**3 * 4 + self.bricks * 2 * 8

    @property
    def touched(self) -> Box | None:
        """A box around all bricks that have been kept, in the frame and within the bounds of the grid as it was."""
        low = self._now.places() * BRICK - self._now.begin
        low = low[((low + BRICK > 0) & (low < self._shape)).all(axis=1)]
        if not len(low):
            return None
        (i0, j0, k0), (i1, j1, k1) = np.maximum(low.min(axis=0), 0), np.minimum(low.max(axis=0) + BRICK, self._shape)
        return (int(i0), int(j0), int(k0)), (int(i1), int(j1), int(k1))

    def original(self, indices: np.ndarray) -> np.ndarray:
        """Densities as they were when this began, at whole voxels of that time: (n, 3) integers -> (n,) float32.

        Outside the grid of that time it is 0. Any thread may ask while another pushes and grows the grid: a density is
        read first, and only then is it asked whether its brick has been kept. If not, nobody had written it yet.
        """
        now = self._now  # once: a growth meanwhile puts another in its place, and leaves this one as it is
        at = np.array(np.asarray(indices, dtype=np.int64).T, order="C")
        nx, ny, nz = self._shape
        x, y, z = at
        inside = (x >= 0) & (x < nx) & (y >= 0) & (y < ny) & (z >= 0) & (z < nz)
        if inside.all():
            return self._original_inside(now, at)
        values = np.zeros(len(inside), np.float32)
        values[inside] = self._original_inside(now, at[:, inside])
        return values

    @staticmethod
    def _original_inside(now: _Bricks, at: np.ndarray) -> np.ndarray:
        at += now.begin[:, None]
        x, y, z = at
        _, ny, nz = now.density.shape
        values = now.density.reshape(-1)[(x * ny + y) * nz + z]
        places = at // BRICK
        i, j, k = places
        _, nj, nk = now.layout
        number = now.numbers((i * nj + j) * nk + k)
        values[number == AS_EMPTY] = 0.0
        values[number == AS_FULL] = 1.0
        kept = np.nonzero(number > 0)[0]
        if len(kept):
            x, y, z = at[:, kept] - BRICK * places[:, kept]
            values[kept] = now.images[number[kept] - 1, x, y, z]
        return values

    def origin_in(self, origin: tuple[int, int, int]) -> tuple[int, int, int]:
        """Where the first voxel lay when this began, in the frame in which it now lies at ``origin``."""
        x, y, z = (int(o + b) for o, b in zip(origin, self._now.begin, strict=True))
        return x, y, z

    def attach(self, work: Workspace) -> None:
        """From now on the kernels keep bricks here."""
        now, work.history = self._now, self
        work.grid.kept, work.grid.images = pointer(now.kept, c_uint8), pointer(now.images, c_float)
        work.grid.bricks, work.grid.entries = pointer(now.bricks, c_int64), pointer(now.entries, c_int64)
        work.grid.kept_count, work.grid.image_count = pointer(now.count, c_int64), pointer(now.image_count, c_int64)

    def detach(self, work: Workspace) -> None:
        """The kernels keep no more bricks."""
        work.history = None
        work.grid.kept = None

    def keep(self, low: Sequence[int], high: Sequence[int], known: BrickMap | None) -> None:
        """Keep the bricks of the half-open box [low, high) that are not kept yet, with an image of those that ``known``
        does not say all of (the numpy kernels' door)."""
        now = self._now
        first, last = np.array(low) // BRICK, (np.array(high) - 1) // BRICK + 1
        block = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
        for offset in np.argwhere(now.kept.reshape(now.layout)[block] == 0):
            place, number = first + offset, self.bricks
            brick = np.ravel_multi_index(tuple(place), now.layout)
            state = MIXED if known is None else known.states[tuple(place)]
            if state == MIXED:
                image = now.density[tuple(slice(p * BRICK, (p + 1) * BRICK) for p in place)]
                now.images[self.images][tuple(slice(0, n) for n in image.shape)] = image
                now.image_count[0] += 1
            now.bricks[number], now.entries[number] = brick, self.images if state == MIXED else -1 - int(state)
            now.kept[brick] = 1
            now.count[0] = number + 1  # last: who asks meanwhile finds it whole, or not at all

    def grew(self, density: np.ndarray, below: tuple[int, int, int]) -> None:
        """The grid now lives in ``density``, with ``below`` voxels (whole bricks) before its former first ones.

        Every push of a grid says so when it notices; a growth counts once.
        """
        if density is self._now.density:
            return
        self._now = _Bricks(density, self._now.begin + below, self._now)

    def restore(self, grid: DensityGrid) -> None:
        """Make ``grid`` what it was when this history began: density, shape and transform, bit for bit."""
        now = self._now
        begin, end = now.begin, now.begin + self._shape
        low = now.places() * BRICK
        first, last = np.maximum(low, begin), np.minimum(low + BRICK, end)
        inside = np.nonzero((first < last).all(axis=1))[0]
        corners = (corner[inside].tolist() for corner in (low, first, last))
        for entry, (i, j, k), (i0, j0, k0), (i1, j1, k1) in zip(now.entries[inside].tolist(), *corners, strict=True):
            was: np.ndarray | float = float(entry == AS_FULL)
            if entry > 0:
                was = now.images[entry - 1, i0 - i : i1 - i, j0 - j : j1 - j, k0 - k : k1 - k]
            grid.density[i0:i1, j0:j1, k0:k1] = was
        if grid.shape != self._shape:
            part = grid.density[tuple(slice(a, b) for a, b in zip(begin, end, strict=True))]
            grid.swap(BrickMap(np.ascontiguousarray(part)))
        else:
            kept = slice(0, int(now.count[0]))
            entries = now.entries[kept]
            grid.bricks.states.reshape(-1)[now.bricks[kept]] = np.where(entries > 0, MIXED, -1 - entries)
        grid.transform = self._transform.copy()
