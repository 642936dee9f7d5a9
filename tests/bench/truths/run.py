# SPDX-License-Identifier: GPL-3.0-or-later
"""One press of one solid on one mesh."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from tqdm import tqdm

from . import solver
from .case import DEPTHS
from .measures import PROFILE_R, Press, contact_radius, crushed, filled, rim, volumes
from .mesh import cylinder
from .solid import Solid

INTERVALS = 120
"""Over which forces are averaged."""
SETTLED = 0.02
"""Depth from which on kinetic energy is looked at: before it the sphere gathers speed."""


def press(
    solid: Solid, size: float, depths: tuple[float, ...] = DEPTHS, raster: bool = True, steps: int = 0, label: str = ""
) -> Press:
    """Press the sphere to the last of ``depths`` on a mesh of ``size``, and look at each of them.

    ``raster`` also asks for the density; ``steps`` is how many there are, 0: as many as make it slow; a ``label`` shows
    how far it is.
    """
    r, z = cylinder(size)
    state, before = solver.at_rest(r), volumes(r, z)
    steps = steps or round(solver.STEPS_TIMES_SIZE / size)
    path = solver.depth_at_each(np.arange(steps + 1) / steps, depths[-1])
    looks = np.minimum(np.searchsorted(path, depths), steps)
    marks = np.unique(np.r_[np.linspace(0, steps, INTERVALS + 1).astype(int), looks])
    curve, seen, work, kinetic = [], [], 0.0, 0.0
    for first, last in tqdm(list(pairwise(marks)), label, disable=not label, leave=False):
        force, energy = solver.press(r, z, state, solid.constants, depths[-1], first, last, steps)
        work += force * (path[last] - path[first])
        if not np.isfinite(force):
            raise ArithmeticError(f"the press went wrong at depth {path[last]:.3f}, h = {size:g}: {solid}")
        if path[last] > SETTLED * depths[-1] / DEPTHS[-1]:
            kinetic = max(kinetic, energy / work)
        radius = contact_radius(r[:, 0], z[:, 0], state[-1], path[last])
        curve.append((0.5 * (path[first] + path[last]), force, radius))
        if last in looks:
            height, place = rim(r[:, 0], z[:, 0])
            edge = np.interp(radius, r[:, 0], z[:, 0])
            profile = np.interp(PROFILE_R, r[:, 0], z[:, 0])
            share = filled(r[:, 0], z[:, 0]) * crushed(r, z, before / volumes(r, z), solid) if raster else np.zeros(())
            seen.append((path[last], height / path[last], place, edge / path[last], profile, share))
    depth, force, radius = np.array(curve).T
    return Press(size, depth, force, radius, kinetic, *(np.array(column) for column in zip(*seen)))
