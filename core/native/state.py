# SPDX-License-Identifier: GPL-3.0-or-later
"""The memory that a push works in: the structures that kernels read and write, and the scratch that they point to."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import POINTER, c_double, c_float, c_int64, c_uint8
from math import ceil, floor
from typing import Any, Protocol

import numpy as np

from ..bricks import BRICK, BrickMap
from ..grid import Box
from ..tool import Shape, Tool
from . import library
from .structures import (
    CELL_BYTES,
    LATTICE,
    SIGHT_CELL,
    Emptied,
    Estimate,
    GridState,
    Rim,
    ShapeState,
    Sources,
    Sweep,
    ToolState,
)

ORDERS = ((0, 1, 2), (1, 0, 2), (2, 0, 1))
"""For each dominant axis, the axes in the order (a, b, c): swept along a, in rows along c."""

SLAB_PLANES = 16
DONE, NEEDS_GROWTH, LIST_FULL = 0, 1, 2
BORDERS = ("grow", "wall", "open")
GROW, WALL, OPEN = 0, 1, 2

_FAR = np.iinfo(np.int64).max


class Keeper(Protocol):
    """Who keeps before-images (core/history.py)."""

    def keep(self, low: Sequence[int], high: Sequence[int], known: BrickMap | None) -> None:
        """Copy the bricks of a half-open box that are not kept yet, but for those that ``known`` says all of."""
        ...

    def grew(self, density: np.ndarray, below: tuple[int, int, int]) -> None:
        """The grid now lives in another array."""
        ...

    def attach(self, work: Workspace) -> None:
        """Tell the kernels where to keep bricks."""
        ...


def pointer(array: np.ndarray, kind: type) -> Any:
    """A ctypes pointer to an array's memory; the caller keeps the array."""
    return array.ctypes.data_as(POINTER(kind))


def shape_state(shape: Shape) -> ShapeState:
    """A shape as the kernels read it."""
    ball = not any(shape.half_size) and not any(shape.half_axis)
    return ShapeState((c_double * 3)(*shape.half_size), (c_double * 3)(*shape.half_axis), shape.radius, ball)


def no_box() -> tuple[int, ...]:
    """An empty dirty box: what `mark_dirty` in kernels.c starts from."""
    return (_FAR, _FAR, _FAR, -_FAR, -_FAR, -_FAR)


def box_from(dirty: Sequence[int]) -> Box | None:
    """A dirty box as Python has it, or None when nothing was written."""
    i0, j0, k0, i1, j1, k1 = dirty
    return ((i0, j0, k0), (i1, j1, k1)) if i0 < i1 else None


class Probe:
    """One grid and one tool, as far as `estimate` reads them: what feels without changing anything.

    ``grid``, ``tool`` and ``estimate`` are structures of kernels.c, ``density`` is the array behind them and ``bricks``
    its map, or None: then all is read. A thread that estimates while another pushes has a probe of its own.
    """

    def __init__(self, density: np.ndarray, bricks: BrickMap | None = None) -> None:
        self.library = library()
        self.grid, self.tool, self.estimate = GridState(), ToolState(), Estimate()
        self.attach(density, bricks)

    def attach(self, density: np.ndarray, bricks: BrickMap | None) -> None:
        """Work on this array from now on, and go by its map."""
        self.density, self.bricks = density, bricks
        self.grid.density = pointer(density, c_float)
        self.grid.shape[:] = density.shape
        self.grid.states = pointer(bricks.states, c_uint8) if bricks is not None else None

    def take_up(self, tool: Tool) -> None:
        """Work with this tool from now on."""
        self.volume, self.surroundings = tool.volume, tool.surroundings
        self.tool.volume, self.tool.surroundings = shape_state(self.volume), shape_state(self.surroundings)


