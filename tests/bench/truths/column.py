# SPDX-License-Identifier: GPL-3.0-or-later
"""The constitutive law in closed form: a column under a punch as wide as itself (DESIGN 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ColumnLaw:
    """A column under a punch as wide as itself, in closed form (DESIGN 2).

    ``stiffness`` k_t A in N/voxel, ``kappa`` the yield ratio, ``density`` d0 of the loose material, ``reach`` D in
    voxels ahead of the punch. Depths are in voxels, forces in N.
    """

    stiffness: float
    kappa: float
    density: float
    reach: float

    @property
    def yield_depth(self) -> float:
        return self.kappa * self.reach

    @property
    def elastic_slope(self) -> float:
        return self.stiffness * self.density

    @property
    def plastic_slope(self) -> float:
        return self.elastic_slope * self.kappa / (1.0 + self.kappa)

    @property
    def plateau_begins(self) -> float:
        return self.reach * ((1.0 + self.kappa) / self.density - 1.0)

    @property
    def plateau(self) -> float:
        return self.stiffness * self.kappa * self.reach

    def pressed(self, depth: np.ndarray) -> np.ndarray:
        """The force on the way in."""
        elastic = self.elastic_slope * np.maximum(depth, 0.0)
        plastic = self.plastic_slope * (self.reach + np.maximum(depth, 0.0))
        return np.minimum(np.minimum(elastic, plastic), self.plateau)

    def allowed(self, depth: np.ndarray) -> np.ndarray:
        """The yield stress on the way in: k_s times what the reach holds, which grows by what leaves the punch."""
        held = self.reach + np.maximum(depth, self.yield_depth)
        return np.minimum(self.plastic_slope * held, self.plateau)

    def released(self, depth: np.ndarray, deepest: float) -> np.ndarray:
        """The force on the way back from the plateau: the front is compacted, so E / d0 over its first voxels."""
        return np.clip(self.plateau - self.stiffness * (deepest - depth), 0.0, None)

    def compacted_length(self, depth: float) -> float:
        """Of the full material ahead of the punch, voxels."""
        return (self.density * depth - self.yield_depth) / (1.0 - self.density)

    @property
    def expected(self) -> dict[str, float]:
        """The rows by name."""
        return {
            "elastic slope, N/voxel": self.elastic_slope,
            "yield depth, voxels": self.yield_depth,
            "plastic slope, N/voxel": self.plastic_slope,
            "plateau begins, voxels": self.plateau_begins,
            "plateau, N": self.plateau,
            "unloading slope, N/voxel": self.stiffness,
            "unloading ends after, voxels": self.yield_depth,
        }

    def rows(self, depth: np.ndarray, force: np.ndarray) -> dict[str, tuple[float, float]]:
        """Each row of the law as it is found in a press and its retreat, and as it should be.

        ``force`` (n,) is that against the punch at each ``depth`` (n,), in the order of time. Slopes are those of lines
        through what lies clear of a row's ends.
        """
        turn = int(depth.argmax())
        deepest, way_in, way_out = depth[turn], slice(0, turn), slice(turn, None)
        plastic_from, plastic_to = self.yield_depth + 1.0, self.plateau_begins - 2.0
        elastic, at_zero = _line(depth[way_in], force[way_in], 0.5, self.yield_depth - 0.5)
        plastic, there = _line(depth[way_in], force[way_in], plastic_from, plastic_to)
        on_plateau = depth[way_in] > self.plateau_begins + 2.0
        plateau = float(np.median(force[way_in][on_plateau]))
        back = deepest - depth[way_out]
        unloading, peak = _line(back, force[way_out], 0.25, self.yield_depth - 0.75)
        found = (
            elastic,
            (there - at_zero) / (elastic - plastic),
            plastic,
            (plateau - there) / plastic,
            plateau,
            -unloading,
            -peak / unloading,
        )
        return {name: (here, there) for here, (name, there) in zip(found, self.expected.items(), strict=True)}


def _line(depth: np.ndarray, force: np.ndarray, low: float, high: float) -> tuple[float, float]:
    """Slope and value at 0 of the line through what lies between two depths."""
    chosen = (depth >= low) & (depth <= high)
    if chosen.sum() < 10:
        raise ValueError(f"only {chosen.sum()} of the force was seen from {low:g} to {high:g} voxels")
    slope, at_zero = np.polyfit(depth[chosen], force[chosen], 1)
    return float(slope), float(at_zero)
