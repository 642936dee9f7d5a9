# SPDX-License-Identifier: GPL-3.0-or-later
"""Between pixels of a 3D view and voxels of a volume, by numbers alone: nothing dangles when Blender's data moves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..core.surface import Hit
from ..core.tool import Vector, vector

if TYPE_CHECKING:
    import bpy

    from .session import Session
    from .settings import RepousseSettings

SMALLEST_RADIUS, LARGEST_RADIUS = 1.5, 64.0
"""Voxels. A larger tool than this cannot be followed in real time."""


def voxels_to_world(obj: bpy.types.Object, session: Session) -> np.ndarray:
    """(4, 4) float64: indices of the session's grid to the world, through the object that shows it."""
    return np.array(obj.matrix_world, np.float64) @ session.grid.transform


def size_of(to_world: np.ndarray) -> float:
    """How long a voxel is in the world: the edge of a cube of its volume."""
    return float(abs(np.linalg.det(to_world[:3, :3])) ** (1.0 / 3.0))


def bounded_radius(radius: float) -> float:
    """A radius in voxels within what can be solved in real time."""
    return min(max(radius, SMALLEST_RADIUS), LARGEST_RADIUS)


def brush_radius(aim: Aim, settings: RepousseSettings, position: Vector) -> float:
    """Radius in voxels of the brush over ``position``, within what can be solved in real time."""
    return bounded_radius(aim.length(position, settings.radius))


@dataclass(frozen=True)
class Pointer:
    """Where the tool touches, for the cursor: position and unit normal in the world, radius in world units."""

    position: Vector
    normal: Vector
    radius: float

    @classmethod
    def at(cls, hit: Hit, radius: float, to_world: np.ndarray) -> Pointer:
        """From voxels, by the (4, 4) matrix that takes them to the world."""
        axes = to_world[:3, :3]
        normal = np.linalg.inv(axes).T @ hit.normal
        position = to_world @ (*hit.position, 1.0)
        return cls(vector(position[:3]), vector(normal / np.linalg.norm(normal)), radius * size_of(to_world))


@dataclass(frozen=True)
class Aim:
    """A view of a volume, as it was when this was made.

    Parameters
    ----------
    to_clip
        (4, 4) float64, voxel indices to OpenGL's clip space.
    width, height
        Of the region in pixels; pixel (0, 0) is its lower left.
    """

    to_clip: np.ndarray
    width: int
    height: int
    _from_clip: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_from_clip", np.linalg.inv(self.to_clip))

    @classmethod
    def of(cls, region, view, to_world: np.ndarray) -> Aim:
        """From a region and its RegionView3D; ``to_world`` (4, 4) takes voxel indices to the world."""
        return cls(np.array(view.perspective_matrix, np.float64) @ to_world, region.width, region.height)

    def ray(self, x: float, y: float) -> tuple[Vector, Vector]:
        """Where the line of sight through a pixel begins, in voxels, and its unit direction."""
        near, far = (self._unproject(self._ndc(x, y, depth)) for depth in (-1.0, 1.0))
        way = far - near
        return vector(near), vector(way / np.linalg.norm(way))

    def length(self, position: Vector, pixels: float) -> float:
        """How many voxels long ``pixels`` are, seen at ``position`` (voxels)."""
        clip = self.to_clip @ (*position, 1.0)
        here = clip[:3] / clip[3]
        aside = here + np.array((2.0 * pixels / self.width, 0.0, 0.0))
        return float(np.linalg.norm(self._unproject(aside) - self._unproject(here)))

    def _ndc(self, x: float, y: float, depth: float) -> np.ndarray:
        return np.array((2.0 * x / self.width - 1.0, 2.0 * y / self.height - 1.0, depth))

    def _unproject(self, ndc: np.ndarray) -> np.ndarray:
        point = self._from_clip @ (*ndc, 1.0)
        return point[:3] / point[3]
