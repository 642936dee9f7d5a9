# SPDX-License-Identifier: GPL-3.0-or-later
"""What the rivals without a law of their own share: what the tool leaves room for, and the force that ousting takes."""

from __future__ import annotations

import numpy as np

from repousse.core import SphereTool
from repousse.core.grid import Box
from tests.bench.chart.method import Scene, Vector

TOOL_MARGIN = 2
"""Voxels of the box around the tool beyond its radius, so that it holds all neighbours of the tool's voxels."""


def tool_in(shape: tuple[int, ...], position: Vector, radius: float) -> tuple[Box, np.ndarray]:
    """A box of an array of ``shape`` around the tool, and the share of each voxel in it that the tool covers."""
    low = [max(int(np.floor(c - radius)) - TOOL_MARGIN, 0) for c in position]
    high = [min(int(np.ceil(c + radius)) + TOOL_MARGIN + 1, n) for c, n in zip(position, shape)]
    box = tuple(slice(a, max(a, b)) for a, b in zip(low, high))
    offsets = np.ogrid[box]
    return box, SphereTool(radius).volume.coverage(*(o - c for o, c in zip(offsets, position)))


class Advance:
    """The force of a method that has none: work per voxel ousted is constant, as in full plasticity (p_m = 3 Y).

    Then the force is the mass that is ousted per voxel of way, in voxels squared: the area of contact across the push.
    Tabor's hardness, physics.md section 2; neither Dewaele and Cani nor sandpiles have any.
    """

    def __init__(self, scene: Scene) -> None:
        self._direction = np.asarray(scene.direction, float)
        self._position: np.ndarray | None = None
        self._force = 0.0

    def to(self, position: Vector, ousted: float) -> float:
        """The force at ``position``, where ``ousted`` voxels' worth had to leave the tool."""
        former, self._position = self._position, np.asarray(position, float)
        if former is not None and (self._position != former).any():
            way = float((self._position - former) @ self._direction)
            self._force = ousted / way if way > 0.0 else 0.0
        return self._force
