# SPDX-License-Identifier: GPL-3.0-or-later
"""What the exponent of the force buys: `python -m tests.bench.force_exponent` prints force errors of a ball's press.

A ball of 16 voxels goes .3 R into three materials. Its force over depth is compared with the truth's, one least-squares
factor being free, for each exponent. One press does for all of them, for no voxel depends on the exponent. The truths
are the finite elements' forces (truths/), and Hertz's power of the depth for what does not yield.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from repousse.core import PRESETS, DensityGrid, Material, Push, SphereTool, Stroke

from .truths import load

RADIUS, DEEP, STEP, ABOVE = 16.0, 0.3, 0.1, 12
EXPONENTS = (1.0, 0.75, 0.5)
HERTZ = "Hertz"


@dataclass(frozen=True)
class Press:
    """A block of ``density`` of a ``material``, the ``reach`` and the ``band`` in radii (None: no band), and whose the
    true force is: a case of the finite elements, or Hertz's."""

    name: str
    material: Material
    density: float
    band: float | None
    truth: str
    reach: float = 1.5


FOAM, CLAY = PRESETS["foam"], PRESETS["clay"]
PRESSES = (
    Press("foam", FOAM.material, FOAM.density, FOAM.band, "foam-500"),
    Press("foam, reach 1.1 R", FOAM.material, FOAM.density, FOAM.band, "foam-500", 1.1),
    Press("packed clay, band R", CLAY.material, CLAY.density, CLAY.band, "mises-500"),
    Press("elastic", Material(yield_ratio=10.0), 1.0, None, HERTZ),
)


def pressed(press: Press) -> tuple[np.ndarray, np.ndarray]:
    """Depths in voxels and the newtons of the paper's law at each, min(sigma, sigma_f), both (n,)."""
    across, deep = int(4 * RADIUS), int(ABOVE + 4 * RADIUS)
    values = np.zeros((deep, across, across), np.float32)
    values[ABOVE:] = press.density
    middle = (across - 1) / 2
    touch = ABOVE - 0.5 - RADIUS
    tool = SphereTool(RADIUS, press.reach * RADIUS)
    material = replace(press.material, exponent=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the elastic one is not to yield
        push = Push(DensityGrid(values), tool, material, band=None if press.band is None else press.band * RADIUS)
    line = Stroke.line((touch, middle, middle), (touch + DEEP * RADIUS, middle, middle), STEP)
    felt = np.array([min(contact.stress, contact.yield_stress) for contact in push.follow(line)])
    return np.array([sample.position[0] - touch for sample in line.samples]), felt


def true_force(truth: str, depth: np.ndarray) -> np.ndarray:
    """The force (n,) at depths (n,) in radii, in a unit of the truth's own."""
    if truth == HERTZ:
        return depth**1.5
    indentation = load(truth)
    return np.interp(depth, indentation.depth, indentation.force)


def with_exponent(material: Material, paper: np.ndarray, exponent: float) -> np.ndarray:
    """What the newtons (n,) of the paper's law are felt as."""
    law = replace(material, exponent=exponent)
    return np.array([law.felt(float(newtons))[0] for newtons in paper])


def force_error(force: np.ndarray, truth: np.ndarray) -> float:
    """RMS of what is left of ``truth`` (n,) by the best multiple of ``force`` (n,), over the peak of ``truth``."""
    factor = force @ truth / (force @ force)
    return float(np.sqrt(np.mean((factor * force - truth) ** 2)) / truth.max())


def errors(press: Press) -> dict[float, tuple[float, float]]:
    """For each exponent the force error, and that of the power itself, without the start that makes it finite."""
    depth, paper = pressed(press)
    truth, full = true_force(press.truth, depth / RADIUS), press.material.full_force
    return {
        m: (
            force_error(with_exponent(press.material, paper, m), truth),
            force_error(full * (paper / full) ** m, truth),
        )
        for m in EXPONENTS
    }


def main() -> None:
    """Print the table."""
    print(f"RMS force error over the peak, a ball of {RADIUS:g} voxels {DEEP:g} R deep (in brackets: the bare power)")
    print(f"{'':22}{'truth':>12}" + "".join(f"{f'm = {m:g}':>18}" for m in EXPONENTS))
    for press in PRESSES:
        cells = "".join(f"{f'{100 * a:.1f} % ({100 * b:.1f} %)':>18}" for a, b in errors(press).values())
        print(f"{press.name:22}{press.truth:>12}{cells}")


if __name__ == "__main__":
    main()
