# SPDX-License-Identifier: GPL-3.0-or-later
"""The dual tool (paper 4.2): the volume t that pushes, and the reach s around it that is asked how hard it is.

Both are given by signed distance, so that any implicit shape is one small class. Lengths are in voxels.
Coverage is fractional, w = clamp(1/2 - distance, 0, 1): with whole voxels 44 % of 0.01-voxel moves change nothing
and the others jump (facts/physics.md 5).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot, nan
from typing import Protocol

import numpy as np

DEFAULT_REACH = 1.5
"""Reach over radius where none is given."""

UNIT_TOLERANCE = 1e-3
"""How far the length of a direction that is given may be off 1."""
ROUNDING = 1e-12
"""How far it may be off 1 and need no division."""

Vector = tuple[float, float, float]

_GAUSS = np.polynomial.legendre.leggauss(8)  # nodes and weights on -1 .. 1


def vector(values: Iterable[float]) -> Vector:
    """Three numbers as a Vector; ValueError for more or fewer."""
    x, y, z = (float(v) for v in values)
    return x, y, z


def unit(direction: Iterable[float]) -> Vector:
    """A direction as a Vector of length 1; ValueError where it is not of unit length to 1e-3.

    What has unit length already stays as it is to the last bit, so that a replay goes the very same way.
    """
    try:
        x, y, z = vector(direction)
        length = hypot(x, y, z)
    except (TypeError, ValueError):
        length = nan
    if not abs(length - 1.0) <= UNIT_TOLERANCE:  # written so that NaN fails too
        raise ValueError(f"a direction is three finite numbers of unit length, not {direction}")
    return (x, y, z) if abs(length - 1.0) <= ROUNDING else (x / length, y / length, z / length)


class Tool(Protocol):
    """What the estimators and the dispersion ask of a tool."""

    @property
    def kind(self) -> str:
        """Its name in a stroke's file."""
        ...

    @property
    def radius(self) -> float:
        """Its smallest half width, in voxels."""
        ...

    @property
    def volume(self) -> Shape:
        """The tool t itself."""
        ...

    @property
    def surroundings(self) -> Shape:
        """The tool and its reach s together."""
        ...

    def scaled(self, radius: float) -> Tool:
        """The same tool with another radius, its reach in proportion."""
        ...