class Workspace(Probe):
    """One grid, one tool, and all scratch of a push; allocated once, so that a step allocates nothing.

    Attributes beside a probe's are the structures of kernels.c (``emptied``, ``sweep``, ``sources``, ``rim``);
    ``buffer``, the array behind what is emptied; and ``flux``, the numpy twin's in the running sweep.
    """

    def __init__(self, density: np.ndarray, bricks: BrickMap | None = None) -> None:
        self.emptied, self.sweep, self.sources, self.rim = Emptied(), Sweep(), Sources(), Rim()
        self.flux = np.zeros((0, 0), np.float32)
        self.buffer = np.zeros(0, np.float32)
        self.history: Keeper | None = None
        self._fluxes: list[np.ndarray] = []
        super().__init__(density, bricks)

    def attach(self, density: np.ndarray, bricks: BrickMap | None, sweeping: bool = False) -> None:
        """Work on this array from now on; the flux of a sweep that is under way is carried over."""
        super().attach(density, bricks)
        nx, ny, nz = density.shape
        former = [f for f in self._fluxes if sweeping and f.ctypes.data == ctypes.addressof(self.sweep.flux.contents)]
        cells = (max(nx, ny) + 24) * (max(ny, nz) + 48)  # the largest window, a leap's frame, and whole lanes
        self._fluxes = [np.empty(cells, np.float32), np.empty(cells, np.float32)]
        for flux in former:
            self._fluxes[0][: flux.size] = flux
        self.sweep.flux, self.sweep.next = (pointer(flux, c_float) for flux in self._fluxes)
        self._row = np.empty(max(density.shape) + 16, np.float32)
        self._slab = np.empty(SLAB_PLANES * nx * ny, np.float32)
        self.sweep.row, self.sweep.slab = pointer(self._row, c_float), pointer(self._slab, c_float)
        self._zeros = np.zeros(nz, np.float32)
        self.rim.zeros = pointer(self._zeros, c_float)
        cells = ceil(ny / SIGHT_CELL + 2) * ceil(nz / SIGHT_CELL + 2)
        self._cells = np.zeros(cells * CELL_BYTES, np.uint8)
        self._lattice = np.empty(LATTICE**3, np.float32)
        self.rim.cells, self.rim.lattice = self._cells.ctypes.data, pointer(self._lattice, c_float)

    def keep(self, low: Sequence[int], high: Sequence[int]) -> None:
        """Before a box is written: copy its bricks, once, if anyone asked for before-images, and mark them."""
        if self.history is not None:
            self.history.keep(low, high, self.bricks)
        if self.bricks is not None:
            self.bricks.mark(low, high)

    def settle(self, box: Box | None) -> None:
        """After a box was written: what are its bricks now? None: those of the grid."""
        if self.bricks is not None:
            self.bricks.settle(box)

    def take_up(self, tool: Tool) -> None:
        """Work with this tool from now on."""
        super().take_up(tool)
        self._half_box = tuple(ceil(e + 0.5) for e in self.volume.extent)
        voxels = int(np.prod([2 * h + 3 for h in self._half_box]))
        if voxels > self.buffer.size:  # a tool whose radius follows a pen does not allocate at every pose
            self.buffer = np.zeros(voxels, np.float32)
            self._occupied = np.empty((voxels, 3))  # 24 bytes for each voxel of the box
            self.emptied.buffer = pointer(self.buffer, c_float)
            self.emptied.occupied = self._occupied.ctypes.data
        self.emptied.first[:], self.emptied.last[:] = (0, 0, 0), (0, 0, 0)

    def lay_box(self, axis: int) -> None:
        """Lay the box of `emptied` around the tool, in the order of a push along ``axis``."""
        self.emptied.axis = axis
        for slot, a in enumerate(ORDERS[axis]):
            self.emptied.low[slot] = floor(self.tool.centre[a]) - self._half_box[a] - 1
            self.emptied.n[slot] = 2 * self._half_box[a] + 3

    @property
    def emptied_box(self) -> np.ndarray:
        """The box of `emptied` as an array in (a, b, c) order, a view."""
        return self.buffer[: int(np.prod(self.emptied.n[:]))].reshape(self.emptied.n[:])

    @property
    def emptied_part(self) -> np.ndarray:
        """The part of that box in which anything was emptied, a view."""
        first, last, low = self.emptied.first, self.emptied.last, self.emptied.low
        return self.emptied_box[tuple(slice(f - o, t - o) for f, t, o in zip(first, last, low, strict=True))]

    def reserve_rim(self, capacity: int) -> None:
        """Make the rim's list hold ``capacity`` voxels."""
        self._index, self._spill_index = np.empty((2, capacity), np.int64)
        self._weight, self._spill = np.empty((2, capacity), np.float32)
        self.rim.index, self.rim.weight = pointer(self._index, c_int64), pointer(self._weight, c_float)
        self.rim.spill_index, self.rim.spill = pointer(self._spill_index, c_int64), pointer(self._spill, c_float)
        self.rim.capacity = capacity

    @property
    def rim_list(self) -> tuple[np.ndarray, np.ndarray]:
        """Places (int64, `place_of` in kernels.c) and weights (float32) of the rim's list, views of its capacity."""
        return self._index, self._weight

    def moved(self, below: tuple[int, int, int]) -> None:
        """The grid has grown by ``below`` voxels before its first ones: all indices that are under way follow."""
        order = ORDERS[self.emptied.axis]
        for a in range(3):
            self.tool.centre[a] += below[a]
        for slot, a in enumerate(order):
            self.emptied.low[slot] += below[a]
            self.emptied.first[slot] += below[a]
            self.emptied.last[slot] += below[a]
        self.sweep.plane += below[order[0]]
        for side in range(2):
            shift = below[order[1 + side]]
            self.sweep.origin[side] += shift
            self.sweep.window[2 * side] += shift
            self.sweep.window[2 * side + 1] += shift
        for points, shift in zip((self.sources.x, self.sources.y, self.sources.z), below, strict=True):
            for q in range(self.sources.count):
                points[q] += shift
        for dirty in (self.sweep.dirty, self.rim.dirty):
            for a in range(3):
                if dirty[a] < dirty[3 + a]:
                    dirty[a] += below[a]
                    dirty[3 + a] += below[a]


assert BRICK == 8, "kernels.c has the edge of a brick as a constant"
