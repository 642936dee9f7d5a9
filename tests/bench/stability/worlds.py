# SPDX-License-Identifier: GPL-3.0-or-later
"""What there is to be touched: a plain wall, which theory can follow, and the material itself."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from repousse.core import Push
from repousse.core.local_model import Feeler
from repousse.core.poses import Poses, way
from repousse.core.stroke import Sample
from repousse.device.protocol import ForceModel
from repousse.operators.arm_mapping import ArmMapping

Triple = tuple[float, float, float]

UP = (0.0, 0.0, 1.0)
STRONG = 1e3
"""Newtons that no wall here is pushed with."""


class World(Protocol):
    """What the collision thread finds. Places in m, in the device's frame; times are virtual, in s."""

    def collide(self, place: Triple, now: float) -> ForceModel:
        """The collision's and the deformation's turn: what lies at the tip yields, and this is how it feels then."""
        ...

    def feel(self, place: Triple, now: float) -> ForceModel:
        """How it feels there now."""
        ...


@dataclass(frozen=True)
class Wall:
    """A virtual wall: ``stiffness`` (N/m) below height 0."""

    stiffness: float

    def feel(self, place: Triple, now: float) -> ForceModel:
        depth = -place[2]
        if depth <= 0.0:
            return ForceModel(now, place, 0.0, STRONG, (0.0, 0.0, 0.0), UP, 1)
        return ForceModel(now, place, self.stiffness * depth, STRONG, (0.0, 0.0, -self.stiffness), UP, 1)

    collide = feel


class Clay:
    """A push through a grid, as core.Engine does it: the poses of a hand wait in its line, the push walks there, and
    then the Feeler estimates; but when its turn is says the caller, not a thread.

    ``mapping`` leads from the arm to the grid's voxels. ``sculpts``: False only feels, as between strokes.
    """

    def __init__(self, push: Push, mapping: ArmMapping, sculpts: bool = True) -> None:
        self.push, self.mapping, self.sculpts = push, mapping, sculpts
        self.solved: list[Sample] = []
        self._poses = Poses(push.tool, coalesced=True)
        self._feeler = Feeler(push, turning=True)

    def collide(self, place: Triple, now: float) -> ForceModel:
        self._poses.put(Sample(now, self.mapping.position(place)))
        if self.sculpts and self._poses.any_wait:
            self._solve()
        return self.feel(place, now)

    def _solve(self) -> None:
        pose = self._poses.take()
        assert pose is not None
        for sample in way(self.solved[-1] if self.solved else None, pose):
            self.push.walk(sample)
            self.solved.append(sample)

    def feel(self, place: Triple, now: float) -> ForceModel:
        model = self._feeler.feel(self.mapping.position(place), self.push.tool)
        assert model is not None  # no other thread pushes
        return self.mapping.force_model(model, 1)._replace(time=now)


def laid_over(place: Iterable[float], voxels_per_metre: float) -> ArmMapping:
    """The arm upright over a grid: its middle lies at ``place`` (voxels), and up is up."""
    matrix = np.diag((voxels_per_metre, voxels_per_metre, voxels_per_metre, 1.0))
    matrix[:3, 3] = tuple(place)
    return ArmMapping(matrix)
