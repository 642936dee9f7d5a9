# SPDX-License-Identifier: GPL-3.0-or-later
"""What a method is to the chart: something that takes a scene and moves a tool through it, step by step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Scene:
    """A sphere that is pressed into a volume.

    ``density`` is float32 (nx, ny, nz) in [0, 1], not to be written into; ``radius`` the tool's in voxels; ``path``
    float64 (steps, 3), the places of its centre in voxels; ``direction`` the unit vector in which it is pressed.
    ``yield_ratio`` is kappa; ``band`` voxels ahead of the tool beyond which nothing goes, None: no such plane.
    """

    density: np.ndarray
    radius: float
    path: np.ndarray
    direction: Vector
    yield_ratio: float
    band: float | None = None


class Solver(Protocol):
    """One method at work in one scene."""

    @property
    def density(self) -> np.ndarray:
        """The volume as it now is, shape and unit as the scene's."""
        ...

    def move_to(self, position: Vector) -> float:
        """Move the tool's centre there, voxels. Returns the force against the push, in newtons or any unit of its own:
        the chart compares forces up to one factor."""
        ...


@dataclass(frozen=True)
class Method:
    """A point of the chart: ``name`` and ``setting`` as the chart prints them, and how it begins in a scene.

    ``start`` does all that is done once (it is timed as start-up); each ``move_to`` is timed as a step.
    """

    name: str
    setting: str
    start: Callable[[Scene], Solver]
