# SPDX-License-Identifier: GPL-3.0-or-later
"""How stiff a wall may be, in theory: the eigenvalues of the sampled loop over its period, and the rule of thumb.

In contact all is linear, so what one period of collision and loop does to a small deviation from rest is a matrix. Its
state is the deviation of place and speed, and of the last places that the collision saw. Where the collision's period
is no whole number of the loop's, the matrix is that of the first number of collisions that is.
"""

from __future__ import annotations

from math import ceil, floor

import numpy as np

from repousse.device.hand import Hand
from repousse.device.limits import PERIOD

from .arm import Mechanics, transition
from .collision import SLACK, Timing
from .couplings import Coupling

MOST_COLLISIONS = 100
"""Collisions after which a multiple of the loop's period has to be found."""
STIFFEST = 2e5
"""N/m beyond which nothing is asked."""


def rule(coupling: Coupling, damping: float, timing: Timing) -> float:
    """N/m: K < b / delay, the damping of arm and hand over the effective delay (Colgate and Schenkel's b > K T/2, with
    a delay added in full as by Diolaiti et al., IEEE T-RO 2006). Good for a light wall on a heavy hand."""
    delay = {
        Coupling.HOLD: 0.5 * timing.period + timing.latency,
        Coupling.INTERPOLATE: timing.period + 0.5 * PERIOD + timing.latency,
    }.get(coupling, 0.5 * PERIOD)
    return damping / delay


def limit(coupling: Coupling, mechanics: Mechanics, hand: Hand, timing: Timing) -> float:
    """N/m at which the spectral radius of the period's matrix passes 1, to 0.1 %; exact where nothing is late by
    chance and neither friction nor encoder steps count."""
    low, high = 1.0, STIFFEST
    if spectral_radius(high, coupling, mechanics, hand, timing) < 1.0:
        return high
    while high / low > 1.001:
        middle = (low * high) ** 0.5
        if spectral_radius(middle, coupling, mechanics, hand, timing) < 1.0:
            low = middle
        else:
            high = middle
    return low


def spectral_radius(stiffness: float, coupling: Coupling, mechanics: Mechanics, hand: Hand, timing: Timing) -> float:
    """Of what a whole number of collisions does, as the factor for one collision."""
    collisions = _until_whole(timing.period)
    matrix = _period_matrix(stiffness, coupling, mechanics, hand, timing, collisions)
    return float(np.abs(np.linalg.eigvals(matrix)).max()) ** (1.0 / collisions)


def _until_whole(period: float) -> int:
    """How many collisions take a whole number of the loop's periods."""
    for number in range(1, MOST_COLLISIONS):
        if abs(number * period / PERIOD - round(number * period / PERIOD)) < 1e-6:
            return number
    raise ValueError(f"a collision each {1e3 * period:g} ms never meets the loop's period again")


def _period_matrix(
    stiffness: float, coupling: Coupling, mechanics: Mechanics, hand: Hand, timing: Timing, collisions: int
) -> np.ndarray:
    """The state is (place, speed, place seen last, seen before that, ...), the first seen one collision ago."""
    kept = ceil(timing.latency / timing.period + SLACK) + 3
    moved = transition(mechanics.mass + hand.mass, mechanics.damping + hand.damping, hand.stiffness, PERIOD)
    size = 2 + kept
    whole = np.eye(size)
    first = 10 * collisions  # of the looks: far enough from the beginning for none to be missing
    for tick in range(round(collisions * timing.period / PERIOD)):
        now = first * timing.period + tick * PERIOD
        step = np.eye(size)
        if floor((now + PERIOD - SLACK) / timing.period) != floor((now - SLACK) / timing.period):
            step[3:, :] = np.eye(size)[2:-1, :]
            step[2, :] = np.eye(size)[0, :]
        whole = step @ whole
        step = np.eye(size)
        step[:2, :2] = moved[:, :2]
        step[:2] += np.outer(moved[:, 2], -stiffness * _felt(coupling, timing, now, size))
        whole = step @ whole
    return whole


def _felt(coupling: Coupling, timing: Timing, now: float, size: int) -> np.ndarray:
    """(size,): of which of the state's places the force is made at a time, each with its share."""
    shares = np.zeros(size)
    if coupling in (Coupling.LOCAL, Coupling.IN_LOOP):
        shares[0] = 1.0  # the tangent of a wall is the wall
        return shares
    newest = ceil((now + PERIOD - SLACK) / timing.period) - 1  # number of the last look
    arrived = floor((now - timing.latency + SLACK) / timing.period)  # and of the last that is known of
    behind = newest - arrived
    share = 1.0
    if coupling is Coupling.INTERPOLATE:
        came = ceil((arrived * timing.period + timing.latency) / PERIOD - SLACK / PERIOD) * PERIOD
        share = min((now - came) / timing.period, 1.0)
    shares[2 + behind], shares[3 + behind] = share, 1.0 - share
    return shares
