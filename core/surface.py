# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface: where a line of sight first meets the visible density of a grid, and which way is out there.

Nothing is extracted or kept: a ray reads the voxels that it passes, and no others.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, copysign, floor, prod, sqrt

import numpy as np

from .grid import DensityGrid
from .history import History
from .tool import Vector, vector

LEAST_LEVEL = 1e-6
"""A level of 0 is taken as this: all that is not empty."""
CELLS_AT_ONCE = 128
"""Cells that are first looked at, then twice as many, and so on: near surfaces are cheap, far ones take few calls."""
SMOOTHED = 2.5
"""Standard deviations of the normal's bell that are summed."""
FINEST_BELL = 0.5
"""Voxels of standard deviation, at least: a finer bell would see no neighbour."""

_SHORTEST = 1e-9  # voxels of a ray in a cell: less is the rounding of a corner
_HALVINGS = 40  # of at most a cell's diagonal: 2e-12 voxels
_FLAT = 1e-6  # density a voxel, or cosine, that is no slope
_ROUNDING = 1e-12  # by which a density may be under the level that it has
_CORNERS = np.array([0, 1])

Cubic = tuple[float, float, float, float]  # its coefficients, constant first


@dataclass(frozen=True)
class Hit:
    """A point of the surface, in voxels, and the unit normal that leads out of the material there."""

    position: Vector
    normal: Vector


