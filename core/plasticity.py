# SPDX-License-Identifier: GPL-3.0-or-later
"""The constitutive law: what is estimated around the tool, and which of the four regimes it means (paper 3.1 and 6)."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import byref
from enum import Enum
from math import hypot

import numpy as np

from .material import Material
from .native.state import Probe
from .native.structures import Estimate
from .tool import Shape, Vector

RELAXED = 2e-3
"""Share of the yield stress by which the stress may exceed it and still count as equal: a tool at rest does not creep,
and a stress that is corrected by less than this is corrected for nothing a hand can feel (its threshold is 8 %)."""

FADE = 1.0
"""|grad M_t| (voxels' worth per voxel) below which the contact normal fades, so that it does not flip in uniform
surroundings."""


class Regime(Enum):
    """The four states of the material under the tool (paper figure 3)."""

    NONE = "none"
    ELASTIC = "elastic"
    PLASTIC = "plastic"
    UNLOADING = "unloading"


def stresses(masses: Estimate, material: Material, k_t: float, k_s: float, yields: bool) -> tuple[float, float]:
    """sigma and sigma_f in newtons (paper equations 4 and 5, to the material's exponent). Material that does not yield,
    because it is pulled or smoothed and moves as it is told, holds what it bears."""
    stress, _ = material.felt(k_t * masses.tool_mass)
    yield_stress, _ = material.felt(k_s * masses.reach_mass)
    return stress, yield_stress if yields else max(stress, yield_stress)


def stress_gradient(masses: Estimate, material: Material, k_t: float) -> tuple[Vector, float]:
    """grad sigma = d sigma / d M_t grad M_t in newtons per voxel of the tool's way, and d ln sigma / d ln M_t: the
    material's exponent, and 1 where nothing is touched yet."""
    paper, (x, y, z) = k_t * masses.tool_mass, masses.gradient
    stress, rate = material.felt(paper)
    return (k_t * rate * x, k_t * rate * y, k_t * rate * z), rate * paper / stress if stress > 0.0 else 1.0


def overloaded(stress: float, yield_stress: float) -> bool:
    """sigma > sigma_f: density has to move until they are equal (paper 7).

    Both of the paper's law, or M_t and kappa M_s: so which voxels change does not depend on the exponent."""
    return stress > yield_stress * (1.0 + RELAXED)


def regime_of(stress: float, dispersed: bool, former_stress: float, former: Regime) -> Regime:
    """The regime after a move, from the stress before it and whether density moved (paper equations 1 to 3)."""
    if dispersed:
        return Regime.PLASTIC
    if stress <= 0.0:
        return Regime.NONE
    if stress == former_stress and former is not Regime.NONE:
        return Regime.UNLOADING if former is Regime.UNLOADING else Regime.ELASTIC
    return Regime.UNLOADING if stress < former_stress else Regime.ELASTIC


def contact_normal(gradient: Vector) -> Vector:
    """Outward normal -g / max(|g|, g0) of the contact: shorter than 1 where the surroundings are uniform."""
    length = max(hypot(*gradient), FADE)
    return -gradient[0] / length, -gradient[1] / length, -gradient[2] / length


def felt_force(stress: float, yield_stress: float, normal: Vector, direction: Vector | None) -> np.ndarray:
    """The force on the hand in newtons, shape (3,): min(sigma, sigma_f), along the outward normal of the contact.

    Where the normal fades, the force turns against the push instead; with neither there is none to give.
    """
    faded = 1.0 - hypot(*normal) if direction is not None else 0.0
    heading = [n - faded * u for n, u in zip(normal, direction or normal, strict=True)]
    length = hypot(*heading)
    if length < 1e-12:
        return np.zeros(3)
    return np.array([h * (min(stress, yield_stress) / length) for h in heading])


def estimate(work: Probe) -> None:
    """M_t = sum of w_t d, M_s = sum of (w_s - w_t) d, and grad M_t, into ``work.estimate`` (paper equations 4 and 5).

    The reach is what surrounds the tool, so the tool's own mass is not in M_s.
    """
    if work.library:
        work.library.repousse_estimate(byref(work.grid), byref(work.tool), byref(work.estimate))
    else:
        _estimate_numpy(work)


def box_around(
    shape: Shape, centre: Sequence[float], limits: Sequence[int]
) -> tuple[tuple[slice, slice, slice], list[np.ndarray]]:
    """The voxels of a grid that a shape may cover: slices, and their offsets from its centre as three open axes."""
    slices, offsets = [], []
    for axis, (extent, n) in enumerate(zip(shape.extent, limits, strict=True)):
        low = int(min(max(np.floor(centre[axis] - extent - 0.5), 0), n))
        high = int(max(min(np.ceil(centre[axis] + extent + 0.5) + 1, n), low))
        slices.append(slice(low, high))
        shaped = [1, 1, 1]
        shaped[axis] = high - low
        offsets.append((np.arange(low, high) - centre[axis]).reshape(shaped))
    return (slices[0], slices[1], slices[2]), offsets


def _estimate_numpy(work: Probe) -> None:
    centre, result = work.tool.centre[:], work.estimate
    box, offsets = box_around(work.surroundings, centre, work.density.shape)
    both = float((work.surroundings.coverage(*offsets) * work.density[box]).sum())
    result.read = work.density[box].size
    box, offsets = box_around(work.volume, centre, work.density.shape)
    density, covered = work.density[box], work.volume.coverage(*offsets)
    result.read += density.size
    result.tool_mass = float((covered * density).sum())
    result.reach_mass = both - result.tool_mass
    skin = np.nonzero((covered > 0.0) & (covered < 1.0) & (density > 0.0))
    at = [offset.ravel()[index] for offset, index in zip(offsets, skin, strict=True)]
    result.gradient[:] = (work.volume.normal(*at) * density[skin]).sum(axis=1)
