# SPDX-License-Identifier: GPL-3.0-or-later
"""The constitutive law in closed form: a flat punch as wide as its walled column (DESIGN 2).

The chart's tool is a sphere. One of 64 voxels under a column four voxels wide is flat to .04 voxel, and its reach,
half a radius wider than the tool, is the law's D.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import scenes
from .method import Scene

ACROSS, RADIUS, DEPTH = 4, 64.0, 30.0


@dataclass(frozen=True)
class ColumnLaw:
    """The law of a column of ``density`` d0 under a punch that reaches ``reach`` D voxels ahead, for ``kappa``."""

    density: float = 0.5
    kappa: float = 0.1
    reach: float = RADIUS / 2.0

    @property
    def yield_depth(self) -> float:
        """kappa D, in voxels."""
        return self.kappa * self.reach

    def held(self, depth: np.ndarray) -> np.ndarray:
        """m: what the punch holds at a depth, voxels' worth for each voxel of cross-section. The stress is k_t A m."""
        elastic = self.density * depth
        plastic = self.density * (self.yield_depth + (depth - self.yield_depth) * self.kappa / (1.0 + self.kappa))
        return np.minimum(np.minimum(elastic, plastic), self.kappa * self.reach)

    def column(self, depth: float, face: float, planes: int) -> np.ndarray:
        """Density of the planes (planes,) at a depth: full from the m voxels that the punch holds to the front, and as
        it was beyond. ``face`` is where the material began, in voxels from the first plane's lower edge; the punch
        comes from above."""
        held = float(self.held(np.array(depth)))
        compacted = (self.density * depth - held) / (1.0 - self.density)
        front = face - depth
        lower, upper = np.arange(planes, dtype=float), np.arange(1.0, planes + 1.0)

        def share(low: float, high: float) -> np.ndarray:
            return np.clip(np.minimum(upper, high) - np.maximum(lower, low), 0.0, 1.0)

        return share(front - compacted, front + held) + self.density * share(0.0, front - compacted)


def scene(law: ColumnLaw, depth: float = DEPTH) -> Scene:
    """The column under the punch."""
    compacted = depth * law.density / (1.0 - law.density)
    material = int(depth + compacted + law.reach + 8)
    return scenes.press(ACROSS, material, 4, RADIUS, depth, law.density, law.kappa)
