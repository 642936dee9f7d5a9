# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface: where a line of sight first meets the visible density of a grid, and which way is out there.

Nothing is extracted or kept: a ray reads the voxels that it passes, and no others.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, floor

import numpy as np

from .grid import DensityGrid
from .history import History
from .tool import Vector, vector

LEAST_LEVEL = 1e-6
"""A level of 0 is taken as this: all that is not empty."""
CELLS_AT_ONCE = 64
"""Cells that are first looked at, then twice as many, and so on: near surfaces are cheap, far ones take few calls."""
SMOOTHED = 2.5
"""Standard deviations of the normal's bell that are summed."""

_SHORTEST = 1e-9  # voxels of a ray in a cell: less is the rounding of a corner
_HALVINGS = 40  # of at most a cell's diagonal: 2e-12 voxels
_CORNERS = np.array([0, 1])
# Takes a cubic's values at 0, 1/3, 2/3 and 1 to its coefficients, constant first.
_CUBIC = np.linalg.inv(np.vander([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0], 4, increasing=True)).T


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
        The grid as it lives. Positions are in the index frame that it has when this is made, or, with a history,
        that it had when the history began: the frame of the poses.
    level
        Density, over 0 to 1, from which on material is seen.
    history
        With it the voxels are those of the time when it began, whatever a push is doing to them meanwhile.

    ``voxels_read`` counts the densities that all rays so far have asked for.
    """

    def __init__(self, grid: DensityGrid, level: float, history: History | None = None) -> None:
        self.grid, self.level, self.history = grid, max(float(level), LEAST_LEVEL), history
        self.shape = grid.shape
        self.voxels_read = 0

    def hit(self, origin: Iterable[float], direction: Iterable[float], smoothing: float = 2.0) -> Hit | None:
        """The first point along a ray whose density is the level or more; None where there is none.

        ``origin`` and ``direction`` are in voxels. A ray that begins in material meets it where it begins. The normal
        is against the gradient of density under a bell with a standard deviation of ``smoothing`` voxels; of density
        itself where the smoothed one does not face the ray (a thin sheet before a thick one), and against the ray
        where that fades.

        Raises
        ------
        ValueError
            When the origin or direction is not finite, or the direction has no length.
        """
        start, way = np.array(vector(origin)), np.array(vector(direction))
        length = float(np.sqrt(way @ way))
        if not (np.isfinite(start).all() and np.isfinite(length) and length > 0.0):
            raise ValueError(f"a ray is a finite point and a direction with a length, not {origin} and {direction}")
        way /= length
        span = self._span(start, way)
        if span is None:
            return None
        start = start + span[0] * way  # from here on, or a far viewpoint would cost digits
        along = self._first(start, way, span[1] - span[0])
        if along is None:
            return None
        position = start + along * way
        return Hit(vector(position), vector(self._normal(position, way, smoothing)))

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
        some = np.flatnonzero(corners.reshape(len(cells), 8).max(axis=1) >= self.level)
        if not len(some):
            return None
        enter, inside, cells, corners = enter[some], inside[some], cells[some], corners[some]
        steps = enter[:, None] + inside[:, None] * np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
        values = _trilinear(corners[:, None], start + steps[..., None] * way - cells[:, None])
        cubics = values @ _CUBIC
        turns = _turning_points(cubics)
        heights = _cubic(cubics[:, None], turns)
        reached = np.flatnonzero((heights >= self.level - 1e-12).any(axis=1))
        if not len(reached):
            return None
        cell = reached[0]
        section = int((heights[cell] >= self.level - 1e-12).argmax())
        low = float(turns[cell, section - 1]) if section else 0.0
        return float(enter[cell] + inside[cell] * self._rise(cubics[cell].tolist(), low, float(turns[cell, section])))

    def _rise(self, cubic: list[float], low: float, high: float) -> float:
        """Where a cubic that rises from below the level at ``low`` to it at ``high`` passes it."""
        a, b, c, d = cubic
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if a + middle * (b + middle * (c + middle * d)) < self.level:
                low = middle
            else:
                high = middle
        return high

    def _normal(self, position: np.ndarray, way: np.ndarray, smoothing: float) -> np.ndarray:
        """The outward normal at a point of the surface that a ray along ``way`` has met."""
        for rising in (self._smoothed_gradient(position, smoothing), self._gradient(position)):
            length = float(np.sqrt(rising @ rising))
            if length > 1e-9 and float(rising @ way) > 1e-6 * length:
                return -rising / length
        return -way

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
        reach = SMOOTHED * max(smoothing, 0.5)
        low = [ceil(p - reach) for p in position]
        high = [floor(p + reach) + 1 for p in position]
        block = self._block(low, high).astype(np.float64)
        bells, slopes = [], []
        for p, first, last in zip(position, low, high, strict=True):
            off = np.arange(first, last) - p
            bell = np.exp(-0.5 * (off / max(smoothing, 0.5)) ** 2)
            bells.append(bell)
            slopes.append(bell * (off - (bell @ off) / bell.sum()))  # uniform density has no slope, however it is cut
        along_z, rising_z = block @ bells[2], block @ slopes[2]
        along_yz, rising_y = along_z @ bells[1], along_z @ slopes[1]
        return np.array([slopes[0] @ along_yz, bells[0] @ rising_y, bells[0] @ (rising_z @ bells[1])])

    def _corners(self, cells: np.ndarray) -> np.ndarray:
        """Densities at the eight corners of cells (n, 3), as (n, 2, 2, 2)."""
        x, y, z = (cells[:, a, None] + _CORNERS for a in range(3))
        return self._read(x[:, :, None, None], y[:, None, :, None], z[:, None, None, :])

    def _block(self, low: list[int], high: list[int]) -> np.ndarray:
        """Densities in a half-open box."""
        return self._read(*np.ix_(*(np.arange(a, b) for a, b in zip(low, high, strict=True))))

    def _read(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Densities at indices that broadcast; 0 outside the grid."""
        if self.history is not None:
            x, y, z = np.broadcast_arrays(x, y, z)
            self.voxels_read += x.size
            read = self.history.original(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1))
            return read.reshape(x.shape)
        density = self.grid.density
        inside, flat = np.True_, np.int64(0)
        for at, n in zip((x, y, z), density.shape, strict=True):
            inside = inside & ((at >= 0) & (at < n))
            flat = flat * n + np.clip(at, 0, n - 1)
        self.voxels_read += flat.size
        return np.where(inside, density.reshape(-1).take(flat), np.float32(0.0))