@dataclass(frozen=True)
class Shape:
    """A rounded box or segment: all points within ``radius`` of a core, less nothing.

    ``half_size`` is the half-edge of a box; ``half_axis`` runs from the centre to the end of a segment. A sphere
    has neither, so all three tools share one distance function and one kernel.
    """

    half_size: Vector = (0.0, 0.0, 0.0)
    half_axis: Vector = (0.0, 0.0, 0.0)
    radius: float = 0.0

    @property
    def extent(self) -> Vector:
        """Half-edges of the box around the shape, in voxels."""
        return vector(h + abs(a) + self.radius for h, a in zip(self.half_size, self.half_axis, strict=True))

    def _from_axis(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points as seen from the nearest point of the segment; as they are where there is none."""
        ax, ay, az = self.half_axis
        length2 = ax * ax + ay * ay + az * az
        if length2 == 0.0:
            return x, y, z
        along = np.clip((x * ax + y * ay + z * az) / length2, -1.0, 1.0)
        return x - along * ax, y - along * ay, z - along * az

    def distance(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Signed distance in voxels, negative inside, of points relative to the centre (arrays that broadcast)."""
        x, y, z = self._from_axis(x, y, z)
        if max(self.half_size) > 0.0:
            x, y, z = (np.abs(v) - h for v, h in zip((x, y, z), self.half_size, strict=True))
            inside = np.minimum(np.maximum(np.maximum(x, y), z), 0.0)
            x, y, z = np.maximum(x, 0.0), np.maximum(y, 0.0), np.maximum(z, 0.0)
            return np.sqrt(x * x + y * y + z * z) + inside - self.radius
        return np.sqrt(x * x + y * y + z * z) - self.radius

    def coverage(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Share of each voxel that lies in the shape, w = clamp(1/2 - distance, 0, 1)."""
        return np.clip(0.5 - self.distance(x, y, z), 0.0, 1.0)

    def normal(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Outward unit normal of the nearest surface, the gradient of the distance: shape (3, ...), 0 at the core."""
        x, y, z = self._from_axis(x, y, z)
        vector = np.stack(np.broadcast_arrays(x, y, z)).astype(np.float64)
        if max(self.half_size) > 0.0:
            excess = np.abs(vector) - np.reshape(self.half_size, (3,) + (1,) * (vector.ndim - 1))
            deepest = excess.max(axis=0)
            # Inside, the nearest face, or equally all that are equally near.
            part = np.where(deepest > 0.0, np.maximum(excess, 0.0), excess == deepest)
            vector = np.where(vector < 0.0, -part, part)
        length = np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
        return np.divide(vector, length, out=np.zeros_like(vector), where=length > 0.0)

    @property
    def covered_volume(self) -> float:
        """Sum of w over all voxels, in voxels: the mean of the volumes within -1/2 .. +1/2 of the surface."""
        return float(sum(0.5 * w * self._volume_within(0.5 * t) for t, w in zip(*_GAUSS, strict=True)))

    def _volume_within(self, offset: float) -> float:
        """Volume of the points nearer to the surface than ``offset`` or inside it (Steiner's formula)."""
        radius = self.radius + offset
        a, b, c = self.half_size
        if radius < 0.0:  # only a box without rounding is ever eaten into
            return 8.0 * max(a + radius, 0.0) * max(b + radius, 0.0) * max(c + radius, 0.0)
        box = 8.0 * a * b * c + 8.0 * radius * (a * b + b * c + c * a) + 2.0 * np.pi * radius**2 * (a + b + c)
        return box + 2.0 * float(np.linalg.norm(self.half_axis)) * np.pi * radius**2 + 4.0 / 3.0 * np.pi * radius**3


def _check_radius(radius: float, reach: float) -> None:
    if not (np.isfinite(radius) and radius >= 1.0):
        raise ValueError(f"the tool's radius must be at least one voxel, not {radius:g}")
    if not (np.isfinite(reach) and reach > radius):
        raise ValueError(f"the tool's reach must be larger than its radius {radius:g}, not {reach:g}")


@dataclass(frozen=True)
class SphereTool:
    """A ball of ``radius`` voxels that feels what surrounds it out to ``reach`` voxels from its centre."""

    radius: float
    reach: float = 0.0  # none given: DEFAULT_REACH radii
    kind = "sphere"

    def __post_init__(self) -> None:
        if not self.reach:
            object.__setattr__(self, "reach", DEFAULT_REACH * self.radius)
        _check_radius(self.radius, self.reach)

    @property
    def volume(self) -> Shape:
        return Shape(radius=self.radius)

    @property
    def surroundings(self) -> Shape:
        return Shape(radius=self.reach)

    def scaled(self, radius: float) -> SphereTool:
        return SphereTool(radius, self.reach * radius / self.radius)


@dataclass(frozen=True)
class BoxTool:
    """A flat punch: half-edges in voxels; its reach is the box grown by ``margin`` voxels on every side."""

    half_size: Vector
    margin: float
    kind = "box"

    def __post_init__(self) -> None:
        object.__setattr__(self, "half_size", vector(self.half_size))
        if not np.isfinite(self.half_size).all():
            raise ValueError("a box tool's half-edges are three finite numbers of voxels")
        _check_radius(self.radius, self.radius + self.margin)

    @property
    def radius(self) -> float:
        """Its smallest half-edge."""
        return min(self.half_size)

    @property
    def volume(self) -> Shape:
        return Shape(half_size=self.half_size)

    @property
    def surroundings(self) -> Shape:
        return Shape(half_size=vector(h + self.margin for h in self.half_size))

    def scaled(self, radius: float) -> BoxTool:
        ratio = radius / self.radius
        return BoxTool(vector(h * ratio for h in self.half_size), self.margin * ratio)


@dataclass(frozen=True)
class CapsuleTool:
    """A finger: all points within ``radius`` of the segment from -half_axis to +half_axis, in voxels."""

    half_axis: Vector
    radius: float
    reach: float = 0.0  # none given: DEFAULT_REACH radii
    kind = "capsule"

    def __post_init__(self) -> None:
        object.__setattr__(self, "half_axis", vector(self.half_axis))
        if not np.isfinite(self.half_axis).all():
            raise ValueError("a capsule's half axis is three finite numbers of voxels")
        if not self.reach:
            object.__setattr__(self, "reach", DEFAULT_REACH * self.radius)
        _check_radius(self.radius, self.reach)

    @property
    def volume(self) -> Shape:
        return Shape(half_axis=self.half_axis, radius=self.radius)

    @property
    def surroundings(self) -> Shape:
        return Shape(half_axis=self.half_axis, radius=self.reach)

    def scaled(self, radius: float) -> CapsuleTool:
        ratio = radius / self.radius
        return CapsuleTool(vector(a * ratio for a in self.half_axis), radius, self.reach * ratio)
