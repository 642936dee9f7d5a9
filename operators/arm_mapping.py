# SPDX-License-Identifier: GPL-3.0-or-later
"""Between the arm's metres and a volume's voxels: poses one way, what is felt there the other. Knows no Blender.

An arm's own frame is right-handed: x towards its user, y to the right, z up. ``Workspace`` lays that over the world;
``ArmMapping`` is the whole way to the voxels of one grid, by plain numbers, for it is walked a thousand times a second.

A force stays what it is in newtons. What is a length changes: a way by the map, a gradient by its transpose. So the
work that the hand does is that in the material, voxels taken as the lengths they stand for.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, isfinite
from typing import TYPE_CHECKING

import numpy as np

from ..core.tool import Vector, vector
from ..device.protocol import ForceModel

if TYPE_CHECKING:
    from ..core.local_model import LocalModel

FROM_THE_FRONT = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
"""Rows of the matrix that takes towards, right and up to an object's own axes, seen along its +Y."""
FLATTEST = 1e-9
"""Share of the largest singular value under which a map counts as flat."""


@dataclass(frozen=True)
class Workspace:
    """Where the arm's workspace lies in the world.

    Parameters
    ----------
    centre
        (3,) the point of the world over which the middle of the workspace lies.
    axes
        (3, 3) unit vectors of the world as columns: towards the user, to the right, up.
    scale
        World units to a metre of the arm.
    """

    centre: Vector
    axes: tuple[Vector, Vector, Vector]
    scale: float

    @classmethod
    def in_view(cls, to_world: np.ndarray, centre: Vector, span: float, reach: float) -> Workspace:
        """As one sees it: ``to_world`` (4, 4) is the view's own matrix, whose x is right, y up and z towards the eye.

        The arm's ``reach`` (m, from the middle of its workspace) spans ``span`` world units.
        """
        right, up, towards = np.array(to_world, np.float64)[:3, :3].T
        return cls.along(np.stack([towards, right, up], axis=1), centre, span, reach)

    @classmethod
    def on_object(cls, to_world: np.ndarray, centre: Vector, span: float, reach: float) -> Workspace:
        """As the object stands that ``to_world`` (4, 4) places, seen from its front; see :meth:`in_view`."""
        return cls.along(np.array(to_world, np.float64)[:3, :3] @ FROM_THE_FRONT, centre, span, reach)

    @classmethod
    def along(cls, axes: np.ndarray, centre: Vector, span: float, reach: float) -> Workspace:
        """Along the rotation that comes nearest to ``axes``, (3, 3) columns of any length.

        Raises ValueError where these have no volume, or a length is not finite and positive.
        """
        if not (isfinite(span) and span > 0.0 and isfinite(reach) and reach > 0.0):
            raise ValueError(f"the workspace is laid over a positive length, not {span:g} over {reach:g} m of the arm")
        if not (np.isfinite(axes).all() and np.isfinite(centre).all()):
            raise ValueError("the workspace has no place: what it is laid over is not at a finite one")
        left, sizes, right = np.linalg.svd(axes)
        if sizes[2] <= FLATTEST * sizes[0]:
            raise ValueError("the workspace has no place: what it is laid over is flat")
        turn = left @ np.diag((1.0, 1.0, np.sign(np.linalg.det(left @ right)))) @ right
        return cls(vector(centre), tuple(vector(row) for row in turn), span / reach)

    def from_device(self, centre: Vector, clutched: Vector = (0.0, 0.0, 0.0)) -> np.ndarray:
        """(4, 4) float64: metres of the arm to the world. ``centre`` is the middle of the arm's workspace, ``clutched``
        how far the hand went back while the clutch was held, both in metres of the arm."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.scale * np.array(self.axes)
        matrix[:3, 3] = self.centre + matrix[:3, :3] @ (np.array(clutched) - centre)
        return matrix


class ArmMapping:
    """The way from the arm's frame (metres) to a grid's (voxels), and back.

    Parameters
    ----------
    to_voxels
        (4, 4), metres of the arm to voxels in the frame in which the poses of a push are.

    Attributes
    ----------
    voxels_per_metre
        How many voxels long a metre of the arm is.
    towards_user
        (3,) unit vector in voxels.

    Raises
    ------
    ValueError
        Where it is not finite, or flat: no way leads back.
    """

    def __init__(self, to_voxels: np.ndarray) -> None:
        if not np.isfinite(to_voxels).all():
            raise ValueError("the arm cannot be laid over this volume: its place is not finite")
        sizes = np.linalg.svd(to_voxels[:3, :3], compute_uv=False)
        if sizes[2] <= FLATTEST * sizes[0]:
            raise ValueError("the arm cannot be laid over this volume: it is flat")
        self.voxels_per_metre = float(np.prod(sizes) ** (1.0 / 3.0))
        self.towards_user = vector(to_voxels[:3, 0] / np.linalg.norm(to_voxels[:3, 0]))
        self._there = _rows(to_voxels)
        self._back = _rows(np.linalg.inv(to_voxels))

    def position(self, place: Vector) -> Vector:
        """A place of the arm (m) in voxels."""
        return _moved(self._there, place)

    def place(self, position: Vector) -> Vector:
        """A position in voxels as a place of the arm (m)."""
        return _moved(self._back, position)

    def force_model(self, model: LocalModel, scene: int) -> ForceModel:
        """What a pose in the grid feels like to the arm, as part of ``scene``.

        The stresses are the same newtons. The gradient is that along the arm's own ways, N/m, and the normal that of
        the same surface in the arm's frame, of the same length as in the grid.
        """
        gradient, normal = _carried(self._there, model.gradient), _carried(self._there, model.normal)
        length = hypot(*normal)
        share = hypot(*model.normal) / length if length > 0.0 else 0.0
        turned = [_carried(self._there, row, share) for row in model.turning]  # by each axis of the grid
        turning_x, turning_y, turning_z = (
            vector(sum(row[k] * there[j] for row, there in zip(turned, self._there, strict=True)) for k in range(3))
            for j in range(3)
        )
        return ForceModel(
            time=model.time,
            position=self.place(model.position),
            stress=model.stress,
            yield_stress=model.yield_stress,
            gradient=gradient,
            normal=(normal[0] * share, normal[1] * share, normal[2] * share),
            scene=scene,
            exponent=model.exponent,
            turning_x=turning_x,
            turning_y=turning_y,
            turning_z=turning_z,
        )


_Row = tuple[float, float, float, float]


def _rows(matrix: np.ndarray) -> tuple[_Row, _Row, _Row]:
    a, b, c = (tuple(row) for row in matrix[:3].tolist())
    return a, b, c


def _carried(rows: tuple[_Row, _Row, _Row], by: Vector, share: float = 1.0) -> Vector:
    """What is told per voxel, by the transpose of the map, times a share."""
    (a, b, c), (x, y, z) = rows, by
    return (
        share * (a[0] * x + b[0] * y + c[0] * z),
        share * (a[1] * x + b[1] * y + c[1] * z),
        share * (a[2] * x + b[2] * y + c[2] * z),
    )


def _moved(rows: tuple[_Row, _Row, _Row], point: Vector) -> Vector:
    x, y, z = point
    a, b, c = rows
    return (
        a[0] * x + a[1] * y + a[2] * z + a[3],
        b[0] * x + b[1] * y + b[2] * z + b[3],
        c[0] * x + c[1] * y + c[2] * z + c[3],
    )
