# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed paths where nothing yields: what a round trip through the field of forces gives, or costs.

The force is sigma along g/|g|, g = grad M_t (DESIGN 4). Its curl is sigma rot(g/|g|) = sigma g x grad|g| / |g|^2: none
over a flat surface, a round body, or wherever |g| changes along g alone; some at an edge; and most in the mouth of a
hole, whose walls cancel each other in g but add up in sigma. A force that has a potential, -grad(sigma^2 / 2K), is
sigma grad sigma / K, whose strength is not sigma. So the curl is the law's own, "a force of sigma along the normal",
and no error of the grid: what is asked here is how large it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from repousse.core import DensityGrid, Material
from repousse.core.local_model import Feeler
from repousse.core.material import largest_yield_ratio
from tests.core.volumes import speckled

from ..contact import FULL_FORCE, MIDDLE, RADIUS, SIDE, SURFACE, VOXEL, pushed
from ..figure import Figure

POINTS = 180
"""Round a path: twice as many change what comes out by less than a thousandth of the work on the way."""
FLAT = 0.003
"""Share of the greatest force that the mean pull along a path may be where there is no curl: the grid's own."""
EDGE = 0.05
"""The same at edges, corners and posts: measured .03."""
HOLE = 0.2
"""The same in the mouth of a hole that is narrower than the ball: measured .15, the greatest that was found."""


class Shape(NamedTuple):
    """A body by its signed distance (voxels, positive inside), the mark, and where paths go round."""

    inside: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    mark: float
    centres: tuple[tuple[float, float, float], ...]


def _radius(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.hypot(x - MIDDLE, y - MIDDLE)


TOP = SURFACE - 0.5 + RADIUS - 3.0
SHAPES = {
    "flat": Shape(lambda x, y, z: SURFACE - 0.5 - z, FLAT, ((MIDDLE, MIDDLE, TOP),)),
    "ball": Shape(
        lambda x, y, z: 6.0 - np.hypot(_radius(x, y), z - MIDDLE),
        FLAT,
        ((MIDDLE, MIDDLE, MIDDLE + 12.0), (MIDDLE - 6.0, MIDDLE + 5.0, MIDDLE + 8.0)),
    ),
    "edge": Shape(
        lambda x, y, z: np.minimum(20.0 - z, 20.0 - x),
        EDGE,
        ((17.5, 24.0, 26.0), (24.0, 24.0, 24.0), (21.0, 24.0, 26.0)),
    ),
    "corner": Shape(
        lambda x, y, z: np.minimum(np.minimum(20.0 - z, 20.0 - x), 20.0 - y),
        EDGE,
        ((23.0, 23.0, 23.0), (21.0, 21.0, 25.0)),
    ),
    "post": Shape(
        lambda x, y, z: np.minimum(20.0 - z, 3.0 - _radius(x, y)), EDGE, ((29.5, 19.5, 17.0), (25.0, 20.0, 24.0))
    ),
    "hole": Shape(
        lambda x, y, z: np.minimum(20.0 - z, _radius(x, y) - 6.0), HOLE, ((21.5, 19.5, 17.0), (19.5, 19.5, 23.0))
    ),
}


def closed_paths() -> Iterator[Figure]:
    """Circles and squares of one, two and four voxels, upright and level, in a material that does not yield."""
    solids = {name: (body(shape), shape) for name, shape in SHAPES.items()}
    solids["CT"] = (speckled(SIDE), Shape(SHAPES["flat"].inside, EDGE, ((29.5, 19.5, 35.0), (MIDDLE, MIDDLE, 38.0))))
    for name, (grid, shape) in solids.items():
        case = f"closed paths, {name}"
        trips = [trip for centre in shape.centres for trip in _trips(grid, centre)]
        worst = max(trips, key=lambda trip: abs(trip.energy))
        pull = max(abs(trip.energy) / trip.length / trip.strength for trip in trips)
        yield Figure(case, "mean pull along the path", pull, "of the greatest force", shape.mark)
        yield Figure(case, "energy of a round trip", 1e6 * abs(worst.energy), "uJ", 1e6 * MOST_ENERGY)
        yield Figure(case, "greatest force on it", worst.strength, "N", at_least=0.05)


MOST_ENERGY = 2e-3
"""Joules that any of these trips may give. A hand that goes the same two centimetres at 0.1 m/s takes 3 mJ, with the
damping of a soft grip (1.5 N s/m)."""


class Trip(NamedTuple):
    """Joules that a closed path gives (or costs, below 0), its length in m, and the greatest force on it in N."""

    energy: float
    length: float
    strength: float


def body(shape: Shape) -> DensityGrid:
    inside = shape.inside(*np.indices((SIDE,) * 3).astype(float))
    return DensityGrid(np.clip(inside + 0.5, 0.0, 1.0).astype(np.float32))


def _trips(grid: DensityGrid, centre: tuple[float, float, float]) -> Iterator[Trip]:
    push = pushed(grid, material=Material(FULL_FORCE, 0.999 * largest_yield_ratio(pushed(grid).tool)))
    feeler = Feeler(push)
    for radius in (1.0, 2.0, 4.0):
        for path in (_circle(radius), _square(radius)):
            for across in (1, 2):  # level, and upright
                places = np.zeros((POINTS, 3))
                places[:, [0, across]] = path
                places += centre
                models = [feeler.feel(tuple(place), push.tool) for place in places]
                forces = np.array([max(model.stress, 0.0) * np.array(model.normal) for model in models])
                ways = np.roll(places, -1, axis=0) - places
                energy = float(((forces + np.roll(forces, -1, axis=0)) / 2.0 * ways).sum()) * VOXEL
                strength = float(np.linalg.norm(forces, axis=1).max())
                if strength > 0.0:
                    yield Trip(energy, float(np.linalg.norm(ways, axis=1).sum()) * VOXEL, strength)


def _circle(radius: float) -> np.ndarray:
    turn = np.linspace(0.0, 2.0 * np.pi, POINTS, endpoint=False)
    return radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def _square(half: float) -> np.ndarray:
    side = np.linspace(-half, half, POINTS // 4, endpoint=False)
    edge = np.full_like(side, half)
    quarters = ((side, -edge), (edge, side), (-side, edge), (-edge, -side))
    return np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])


CASES = (closed_paths,)