class Surface:
    """The surface at ``level`` of a grid's trilinear density, 0 outside the grid.

    Parameters
    ----------
    grid
        The grid as it lives; positions are in its index frame.
    level
        Density, over 0 to 1, from which on material is seen.
    history
        With one that has just begun, voxels are and lie as they do now, whatever pushes do to the grid from here on:
        positions are in the frame of the poses, and threads that push meanwhile are no matter.

    ``voxels_read`` counts the densities that all rays so far have asked for.
    """

    def __init__(self, grid: DensityGrid, level: float, history: History | None = None) -> None:
        self.grid, self.level, self.history = grid, max(float(level), LEAST_LEVEL), history
        self.voxels_read = 0
        self._shape = grid.shape

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along each axis of the grid that is seen."""
        return self.grid.shape if self.history is None else self._shape

    def hit(self, origin: Iterable[float], direction: Iterable[float], smoothing: float = 2.0) -> Hit | None:
        """What a ray meets first; None where it meets nothing. See `meet` and `normal`."""
        position = self.meet(origin, direction)
        return None if position is None else Hit(position, self.normal(position, direction, smoothing))

    def meet(self, origin: Iterable[float], direction: Iterable[float]) -> Vector | None:
        """The first point along a ray whose density is the level or more; None where there is none.

        ``origin`` and ``direction`` are in voxels. A ray that begins in material meets it where it begins.

        Raises
        ------
        ValueError
            When the origin or direction is not finite, or the direction has no length.
        """
        start, way = np.array(vector(origin)), _unit(direction)
        if not np.isfinite(start).all():
            raise ValueError(f"a ray begins at a finite point, not at {origin}")
        span = self._span(start, way)
        if span is None:
            return None
        start = start + span[0] * way  # from here on, or a far viewpoint would cost digits
        along = self._first(start, way, span[1] - span[0])
        return None if along is None else vector(start + along * way)

    def normal(self, position: Iterable[float], direction: Iterable[float], smoothing: float = 2.0) -> Vector:
        """The outward unit normal at a point of the surface that a ray along ``direction`` has met.

        It is against the gradient of density under a bell with a standard deviation of ``smoothing`` voxels; of density
        itself where the smoothed one does not face the ray (a thin sheet before a thick one); and against the ray where
        that fades.
        """
        place, way = np.array(vector(position)), _unit(direction)
        for rising in (self._smoothed_gradient(place, smoothing), self._gradient(place)):
            length = float(np.sqrt(rising @ rising))
            if length > _FLAT and float(rising @ way) > _FLAT * length:
                return vector(-rising / length)
        return vector(-way)

    def _span(self, start: np.ndarray, way: np.ndarray) -> tuple[float, float] | None:
        """The part of a ray, in voxels from its start, on which there may be density."""
        first, last = 0.0, np.inf
        for p, u, n in zip(start.tolist(), way.tolist(), self.shape, strict=True):
            if u == 0.0:
                if not -1.0 < p < n:
                    return None
                continue
            enter, leave = sorted(((-1.0 - p) / u, (n - p) / u))
            first, last = max(first, enter), min(last, leave)
        return (first, last) if first < last else None

    def _first(self, start: np.ndarray, way: np.ndarray, length: float) -> float | None:
        """How far along the ray its density first is the level or more."""
        knots = _knots(start, way, length)
        begin, count = 0, CELLS_AT_ONCE
        while begin < len(knots) - 1:
            part = knots[begin : begin + count + 1]
            found = self._first_in_cells(start, way, part[:-1], np.diff(part))
            if found is not None:
                return found
            begin, count = begin + count, 2 * count
        return None

    def _first_in_cells(
        self, start: np.ndarray, way: np.ndarray, enter: np.ndarray, inside: np.ndarray
    ) -> float | None:
        """The same in the cells that the ray enters at ``enter`` (n,) and stays in for ``inside`` (n,).

        Only a cell one of whose corners has the level can hold it, and along a ray density is a cubic in each: so
        nothing is missed, however thin and however grazed.
        """
        cells = np.floor(start + (enter + inside / 2.0)[:, None] * way).astype(np.int64)
        corners = self._corners(cells)
        for cell in np.flatnonzero(corners.reshape(len(cells), 8).max(axis=1) >= self.level):
            entry, travel = start + enter[cell] * way - cells[cell], inside[cell] * way
            cubic = _cubic(corners[cell].ravel().tolist(), entry.tolist(), travel.tolist())
            part = self._rise(cubic)
            if part is not None:
                return float(enter[cell] + part * inside[cell])
        return None

    def _rise(self, cubic: Cubic) -> float | None:
        """The first place in 0 to 1 at which a cubic has the level or more."""
        low = 0.0
        for high in (0.0, *_turning_points(cubic), 1.0):
            if _value(cubic, high) >= self.level - _ROUNDING:
                break
            low = high
        else:
            return None
        for _ in range(_HALVINGS if high > low else 0):
            middle = 0.5 * (low + high)
            if _value(cubic, middle) < self.level:
                low = middle
            else:
                high = middle
        return high

    def _gradient(self, position: np.ndarray) -> np.ndarray:
        """Gradient of the trilinear density, per voxel."""
        cell = np.floor(position).astype(np.int64)
        corners, part = self._corners(cell[None])[0].astype(np.float64), position - cell
        at = [np.array([1.0 - p, p]) for p in part]
        rise = np.array([-1.0, 1.0])
        x, y, z = (np.einsum("ijk,i,j,k", corners, *at[:a], rise, *at[a + 1 :]) for a in range(3))
        return np.array([x, y, z])

    def _smoothed_gradient(self, position: np.ndarray, smoothing: float) -> np.ndarray:
        """Gradient of the density under a bell, to a common factor."""
        smoothing = max(smoothing, FINEST_BELL)
        reach = SMOOTHED * smoothing
        low = np.ceil(position - reach)
        at = low[:, None] + np.arange(int(2.0 * reach) + 1)
        off = at - position[:, None]
        bells = np.exp(-0.5 * (off / smoothing) ** 2)
        bells /= bells.sum(axis=1, keepdims=True)
        slopes = bells * (off - (bells * off).sum(axis=1, keepdims=True))  # none in uniform density, however it is cut
        x, y, z = at.astype(np.int64)
        block = self._read(x[:, None, None], y[:, None], z).astype(np.float64)
        along_z = block @ bells[2]
        along_yz = along_z @ bells[1]
        return np.array(
            [slopes[0] @ along_yz, bells[0] @ (along_z @ slopes[1]), bells[0] @ (block @ slopes[2] @ bells[1])]
        )

    def _corners(self, cells: np.ndarray) -> np.ndarray:
        """Densities at the eight corners of cells (n, 3), as (n, 2, 2, 2)."""
        x, y, z = (cells[:, a, None] + _CORNERS for a in range(3))
        return self._read(x[:, :, None, None], y[:, None, :, None], z[:, None, None, :])

    def _read(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Densities at indices that broadcast; 0 outside the grid."""
        shape = np.broadcast_shapes(x.shape, y.shape, z.shape)
        self.voxels_read += prod(shape)
        if self.history is not None:
            indices = np.empty((*shape, 3), np.int64)
            indices[..., 0], indices[..., 1], indices[..., 2] = x, y, z
            return self.history.original(indices.reshape(-1, 3)).reshape(shape)
        density = self.grid.density
        inside, flat = np.True_, np.int64(0)
        for at, n in zip((x, y, z), density.shape, strict=True):
            inside = inside & ((at >= 0) & (at < n))
            flat = flat * n + np.clip(at, 0, n - 1)
        return density.reshape(-1)[flat] * inside


