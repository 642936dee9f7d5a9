# SPDX-License-Identifier: GPL-3.0-or-later
"""The mass layer of Dewaele and Cani's virtual clay (Graphical Models 66, 2004, section 3.2).

Rule: what a voxel holds above 1 goes in equal shares to its six neighbours, until all hold at most 1. Their layers of
large deformations and of surface tension are not here.
In one setting the rule is all there is, and the tool merely a place without room: what enters it is handed on through
it. In the other the tool first pushes what it covers outward, voxel by voxel along its own normal, and is closed to
what would come back; theirs pushes material out of the tool, and only in that much is this like theirs.
Gets wrong: the first lets material walk through the tool, out of its top and into the air around it; both have no
direction, no yield and no elastic return. The limit is found by `toppling`, not by their sweeps, which took as long as
they took and left the rest for the next frame.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tests.bench.chart.method import Method, Scene, Vector
from tests.bench.chart.methods.ousting import tool_in
from tests.bench.chart.methods.toppling import Toppled


@njit(cache=True)
def _hand_outward(density, capacity, order, centre):
    """Hand what is above capacity to the neighbours farther out, by the normal's components, innermost voxels first."""
    at = np.empty(3, np.int64)
    for row in range(order.shape[0]):
        at[:] = order[row]
        i, j, k = at
        over = density[i, j, k] - capacity[i, j, k]
        reach = abs(i - centre[0]) + abs(j - centre[1]) + abs(k - centre[2])
        if over <= 0.0 or reach <= 0.0:
            continue
        density[i, j, k] -= over
        for axis in range(3):
            away = at[axis] - centre[axis]
            beside = at.copy()
            beside[axis] += 1 if away > 0.0 else -1
            if not 0 <= beside[axis] < density.shape[axis]:
                beside[axis] = at[axis]  # the wall: it stays, and topples
            density[beside[0], beside[1], beside[2]] += over * abs(away) / reach


def push_outward(density: np.ndarray, capacity: np.ndarray, position: Vector, radius: float) -> None:
    """Move what ``density`` (nx, ny, nz) float64 holds above ``capacity`` out along the tool's normals, in place."""
    box, covered = tool_in(density.shape, position, radius)
    inside = np.argwhere(covered > 0.0) + [s.start for s in box]
    order = np.argsort(np.linalg.norm(inside - position, axis=1), kind="stable")
    _hand_outward(density, capacity, inside[order], np.asarray(position, float))


def _pushing(scene: Scene) -> Toppled:
    _hand_outward(*np.zeros((2, 1, 1, 1)), np.zeros((0, 3), np.int64), np.zeros(3))  # compiled now, not in a step
    return Toppled(scene, obstacle=True, oust=push_outward)


METHODS = [
    Method("overflow", "through the tool", lambda scene: Toppled(scene, obstacle=False)),
    Method("overflow", "tool pushes outward", _pushing),
]
