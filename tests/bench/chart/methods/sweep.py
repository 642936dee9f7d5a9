# SPDX-License-Identifier: GPL-3.0-or-later
"""The sweep: this program's own push, in the settings that trade time for accuracy."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from repousse.core import Contact, DensityGrid, Material, Push, SphereTool
from repousse.core import push as core_push

from ..method import Method, Scene, Vector

FULL_FORCE = 3.3


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


def with_constant(name: str, value: float, start: Callable[[Scene], Pushing] = without_rim) -> Callable:
    """The same with another value of one of the constants of core/push.py, in the process that is the method's own."""

    def begin(scene: Scene) -> Pushing:
        setattr(core_push, name, value)
        return start(scene)

    return begin


METHODS = [
    Method("sweep", "compiled", without_rim),
    Method("sweep", "numpy", in_numpy),
    Method("sweep", "one sweep a solve", with_constant("MOST_SWEEPS", 1)),
    Method("sweep", "solves of 1/4 voxel", with_constant("LONGEST_STEP", 0.25)),
    Method("sweep", "reach 1.1 R", partial(without_rim, reach=1.1)),
    Method("sweep", "kappa / 5", partial(without_rim, softer=5.0)),
    Method("sweep", "m = 3/4", partial(without_rim, exponent=0.75)),
    Method("sweep", "m = 1/2", partial(without_rim, exponent=0.5)),
    Method("sweep + rim", "compiled", with_rim),
    Method("sweep + rim", "reach 1.1 R", partial(with_rim, reach=1.1)),
    Method("sweep + rim", "kappa / 5", partial(with_rim, softer=5.0)),
    Method("sweep + rim", "m = 3/4", partial(with_rim, exponent=0.75)),
    Method("sweep + rim", "m = 1/2", partial(with_rim, exponent=0.5)),
]
