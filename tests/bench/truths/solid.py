# SPDX-License-Identifier: GPL-3.0-or-later
"""Solids that yield: von Mises, and the crushable foam of Deshpande and Fleck (JMPS 48, 2000, 1253-1283).

Both yield where an equivalent stress reaches the strength Y + H e + Y (e / e_D)^10, e the equivalent plastic strain:

    sigma^2 = A (q^2 + alpha^2 p^2),  A = 1 / (1 + (alpha / 3)^2)

with q von Mises' stress and p the mean stress. alpha = 0 is von Mises; alpha = 3 / sqrt 2 is foam of plastic Poisson
ratio 0, which a pull or push in one direction does not make wider or narrower. Flow is associated.

The last term locks a foam whose pores are closed: e_D = - ln d0 (as the logarithm of Reyes, Hopperstad, Berstad,
Hanssen and Langseth, EJM A 22, 2003, 815-835, does). Without it and without hardening the problem has no answer: all
that is pressed in closes up in one row of elements, however thin. Dense solids have e_D infinite.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, log, sqrt

FOAM = 3.0 / sqrt(2.0)
"""alpha of a foam with plastic Poisson ratio 0."""


@dataclass(frozen=True)
class Solid:
    """Stresses are in units of Young's modulus E. ``hardening`` is H = dY / de; ``alpha`` as above.

    ``filled`` is d0, the share of its volume that is solid at first: 1, or less for a foam.
    """

    yield_stress: float
    hardening: float = 0.0
    alpha: float = 0.0
    filled: float = 1.0
    poisson_ratio: float = 0.3

    @property
    def bulk(self) -> float:
        return 1.0 / (3.0 * (1.0 - 2.0 * self.poisson_ratio))

    @property
    def shear(self) -> float:
        return 1.0 / (2.0 * (1.0 + self.poisson_ratio))

    @property
    def locking_strain(self) -> float:
        """e_D"""
        return -log(self.filled) if self.filled < 1.0 else inf

    @property
    def constants(self) -> tuple[float, float, float, float, float, float]:
        """(K, G, Y, H, e_D, alpha) for compiled code."""
        return self.bulk, self.shear, self.yield_stress, self.hardening, self.locking_strain, self.alpha
