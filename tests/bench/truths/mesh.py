# SPDX-License-Identifier: GPL-3.0-or-later
"""The half space in cylindrical coordinates (r, z): a cylinder of quadrilaterals, fine where the sphere goes."""

from __future__ import annotations

import numpy as np

FINE_ACROSS, FINE_DEEP = 1.05, 0.45
"""Extent of the even part of the mesh, in radii of the sphere: it holds the contact and the rim up to a depth of .3."""
GROWTH = 1.25
"""Each further edge over the one before it."""
FAR = 40.0
"""Radius and depth of the cylinder: the plastic zone reaches about 4 at E/Y = 500."""


def edges(size: float, even: float) -> np.ndarray:
    """Places of nodes along one direction, from 0 to at least FAR."""
    places = list(np.arange(round(even / size) + 1) * size)
    while places[-1] < FAR:
        size *= GROWTH
        places.append(places[-1] + size)
    return np.array(places)


def cylinder(size: float) -> tuple[np.ndarray, np.ndarray]:
    """(r, z) of the nodes, each (across, down) float64, with edges of ``size`` where the sphere goes; z = 0 on top."""
    across, down = edges(size, FINE_ACROSS), edges(size, FINE_DEEP)
    r, z = np.meshgrid(across, -down, indexing="ij")
    return np.ascontiguousarray(r), np.ascontiguousarray(z)
