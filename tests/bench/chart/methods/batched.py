# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's 26-neighbour weights with overflow batched in generations (`tests/bench/batched.py`).

Gets wrong what the recursion gets wrong: no rim, and a mean flow up to 8.7 degrees off the push. It keeps the mass but
for what leaves the array and for overflow under 1e-5 voxels' worth, which it leaves behind.
"""

from __future__ import annotations

import numpy as np

from repousse.core import SphereTool
from tests.bench.batched import push_batched
from tests.bench.chart.method import Method, Scene, Vector
from tests.bench.chart.methods.ousting import tool_in


class Batched:
    """One push; the force is the model's own, sigma: the mass that is left in the tool."""

    def __init__(self, scene: Scene) -> None:
        self.density = scene.density.astype(np.float64)
        self._scene, self._tool = scene, SphereTool(scene.radius)

    def move_to(self, position: Vector) -> float:
        direction = np.asarray(self._scene.direction, float)
        push_batched(self.density, self._tool, self._scene.yield_ratio, direction, [position])
        box, covered = tool_in(self.density.shape, position, self._scene.radius)
        return float((covered * self.density[box]).sum())


METHODS = [Method("batched", "26 neighbours", Batched)]
