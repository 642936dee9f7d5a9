# SPDX-License-Identifier: GPL-3.0-or-later
"""The sweep: this program's own push, in the settings that trade time for accuracy."""

from __future__ import annotations

import os
import time
import warnings
from functools import partial
from statistics import median
from typing import Any

import numpy as np

from repousse.core import Contact, DensityGrid, Material, Push, SphereTool
from repousse.core.material import packing
from repousse.core.quality import LONGEST_STEP, Auto

from ..method import Method, Scene, Vector

FULL_FORCE = 3.3
RIM = packing(young_modulus=500.0, yield_stress=1.0).rim
"""Hats' radius in contact radii for the solid of the von Mises truth, by the rule; density and band are the scene's."""


class Pushing:
    """A Push at work in a scene: ``reach`` in radii, ``softer`` divides kappa, ``exponent`` is the force's, and
    ``options`` are Push's own."""

    def __init__(
        self, scene: Scene, reach: float = 1.5, softer: float = 1.0, exponent: float = 1.0, **options: Any
    ) -> None:
        self._against = -np.array(scene.direction)
        tool = SphereTool(scene.radius, reach * scene.radius)
        material = Material(FULL_FORCE, scene.yield_ratio / softer, exponent)
        with (
            warnings.catch_warnings()
        ):  # a column has no sides: it yields where the bound for a large block is exceeded
            warnings.filterwarnings("ignore", message="this material may never yield")
            self.push = Push(DensityGrid(scene.density), tool, material, border="wall", **options)
        self.contact: Contact | None = None

    @property
    def density(self) -> np.ndarray:
        return self.push.grid.density

    def move_to(self, position: Vector) -> float:
        """Newtons against the push."""
        self.contact = self.push.move_to(position)
        return float(self.contact.force @ self._against)


def without_rim(scene: Scene, **options: Any) -> Pushing:
    """The paper's pyramid without end."""
    return Pushing(scene, **options)


def with_rim(scene: Scene, **options: Any) -> Pushing:
    """What reaches the scene's band rises around the tool; without a band there is no rim."""
    return Pushing(scene, band=scene.band, **options)


def in_numpy(scene: Scene) -> Pushing:
    """The same through the numpy twins of the kernels."""
    os.environ["REPOUSSE_KERNELS"] = "numpy"  # of this process, which is the method's own
    return without_rim(scene)


class Finer(Pushing):
    """The same in solves half as long."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self._position: Vector | None = None

    def move_to(self, position: Vector) -> float:
        if self._position is not None:
            x, y, z = ((a + b) / 2.0 for a, b in zip(self._position, position))
            super().move_to((x, y, z))
        self._position = position
        return super().move_to(position)


class Draft(Pushing):
    """Draft quality (core/quality.py): its solves are as long as two steps, so it waits for every second one.

    In between the force is that of the last solve. A step's time is half of the median solve's.
    """

    def __init__(self, scene: Scene, **options: Any) -> None:
        super().__init__(scene, quality="draft", **options)
        self._steps, self._left, self._force = 0, len(scene.path), 0.0
        self._seconds: list[float] = []

    def move_to(self, position: Vector) -> float:
        self._steps, self._left = self._steps + 1, self._left - 1
        if self._steps % 2 == 1 or not self._left:
            began = time.perf_counter()
            self._force = super().move_to(position)
            self._seconds.append(time.perf_counter() - began)
        return self._force

    @property
    def milliseconds_a_step(self) -> float:
        return 500.0 * median(self._seconds)


class Automatic(Pushing):
    """Quality by the rules of core/quality.py: the most exact that its frame budget has time for."""

    def __init__(self, scene: Scene, **options: Any) -> None:
        super().__init__(scene, **options)
        self._auto = Auto()

    def move_to(self, position: Vector) -> float:
        push, radius = self.push, self.push.tool.radius
        flow = push.flow
        chosen = self._auto.choose(flow, radius, LONGEST_STEP).quality
        began = time.perf_counter()
        self.contact = push.move_to(position, quality=chosen.name)
        if self.contact.sweeps:
            self._auto.learn(chosen, flow, time.perf_counter() - began)
        return float(self.contact.force @ self._against)


METHODS = [
    Method("sweep", "compiled", without_rim),
    Method("sweep", "numpy", in_numpy),
    Method("sweep", "balanced", partial(without_rim, quality="balanced")),
    Method("sweep", "draft", Draft),
    Method("sweep", "auto", Automatic),
    Method("sweep", "solves of 1/4 voxel", Finer),
    Method("sweep", "reach 1.1 R", partial(without_rim, reach=1.1)),
    Method("sweep", "kappa / 5", partial(without_rim, softer=5.0)),
    Method("sweep", "m = 3/4", partial(without_rim, exponent=0.75)),
    Method("sweep", "m = 1/2", partial(without_rim, exponent=0.5)),
    Method("sweep + rim", "compiled", with_rim),
    Method("sweep + rim", "balanced", partial(with_rim, quality="balanced")),
    Method("sweep + rim", "draft", lambda scene: Draft(scene, band=scene.band)),
    Method("sweep + rim", "auto", lambda scene: Automatic(scene, band=scene.band)),
    Method("sweep + rim", "reach 1.1 R", partial(with_rim, reach=1.1)),
    Method("sweep + rim", "packing", partial(with_rim, rim=RIM)),
    Method("sweep + rim", "packing, reach 1.1 R", partial(with_rim, rim=RIM, reach=1.1)),
    Method("sweep + rim", "kappa / 5", partial(with_rim, softer=5.0)),
    Method("sweep + rim", "m = 3/4", partial(with_rim, exponent=0.75)),
    Method("sweep + rim", "m = 1/2", partial(with_rim, exponent=0.5)),
]
"""Those named "compiled" are of quality "exact", as a push is where nothing is said."""
