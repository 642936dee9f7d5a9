# SPDX-License-Identifier: GPL-3.0-or-later
"""Carve: what the tool covers is removed, and nothing is put anywhere. The floor of the chart: how little suffices?

The force is the volume carved so far: the volume law without anything else. Galyean and Hughes, 1991.
"""

from __future__ import annotations

import numpy as np

from repousse.core.plasticity import box_around
from repousse.core.tool import SphereTool

from ..method import Method, Scene, Vector


class Carving:
    """One carve: density is capped by the part of each voxel that the tool leaves free."""

    def __init__(self, scene: Scene) -> None:
        self.density = scene.density.copy()
        self._ball = SphereTool(scene.radius).volume
        self._carved = 0.0

    def move_to(self, position: Vector) -> float:
        """Returns the mass carved out so far: the volume law of facts/physics.md 0.8."""
        box, offsets = box_around(self._ball, position, self.density.shape)
        under = self.density[box]
        left = np.minimum(under, 1.0 - self._ball.coverage(*offsets).astype(np.float32))
        self._carved += float((under - left).sum(dtype=np.float64))
        under[...] = left
        return self._carved


METHODS = [Method("carve", "remove only", Carving)]
