# SPDX-License-Identifier: GPL-3.0-or-later
"""Material: what the hand feels, in newtons, and how the clay answers (DESIGN 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .tool import Tool

EXPONENTS = (0.5, 1.5)
"""The least and the greatest exponent of the force. A ball on a flat surface holds V ~ depth^2: under 1/2, that of the
fully plastic contact, its force would begin with no finite slope; at 3/2 it is depth^3, and a tenth of the depth is a
thousandth of the force. Between them lie Hertz's 3/4 (depth^1.5) and the paper's 1."""
START = 0.002
"""Share of full force, in the paper's law, below which the power is a parabola through zero. There a ball of 16 voxels
has come in by less than one, the width of its own skin."""


@dataclass(frozen=True)
class Material:
    """An elastoplastic material as the estimators of paper equations 4 and 5 see it.

    Parameters
    ----------
    full_force
        Newtons: the stress sigma with the tool wholly inside density 1, so k_t = full_force / (sum of w_t).
    yield_ratio
        kappa = k_s / k_t: how many voxels in the tool balance one voxel in its reach before the material yields.
    exponent
        m of sigma = full_force (M_t / V_t)^m and sigma_f = full_force (kappa M_s / V_t)^m, from 1/2 to 3/2; 1 is the
        paper's law. What is felt changes with it and no voxel does, for sigma > sigma_f stays k_t M_t > k_s M_s.

    Raises ValueError for any that is out of its range.
    """

    full_force: float = 3.3
    yield_ratio: float = 0.1
    exponent: float = 1.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.full_force) and self.full_force > 0.0):
            raise ValueError(f"full_force is a positive number of newtons, not {self.full_force:g}")
        if not (np.isfinite(self.yield_ratio) and self.yield_ratio > 0.0):
            raise ValueError(f"yield_ratio is a positive number, not {self.yield_ratio:g}")
        low, high = EXPONENTS
        if not low <= self.exponent <= high:  # written so that NaN fails too
            raise ValueError(f"exponent is a number from {low:g} to {high:g}, not {self.exponent:g}")

    def stiffness(self, tool: Tool) -> tuple[float, float]:
        """(k_t, k_s) of paper equations 4 and 5, in newtons per voxel of full material; see :meth:`felt`."""
        k_t = self.full_force / tool.volume.covered_volume
        return k_t, k_t * self.yield_ratio

    def felt(self, paper: float) -> tuple[float, float]:
        """What ``paper`` newtons of paper equation 4 or 5 are felt as: (newtons, their derivative by those).

        F x^m with x = paper / F. Below x0 = :data:`START` it is F x0^m q (2 - m - (1 - m) q) with q = x / x0, the
        parabola through zero that has the power's value and slope at x0: its steepest slope is (2 - m) x0^(m - 1),
        where that of the power has no bound for m < 1. (No straight line through zero touches x^m unless m = 1.)
        """
        m, share = self.exponent, paper / self.full_force
        if share >= START:
            gain = share ** (m - 1.0)
            return paper * gain, m * gain
        gain, q = START ** (m - 1.0), share / START
        return paper * gain * (2.0 - m - (1.0 - m) * q), gain * (2.0 - m - 2.0 * (1.0 - m) * q)


def largest_yield_ratio(tool: Tool) -> float:
    """The kappa below which uniform material is sure to yield under this tool, 1 / ((R_s/R)^3 - 1) for a sphere.

    With the tool wholly inside density d, sigma = k_t V_t d and sigma_f = k_s (V_s - V_t) d.
    """
    inner, outer = tool.volume.covered_volume, tool.surroundings.covered_volume
    return inner / (outer - inner)


@dataclass(frozen=True)
class Preset:
    """A material by name: its forces, and the density and band that make it behave like its namesake.

    ``density`` is that of a new block; ``band`` is in tool radii, None for material that only compacts.
    """

    material: Material
    density: float
    band: float | None
    feel: str


PRESETS = {
    "clay": Preset(Material(3.3, 0.05), 1.0, 1.0, "packed and firm; what is pushed in rises as a rim around the tool"),
    "wax": Preset(
        Material(4.5, 0.12), 1.0, 0.5, "stiff; resists well before it yields, then piles up close to the tool"
    ),
    "dough": Preset(Material(1.2, 0.03), 0.98, 1.0, "soft; gives at a touch, swells a little around the tool"),
    "foam": Preset(Material(2.0, 0.10), 0.35, None, "light and crushable; dents without a rim and hardens as it packs"),
    "snow": Preset(Material(0.9, 0.06), 0.55, None, "loose; sinks in easily and packs into a crust ahead of the tool"),
}
"""The materials that artists pick from, each with a line on what it feels like."""
