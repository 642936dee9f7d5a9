# SPDX-License-Identifier: GPL-3.0-or-later
"""The finite elements against what is known of indentation without them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from . import calculix
from .measures import Press
from .run import press
from .solid import FOAM, Solid
from .solver import STEPS_TIMES_SIZE

PLASTIC = (0.03, 0.08)
"""Depths between which the contact is fully plastic at E/Y = 500, and yet shallow: a/R from .28 to .45."""
ELASTIC = Solid(1e9)
DENSE, CRUSHABLE = Solid(1.0 / 500.0), Solid(1.0 / 500.0, 0.0, FOAM, filled=0.5)
HARDER = Solid(0.02, 0.02)
"""E/Y = 50, H = E/50: with less CalculiX does not converge."""


@dataclass(frozen=True)
class Check:
    """``measure()`` should be from ``low`` to ``high``."""

    what: str
    low: float
    high: float
    measure: Callable[[], float]


@cache
def _pressed(solid: Solid, size: float, depth: float, slowness: float = 1.0) -> Press:
    """As slowly as a truth is pressed, times ``slowness``."""
    return press(solid, size, (depth,), raster=False, steps=round(slowness * STEPS_TIMES_SIZE / size * depth / 0.3))


def hertz(size: float) -> float:
    """Force on an elastic half space over 4/3 E* sqrt(R) d^(3/2), E* = E / (1 - nu^2); mean over depths .01 to .02.

    What is elastic has no end to its waves, so it is pressed more slowly.
    """
    made = _pressed(ELASTIC, size, 0.02, 5.0)
    expected = 4.0 / 3.0 / (1.0 - ELASTIC.poisson_ratio**2) * made.depth**1.5
    return float((made.force / expected)[made.depth > 0.01].mean())


def pressure(solid: Solid, size: float) -> float:
    """Mean pressure over yield stress between the depths of PLASTIC."""
    made = _pressed(solid, size, PLASTIC[1])
    there = made.depth > PLASTIC[0]
    return float((made.force / (np.pi * made.contact_radius**2))[there].mean() / solid.yield_stress)


def dense_over_crushable(size: float) -> float:
    return pressure(DENSE, size) / pressure(CRUSHABLE, size)


def by_calculix(size: float = 0.04, depth: float = 0.03, penalty: float = 60.0) -> float:
    """Its force over ours at the same depth of contact: its own less the overlap that its penalty leaves."""
    theirs = calculix.force(HARDER, size, depth, penalty)
    made = _pressed(HARDER, size, depth, 3.0)
    overlap = theirs / (np.pi * made.contact_radius[-1] ** 2 * penalty)
    return float(theirs / np.interp(depth - overlap, made.depth, made.force))


def checks(size: float, elastic_size: float, within: float) -> Iterator[Check]:
    """On meshes of ``size``; Hertz, whose contact is small, on one of ``elastic_size`` and ``within`` a share."""
    yield Check("elastic force over Hertz's", 1.0 - within, 1.0 + within, partial(hertz, elastic_size))
    yield Check("E/Y = 500: mean pressure over Y, fully plastic", 2.7, 3.0, partial(pressure, DENSE, size))
    # A foam's indentation strength is only slightly above its uniaxial strength, a dense solid's about 3 times its own
    # (Ashby and others, Metal Foams: A Design Guide, 2000).
    yield Check("foam, E/Y = 500: mean pressure over Y", 1.0, 1.4, partial(pressure, CRUSHABLE, size))
    yield Check("dense over foam", 2.0, 3.0, partial(dense_over_crushable, size))


def report() -> bool:
    """Run all checks, print what each found; whether all passed."""
    passed = True
    asked = list(checks(0.02, 0.02, 0.02))
    if calculix.installed():
        asked.append(Check("E/Y = 50, H = E/50: CalculiX's force over ours", 0.98, 1.02, by_calculix))
    else:
        print("CalculiX: skipped, for there is no `ccx` here (Debian: calculix-ccx)")
    for check in asked:
        found = check.measure()
        good = check.low <= found <= check.high
        passed &= good
        verdict = "ok" if good else "MISSED"
        print(f"{check.what}: {found:.3f}, should be {check.low:g} to {check.high:g}: {verdict}", flush=True)
    return passed
