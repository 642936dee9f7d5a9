# SPDX-License-Identifier: GPL-3.0-or-later
"""Pushes that the hard cases are made of, and what is read from them. A voxel is half a millimetre of the arm."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.symmetry import SymmetricPush
from tests.core.volumes import half_space

VOXEL = 0.5e-3
"""Metres."""
RADIUS = 8
"""Of the tool in voxels: 4 mm."""
SIDE = 40
SURFACE = 20.0
"""Height in voxels of the surface of a block: below it all is full."""
MIDDLE = (SIDE - 1) / 2
FULL_FORCE = 3.3
"""Newtons."""
YIELD_RATIO = 0.1

Anything = Push | SymmetricPush


def block(density: float = 1.0, surface: float = SURFACE, side: int = SIDE) -> DensityGrid:
    """Material below a height along z, air above."""
    grid = half_space(side, 0.0)
    grid.density[:, :, : int(surface)] = density
    return grid


def above(depth: float, aside: float = 0.0) -> tuple[float, float, float]:
    """Where the ball is that has come so deep into :func:`block`."""
    return MIDDLE + aside, MIDDLE, SURFACE - 0.5 + RADIUS - depth


def pushed(grid: DensityGrid, radius: float = RADIUS, material: Material | None = None, **how) -> Push:
    """A push of a ball through a grid."""
    return Push(grid, SphereTool(radius), material or Material(FULL_FORCE, YIELD_RATIO), **{"border": "wall"} | how)


class Run(NamedTuple):
    """What a push met at each of n poses: ``place`` (n, 3) voxels, ``force`` (n, 3) N, ``stress`` and ``yield_stress``
    (n,) N, the most ``sweeps`` to a solve, how many poses were ``blocked``, and the masses that ``moved`` and went
    ``out``."""

    place: np.ndarray
    force: np.ndarray
    stress: np.ndarray
    yield_stress: np.ndarray
    sweeps: int
    blocked: int
    moved: float
    out: float

    @property
    def strength(self) -> np.ndarray:
        """(n,) N."""
        return np.linalg.norm(self.force, axis=1)

    @property
    def work(self) -> float:
        """Joules that the hand has put in, by the trapezoidal rule."""
        ways = np.diff(self.place, axis=0) * VOXEL
        return -float(((self.force[1:] + self.force[:-1]) / 2 * ways).sum())


def run(push: Anything, path: Iterable, **how) -> Run:
    """Move through a path."""
    places = [tuple(place) for place in path]
    met = [push.move_to(place, **how) for place in places]
    return Run(
        np.array(places),
        np.array([contact.force for contact in met]),
        np.array([contact.stress for contact in met]),
        np.array([contact.yield_stress for contact in met]),
        max(contact.sweeps for contact in met),
        sum(contact.blocked for contact in met),
        sum(contact.moved_mass for contact in met),
        sum(contact.mass_out for contact in met),
    )


def total(grid: DensityGrid) -> float:
    """Mass in voxels' worth."""
    return float(grid.density.sum(dtype=np.float64))


def excess(grid: DensityGrid) -> float:
    """By how much a voxel is out of [0, 1], at most."""
    return max(float(grid.density.max()) - 1.0, -float(grid.density.min()), 0.0)


def coming(start: float, end: float, step: float) -> np.ndarray:
    """Numbers from start to end, evenly, at most ``step`` apart."""
    return np.linspace(start, end, max(2, int(np.ceil(abs(end - start) / step - 1e-9)) + 1))
