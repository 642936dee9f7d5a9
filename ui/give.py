# SPDX-License-Identifier: GPL-3.0-or-later
"""Elastic give: how far the surface bows under a tool that loads it, and comes back from. Drawn, and never stored.

Density does not move under a load that the material bears, so its surface stands in the tool. What is drawn follows the
tool there, as the surface of an elastic half-space follows a ball (Hertz; Johnson, Contact Mechanics, 1985, 3.42).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, hypot, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

from ..core.grid import Box
from ..core.tool import Vector, vector

if TYPE_CHECKING:
    from ..core.push import Push

REACH = 2.5
"""Tool radii from the tool's tip within which the surface gives."""
MOST = 8
"""Tools at a time: one, and its mirror images."""
LEAST = 0.02
"""Voxels of give that are not worth a picture."""
EMPTY = 0.05
"""Density below which a voxel bears nothing."""


@dataclass(frozen=True)
class Give:
    """One tool's: ``tip`` is where its front is, ``by`` how far the surface on its axis has come to be there, and
    ``radius`` the tool's; all in voxels of the array."""

    tip: Vector
    by: Vector
    radius: float

    @property
    def box(self) -> Box:
        """The voxels that may be seen elsewhere for it."""
        reach = REACH * self.radius + 1.0
        low, high = (vector(t + sign * reach for t in self.tip) for sign in (-1.0, 1.0))
        return tuple(int(v) for v in low), tuple(int(v) + 2 for v in high)

    def at(self, distance: float) -> float:
        """Voxels of give of the surface at a ``distance`` (voxels) from the axis, as the shader has it."""
        depth = hypot(*self.by)
        q = distance / sqrt(self.radius * depth)
        share = 1.0 - 0.5 * q * q if q < 1.0 else ((2.0 - q * q) * asin(1.0 / q) + sqrt(q * q - 1.0)) / pi
        part = min(max((distance / self.radius - 1.0) / (REACH - 1.0), 0.0), 1.0)
        return depth * share * (1.0 - part * part * (3.0 - 2.0 * part))


def under(push: Push) -> Give | None:
    """That of the last contact of a push; None when it bears no load.

    The tool holds mass that has not given way: its front stands in the material by the height of a cap of the tool
    that holds as much, at the density ahead of it. The front is where the force comes from.
    """
    (contact,), position = push.contacts, push.position
    force = hypot(*contact.force)
    if position is None or push.verb != "push" or contact.stress <= 0.0 or force == 0.0:
        return None
    inward, radius = -contact.force / force, push.tool.radius
    tip = np.array(position) + radius * inward - push.origin
    volume = contact.tool_mass / _ahead(push.grid.density, tip, inward, radius)
    depth = cap_height(volume, radius)
    return Give(vector(tip), vector(depth * inward), radius) if depth >= LEAST else None


def cap_height(volume: float, radius: float) -> float:
    """Height of the cap of a ball that has this volume, V = pi h^2 (3 R - h) / 3; at most the radius."""
    share = min(3.0 * volume / (pi * radius**3), 2.0)
    height = sqrt(share / 3.0)
    for _ in range(4):  # Newton on h^2 (3 - h) = share
        if height > 0.0:
            height += (share - height**2 * (3.0 - height)) / (height * (6.0 - 3.0 * height))
    return radius * min(height, 1.0)


def _ahead(density: np.ndarray, tip: np.ndarray, inward: np.ndarray, radius: float) -> float:
    """Mean density of what there is along a tool's radius ahead of its tip; 1 where there is nothing."""
    ways = np.arange(1.0, max(radius, 2.0))
    voxels = np.rint(tip + ways[:, None] * inward).astype(int)
    voxels = voxels[((voxels >= 0) & (voxels < density.shape)).all(axis=1)]
    met = density[tuple(voxels.T)]
    met = met[met > EMPTY]
    return float(met.mean()) if len(met) else 1.0
