# SPDX-License-Identifier: GPL-3.0-or-later
"""How a solid yields (solid.py), compiled: its strength, and the return of a trial stress to it."""

from __future__ import annotations

from numba import njit

LOCKING_POWER = 10


@njit(cache=True)
def hardened(strain, yield_stress, hardening, locking_strain):
    """Strength after a plastic strain, and how it rises with more of it."""
    share = strain / locking_strain
    locked = yield_stress * share**LOCKING_POWER
    rise = LOCKING_POWER * locked / strain if strain > 0.0 else 0.0
    return yield_stress + hardening * strain + locked, hardening + rise


@njit(cache=True)
def returned(p, q, strength, bulk, shear, hardening, alpha):
    """What is left of a trial mean stress ``p`` and von Mises stress ``q``, and the plastic strain that it takes.

    Factors of deviator and of mean stress, and de; ``hardening`` is how fast the strength rises. With x = de / sigma
    the flow rule gives q = q' / (1 + 3 G A x), p = p' / (1 + K alpha^2 A x) and sigma = Y / (1 - H x): one equation for
    x, linear in von Mises' case.
    """
    a = 1.0 / (1.0 + (alpha / 3.0) ** 2)
    if a * (q * q + (alpha * p) ** 2) <= strength * strength:
        return 1.0, 1.0, 0.0
    if alpha == 0.0:
        x = (q - strength) / (3.0 * shear * strength + hardening * q)
    else:
        x = _foam_multiplier(p, q, strength, bulk, shear, hardening, alpha)
    return (
        1.0 / (1.0 + 3.0 * shear * a * x),
        1.0 / (1.0 + bulk * alpha * alpha * a * x),
        x * strength / (1.0 - hardening * x),
    )


@njit(cache=True)
def _foam_multiplier(p, q, strength, bulk, shear, hardening, alpha):
    """x by Newton's method from 0; the function is convex and falls, so it comes from one side."""
    a = 1.0 / (1.0 + (alpha / 3.0) ** 2)
    of_deviator, of_mean = 3.0 * shear * a, bulk * alpha * alpha * a
    x = 0.0
    for _ in range(50):
        softer_q, softer_p, harder = 1.0 + of_deviator * x, 1.0 + of_mean * x, 1.0 - hardening * x
        deviator, mean, grown = a * (q / softer_q) ** 2, a * (alpha * p / softer_p) ** 2, (strength / harder) ** 2
        slope = -2.0 * (deviator * of_deviator / softer_q + mean * of_mean / softer_p + grown * hardening / harder)
        step = -(deviator + mean - grown) / slope
        x += step
        if abs(step) <= 1e-12 * x:
            break
    return x