def _knots(start: np.ndarray, way: np.ndarray, length: float) -> np.ndarray:
    """Where a ray enters and leaves each cell between voxel centres: sorted, from 0 to ``length``."""
    knots = [np.array([0.0, length])]
    for p, u in zip(start.tolist(), way.tolist(), strict=True):
        if u != 0.0:
            first, last = sorted((p, p + u * length))
            knots.append((np.arange(ceil(first), floor(last) + 1) - p) / u)
    merged = np.sort(np.concatenate(knots)).clip(0.0, length)
    return merged[np.append(True, np.diff(merged) > _SHORTEST)]


def _trilinear(corners: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Density at ``part`` (..., 3), 0 to 1, of cells with ``corners`` (..., 2, 2, 2)."""
    x, y, z = (part[..., a] for a in range(3))
    faces = corners[..., 0, :, :] * (1.0 - x)[..., None, None] + corners[..., 1, :, :] * x[..., None, None]
    edges = faces[..., 0, :] * (1.0 - y)[..., None] + faces[..., 1, :] * y[..., None]
    return edges[..., 0] * (1.0 - z) + edges[..., 1] * z


def _cubic(coefficients: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values of cubics with ``coefficients`` (..., 4), constant first."""
    a, b, c, d = (coefficients[..., k] for k in range(4))
    return a + at * (b + at * (c + at * d))


def _turning_points(cubics: np.ndarray) -> np.ndarray:
    """0, where each of cubics (n, 4) turns within 0 to 1, and 1, in order, as (n, 4): between two it does not turn."""
    b, c, d = cubics[:, 1], cubics[:, 2], cubics[:, 3]
    turns = np.zeros((len(cubics), 4))
    turns[:, 3] = 1.0
    q = -(c + np.copysign(np.sqrt(np.maximum(c * c - 3.0 * b * d, 0.0)), c))
    with np.errstate(divide="ignore", invalid="ignore"):
        turns[:, 1:3] = np.sort(np.nan_to_num(np.stack([q / (3.0 * d), b / q], axis=1)).clip(0.0, 1.0), axis=1)
    return turns
