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


@dataclass(frozen=True)
class Packing:
    """How a block is filled and pushed so that it dents like a given solid: its ``density``, and a push's ``rim`` and
    ``band``, this in tool radii; None: what is pushed in only compacts."""

    density: float
    band: float | None
    rim: float


ROOM_IN_STRAIN, FIRM_STRAIN = 3.8, 0.002
"""Room for each Y / E beyond that of a solid so stiff that its far field takes nothing."""
ROOM_IN_HARDENING, FIRM_HARDENING = 1.2, 0.01
"""The same for each H / E."""
NARROWEST_RIM, WIDEST_RIM = 1.35, 4.0
"""Of the hats, in contact radii."""
LOOSEST = 0.6
"""Least density of what is not foam."""


def packing(young_modulus: float, yield_stress: float, hardening: float = 0.0, filled: float = 1.0) -> Packing:
    """The packing whose rim is that of an elastoplastic solid under a sphere, as finite elements have it.

    ``young_modulus`` E, ``yield_stress`` Y and ``hardening`` H (what plastic strain adds to Y) share a unit. ``filled``
    is the share of its volume that is solid: below 1 it is a foam, which only compacts.

    Of what is pressed in, the elastic far field takes the more the greater the strain at which it yields: so much room
    does the block get, 1 - d0 = 3.8 (Y/E - .002) + 1.2 (H/E - .01), neither term below 0. What hardens also spreads the
    rest farther: rim = 1.35 (1 + H/Y) contact radii, at most 4. The band is one radius.

    On trial against such elements (tests/bench/truths) with tools of 32 to 64 voxels, E/Y of 50 to 500 and H of 0 to
    E/10: at depths of .15 to .3 R the rim is within .063 of the depth of theirs, before that within .112, which is a
    fifth of a voxel; where it is highest is within .05 R, or .11 R on the flat rim of what hardens. What they have and
    a push has not is the surface that sinks in around the contact, by about a quarter of the depth where no rim stands.

    Raises
    ------
    ValueError
        When E or Y is not positive, H negative, or ``filled`` not above 0 and at most 1.
    """
    for what, value in (("young_modulus", young_modulus), ("yield_stress", yield_stress)):
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"{what} is a positive number, not {value:g}")
    if not (np.isfinite(hardening) and hardening >= 0.0):
        raise ValueError(f"hardening is a number from 0 up, not {hardening:g}")
    if not 0.0 < filled <= 1.0:
        raise ValueError(f"filled is a share above 0 and at most 1, not {filled:g}")
    if filled < 1.0:
        return Packing(filled, None, NARROWEST_RIM)
    room = ROOM_IN_STRAIN * max(yield_stress / young_modulus - FIRM_STRAIN, 0.0)
    room += ROOM_IN_HARDENING * max(hardening / young_modulus - FIRM_HARDENING, 0.0)
    widened = min(NARROWEST_RIM * (1.0 + hardening / yield_stress), WIDEST_RIM)
    return Packing(max(1.0 - room, LOOSEST), 1.0, widened)
