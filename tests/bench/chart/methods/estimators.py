# SPDX-License-Identifier: GPL-3.0-or-later
"""The sweep with other estimators of sigma and sigma_f: whole voxels, and frozen random samples.

The sweep itself, and the normal of the contact, stay those of fractional coverage; what differs is what the material is
thought to bear, and so when it yields, how much of it moves, and what the hand feels. They are of numpy: compare their
errors with those of "sweep, numpy", not their times with the compiled estimator's.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from repousse.core import plasticity
from repousse.core import push as core_push
from repousse.core.native.state import Probe
from repousse.core.plasticity import box_around

from ..method import Method, Scene
from .sweep import Pushing, without_rim

SEED = 5
Estimator = Callable[[Probe], tuple[float, float]]


def whole_voxels(work: Probe) -> tuple[float, float]:
    """(M_t, M_s), each voxel in or out by its centre."""
    centre = work.tool.centre[:]
    box, offsets = box_around(work.surroundings, centre, work.density.shape)
    density = work.density[box]
    inside = float(density[work.volume.distance(*offsets) < 0.0].sum(dtype=np.float64))
    both = float(density[work.surroundings.distance(*offsets) < 0.0].sum(dtype=np.float64))
    return inside, both - inside


class FrozenSamples:
    """(M_t, M_s) from ``count`` points in the tool and as many around it, always the same ones as the tool sees them.

    Were they drawn anew each time, the force would be noise; frozen, it is a function of the place.
    """

    def __init__(self, count: int) -> None:
        generator = np.random.default_rng(SEED)
        way = generator.normal(size=(2 * count, 3))
        self._way = way / np.linalg.norm(way, axis=1, keepdims=True)
        self._share = generator.random(2 * count)
        self._count = count
        self._radii: tuple[float, float] | None = None

    def _place(self, radius: float, reach: float) -> None:
        inside, around = self._share[: self._count], self._share[self._count :]
        far = np.concatenate([radius**3 * inside, radius**3 + (reach**3 - radius**3) * around]) ** (1.0 / 3.0)
        self._points = self._way * far[:, None]
        self._volumes = 4.0 / 3.0 * np.pi * radius**3, 4.0 / 3.0 * np.pi * (reach**3 - radius**3)
        self._radii = (radius, reach)

    def __call__(self, work: Probe) -> tuple[float, float]:
        radii = (work.volume.radius, work.surroundings.radius)
        if self._radii != radii:
            self._place(*radii)
        voxel = np.floor(self._points + work.tool.centre[:] + 0.5).astype(np.int64)
        known = ((voxel >= 0) & (voxel < work.density.shape)).all(axis=1)
        voxel[~known] = 0
        found = np.where(known, work.density[tuple(voxel.T)], 0.0)
        means = found[: self._count].mean(), found[self._count :].mean()
        return float(self._volumes[0] * means[0]), float(self._volumes[1] * means[1])


def estimated_by(make: Callable[[], Estimator]) -> Callable[[Scene], Pushing]:
    """A sweep that thinks the material bears what an estimator says, in the process that is the method's own."""

    def begin(scene: Scene) -> Pushing:
        estimator = make()

        def estimate(work: Probe) -> None:
            plasticity.estimate(work)  # for the normal
            work.estimate.tool_mass, work.estimate.reach_mass = estimator(work)

        core_push.estimate = estimate
        return without_rim(scene)

    return begin


METHODS = [
    Method("sweep", "whole voxels", estimated_by(lambda: whole_voxels)),
    Method("sweep", "1000 frozen samples", estimated_by(lambda: FrozenSamples(1000))),
    Method("sweep", "10000 frozen samples", estimated_by(lambda: FrozenSamples(10000))),
]
