# SPDX-License-Identifier: GPL-3.0-or-later
"""How warm the motors are, told by the currents they had, and how much current that leaves them (I^2 t).

A winding warms and cools with one time constant: heat h in A^2 follows dh/dt = (I^2 - h) / winding_time. At a steady
current h is its square, so the motor's continuous rating is h = continuous_current^2. For a maxon RE25 the winding's
constant is 12 s and the housing's 612 s (constants of mahilab/Phantom): the slow one is left out, on the safe side.
"""

from __future__ import annotations

from math import exp

from .limits import Limits, Triple


def warmed(heat: Triple, currents: Triple, dt: float, limits: Limits) -> Triple:
    """The heat (A^2) of each motor after ``dt`` seconds at ``currents`` (A)."""
    share = 1.0 - exp(-dt / limits.winding_time)
    a, b, c = heat
    i, j, k = currents
    return a + (i * i - a) * share, b + (j * j - b) * share, c + (k * k - c) * share


def allowed_current(heat: float, limits: Limits) -> float:
    """Amperes that a motor may have: its peak when cold, falling to its continuous current, where it gets no warmer;
    and never more than its firmware takes."""
    continuous = limits.continuous_current
    share = min(heat / (continuous * continuous), 1.0)
    return min(limits.max_current + (continuous - limits.max_current) * share, limits.firmware_current)


def bearable_share(current: float, heat: float, limits: Limits) -> float:
    """How much of a ``current`` (A) a motor so warm may have, at most 1."""
    allowed = allowed_current(heat, limits)
    return allowed / abs(current) if abs(current) > allowed else 1.0


def warmth(heat: Triple, limits: Limits) -> float:
    """0 to 1, of the warmest motor; 1 is as warm as its continuous current makes it."""
    return min(max(heat) / (limits.continuous_current * limits.continuous_current), 1.0)
