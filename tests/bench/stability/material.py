# SPDX-License-Identifier: GPL-3.0-or-later
"""The map spot-checked where it counts: the same loop over the real core, a block that yields and is pressed into.

Its steepest elastic slope is what the device can render. By an arm of one axis, and by the product's own arm in
software, in three dimensions with its friction, encoder counts and motor currents.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from repousse.device.limits import limits_of
from repousse.device.profile import builtin_profiles

from .arm import InSoftware
from .closed_loop import ClosedLoop, Trace
from .collision import Timing
from .couplings import Coupling
from .scenes import DEVICES, HANDS, MS, START, at_block, block, coming_down

PREMIUM = builtin_profiles()["phantom-premium-1.5"]
PRESS = 0.5
"""Newtons' worth of its own spring by which the hand wants to be in the material."""
SETTLED, WHOLE = 2.0, 2.5
"""Seconds, as on the map."""


class Spot(NamedTuple):
    """A press into the material: the arm by its name, milliseconds, a hand by its name, N/m of the steepest slope."""

    coupling: str
    arm: str
    collision_ms: float
    latency_ms: float
    jitter_ms: float
    hand: str
    k_asked: float


class Found(NamedTuple):
    """What became of it: as cells.Row has it; ``yielded_mm`` is how deep the material was pressed in."""

    coupling: str
    arm: str
    collision_ms: float
    latency_ms: float
    jitter_ms: float
    hand: str
    k_asked: float
    granted_share: float
    peak_to_peak_mm: float
    max_slew_n_per_ms: float
    energy_min_j: float
    yielded_mm: float

    @property
    def fails(self) -> bool:
        """Whether the default coupling lets the tip move by more than one encoder step after two seconds."""
        return self.coupling == "local" and self.peak_to_peak_mm * MS > encoder(self.arm)


def encoder(arm: str) -> float:
    """Metres of one step of an arm's encoders."""
    return next((device.mechanics.encoder for device in DEVICES if device.name == arm), 29e-6)


SPOTS = [
    Spot(coupling, device.name, period, period, 0.5 * period, hand, device.stiffness)
    for coupling, periods, devices in (
        ("local", (1.0, 10.0, 33.0), DEVICES[::2]),
        ("interpolate", (10.0,), DEVICES[2:]),
    )
    for period in periods
    for device in devices
    for hand in HANDS
] + [Spot("local", PREMIUM.key, period, period, 0.5 * period, "soft", 800.0) for period in (1.0, 10.0, 33.0)]
"""Models late by a whole period, and uneven by half of one."""


def press(spot: Spot) -> tuple[Trace, float]:
    """What a spot's press is like, and how deep (m) the material has yielded under the middle of the tool."""
    timing = Timing(spot.collision_ms * MS, spot.latency_ms * MS, spot.jitter_ms * MS)
    hand, coupling = HANDS[spot.hand], Coupling(spot.coupling)
    device = next((device for device in DEVICES if device.name == spot.arm), None)
    if device is not None:
        clay = block(device.stiffness, device.force)
        loop = at_block(device, hand, timing, coupling, world=clay, press=PRESS)
    else:
        clay = block(spot.k_asked, 3.3)
        limits = replace(limits_of(PREMIUM, PREMIUM.links[0]), max_force=3.3)
        arm = InSoftware(PREMIUM, hand, START)
        loop = ClosedLoop(arm, clay, coming_down(-PRESS / hand.stiffness), timing, coupling, limits)
    column = clay.push.grid.density.shape[0] // 2
    before = float(clay.push.grid.density[column, column].sum())
    trace = loop.run(WHOLE)
    x, y, _ = clay.push.origin
    after = float(clay.push.grid.density[column - x, column - y].sum())
    return trace, max(before - after, 0.0) / clay.mapping.voxels_per_metre


def measure(spot: Spot) -> Found:
    """A line of the table."""
    trace, yielded = press(spot)
    return Found(
        *spot,
        granted_share=trace.granted(0.0),
        peak_to_peak_mm=1e3 * trace.peak_to_peak(SETTLED),
        max_slew_n_per_ms=trace.max_slew,
        energy_min_j=trace.lowest_energy,
        yielded_mm=1e3 * yielded,
    )