def _unit(direction: Iterable[float]) -> np.ndarray:
    way = np.array(vector(direction))
    length = float(np.sqrt(way @ way))
    if not (np.isfinite(length) and length > 0.0):
        raise ValueError(f"a ray's direction is finite and has a length, unlike {direction}")
    return way / length


def _knots(start: np.ndarray, way: np.ndarray, length: float) -> np.ndarray:
    """Where a ray enters and leaves each cell between voxel centres: sorted, from 0 to ``length``."""
    knots = [np.array([0.0, length])]
    for p, u in zip(start.tolist(), way.tolist(), strict=True):
        if u != 0.0:
            first, last = sorted((p, p + u * length))
            knots.append((np.arange(ceil(first), floor(last) + 1) - p) / u)
    merged = np.sort(np.concatenate(knots)).clip(0.0, length)
    return merged[np.append(True, np.diff(merged) > _SHORTEST)]


def _cubic(corners: list[float], entry: list[float], travel: list[float]) -> Cubic:
    """Trilinear density on the way from ``entry`` by ``travel``, both from the first of a cell's eight corners."""
    d000, d001, d010, d011, d100, d101, d110, d111 = corners
    (x, y, z), (u, v, w) = entry, travel
    # Density is d000 + a x + b y + c z + ab x y + ac x z + bc y z + abc x y z.
    a, b, c = d100 - d000, d010 - d000, d001 - d000
    ab, ac, bc = d110 - d100 - b, d101 - d100 - c, d011 - d010 - c
    abc = d111 - d110 - d101 + d100 - bc
    along_x, along_y, along_z = a + ab * y + (ac + abc * y) * z, b + ab * x + (bc + abc * x) * z, c + ac * x + bc * y
    return (
        d000 + x * along_x + y * (b + bc * z) + z * c,
        u * along_x + v * along_y + w * (along_z + abc * x * y),
        u * v * (ab + abc * z) + u * w * (ac + abc * y) + v * w * (bc + abc * x),
        u * v * w * abc,
    )


def _value(cubic: Cubic, at: float) -> float:
    a, b, c, d = cubic
    return a + at * (b + at * (c + at * d))


def _turning_points(cubic: Cubic) -> list[float]:
    """Where within 0 to 1 a cubic turns, in order: between two it only rises or only falls."""
    _, b, c, d = cubic
    q = -(c + copysign(sqrt(max(c * c - 3.0 * b * d, 0.0)), c))
    turns = [p / r for p, r in ((q, 3.0 * d), (b, q)) if r]
    return sorted(at for at in turns if 0.0 < at < 1.0)
