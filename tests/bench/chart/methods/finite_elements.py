# SPDX-License-Identifier: GPL-3.0-or-later
"""The finite elements that the truths come from, on a mesh coarser than theirs: what a step costs, and how far two
meshes are apart.

They know a press into a half space and nothing else: what the scene is, is read from its band. All steps are computed
together when the first is asked for; each is said to have taken its share of that.
"""

from __future__ import annotations

import time
from functools import partial

import numpy as np

from ...truths.case import CASES, COARSE
from ...truths.measures import Press
from ...truths.run import press
from .. import physics, scenes
from ..method import Method, Scene, Vector


class Elements:
    """A press on a mesh whose smallest elements are ``size`` radii."""

    milliseconds_a_step = float("nan")
    """What each step took on average; the chart takes this for a step's time."""

    def __init__(self, scene: Scene, size: float) -> None:
        self._scene, self._size = scene, size
        self._solid = CASES["foam-500" if scene.band is None else "mises-500"].solid
        self._press: Press | None = None
        press(self._solid, 0.2, (0.02,), raster=False, steps=10)  # a compiler's work is start-up

    def move_to(self, position: Vector) -> float:
        """The force in E R^2."""
        depth = float((np.array(position) - self._scene.path[0]) @ self._scene.direction) / self._scene.radius
        if self._press is None:
            deepest = float(scenes.depths(self._scene)[-1]) / self._scene.radius
            began = time.perf_counter()
            self._press = press(self._solid, self._size, (deepest,))
            self.milliseconds_a_step = 1000.0 * (time.perf_counter() - began) / len(self._scene.path)
        return float(np.interp(depth, self._press.depth, self._press.force, left=0.0))

    @property
    def density(self) -> np.ndarray:
        assert self._press is not None
        return physics.density(self._scene, self._press.density[-1])


METHODS = [
    Method("finite elements", f"h = {size:g} R", partial(Elements, size=size)) for size in (2.0 * COARSE, COARSE)
]
