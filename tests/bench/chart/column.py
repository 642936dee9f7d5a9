# SPDX-License-Identifier: GPL-3.0-or-later
"""The constitutive law in closed form: a flat punch as wide as its walled column (DESIGN 2).

The chart's tool is a sphere. One of 64 voxels under a column four voxels wide is flat to .04 voxel, and its reach,
half a radius wider than the tool, is the law's D.
"""

from __future__ import annotations

import numpy as np

from ..truths.column import ColumnLaw
from . import scenes
from .method import Scene

ACROSS, RADIUS, DEPTH = 4, 64.0, 30.0
LAW = ColumnLaw(stiffness=1.0, kappa=0.1, density=0.5, reach=RADIUS / 2.0)
"""With a stiffness of 1, its force is m: what the punch holds, voxels' worth for each voxel of cross-section."""


def density(depth: float, face: float, planes: int) -> np.ndarray:
    """Of the planes (planes,) at a depth: full from the m voxels that the punch holds to the front, and as it was
    beyond. ``face`` is where the material began, in voxels from the first plane's lower edge; the punch comes from
    above."""
    held = float(LAW.pressed(np.array(depth)))
    compacted = (LAW.density * depth - held) / (1.0 - LAW.density)
    front = face - depth
    lower, upper = np.arange(planes, dtype=float), np.arange(1.0, planes + 1.0)

    def share(low: float, high: float) -> np.ndarray:
        return np.clip(np.minimum(upper, high) - np.maximum(lower, low), 0.0, 1.0)

    return share(front - compacted, front + held) + LAW.density * share(0.0, front - compacted)


def scene(depth: float = DEPTH) -> Scene:
    """The column under the punch."""
    material = int(depth + depth * LAW.density / (1.0 - LAW.density) + LAW.reach + 8)
    return scenes.press(ACROSS, material, 4, RADIUS, depth, LAW.density, LAW.kappa)
