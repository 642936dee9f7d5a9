# SPDX-License-Identifier: GPL-3.0-or-later
"""Every limit that holds for one arm behind one link, as numbers that are ready for the loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .profile import DeviceProfile, Link

Triple = tuple[float, float, float]
Range = tuple[float, float]

SLOWEST_WATCHDOG = 100.0
"""Milliseconds after which an arm has to let go by itself when the loop has died, to be trusted with all its force."""
SLOW_WATCHDOG_SHARE = 0.25
"""Of its force, to an arm that takes longer."""
FIRMWARE_SHARE = 0.95
"""Of the current at which the firmware would let go: some set the current to zero above it instead of to the limit."""
JOINT_MARGIN = 0.1
"""Radians beyond a joint's stop that may be read: a hand homes an arm to a few degrees."""
JUMP_SHARE = 3.0
"""How many times as fast as the profile's velocity limit an encoder may turn before it counts as a jump: far from the
velocity limit itself, which says what is wrong better."""
PERIOD = 1e-3
"""Seconds from one force to the next."""
LOCK_STEP_PERIOD = 2e-3
"""The same where each report has to be answered before the arm sends another: at full speed USB one each way a
millisecond."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What one arm may do, from its profile, its link and what the user asked for.

    ``max_force`` N, with ``force_scale`` (0 to 1) and a slow firmware's share in it, ``reason`` for the latter in one
    line or ""; ``max_stiffness`` N/m, ``max_damping`` N s/m, ``max_velocity`` m/s, ``max_slew`` N/s; ``damping`` N s/m
    of device and hand, which hold the loop stable; ``period`` s; ``max_current``, ``continuous_current`` and
    ``firmware_current`` A (what the firmware takes, with its margin), ``steady_current`` A that is always fine;
    ``winding_time`` s; ``joint_limits`` and
    ``elbow_limits`` (of pi/2 - tB - tC) rad, their margin included; ``max_count_rate`` counts/s for each encoder.
    """

    max_force: float
    force_scale: float
    reason: str
    max_stiffness: float
    max_damping: float
    max_velocity: float
    max_slew: float
    damping: float
    period: float
    max_current: float
    continuous_current: float
    firmware_current: float
    steady_current: float
    winding_time: float
    joint_limits: tuple[Range, Range, Range]
    elbow_limits: Range
    max_count_rate: Triple


def limits_of(profile: DeviceProfile, link: Link, force_scale: float = 1.0) -> Limits:
    """The limits of an arm; a scale that is no number from 0 to 1 is brought there, NaN to 0."""
    scale = min(force_scale, 1.0) if force_scale > 0.0 else 0.0
    share, reason = 1.0, ""
    if not 0.0 < link.firmware_watchdog_ms <= SLOWEST_WATCHDOG:
        share = SLOW_WATCHDOG_SHARE
        reason = (
            f"Force is held to {profile.max_force * share:.3g} N, a quarter: if the loop died, its firmware would "
            f"go on pushing for {link.firmware_watchdog_ms:.0f} ms, and {SLOWEST_WATCHDOG:.0f} is as long as is safe"
        )
    continuous = min(profile.continuous_current, profile.max_current)
    firmware = FIRMWARE_SHARE * link.firmware_current_limit
    a, b, c = (_wider(limits) for limits in profile.joint_limits)
    return Limits(
        max_force=profile.max_force * scale * share,
        force_scale=scale,
        reason=reason,
        max_stiffness=profile.max_stiffness,
        max_damping=profile.max_damping,
        max_velocity=profile.max_velocity,
        max_slew=profile.max_slew * 1e3,
        damping=profile.device_damping + profile.hand_damping,
        period=LOCK_STEP_PERIOD if link.lock_step else PERIOD,
        max_current=profile.max_current,
        continuous_current=continuous,
        firmware_current=firmware,
        steady_current=min(continuous, firmware),
        winding_time=profile.winding_time,
        joint_limits=(a, b, c),
        elbow_limits=_wider(profile.difference_limits),
        max_count_rate=_count_rates(profile),
    )


def _wider(limits: Range) -> Range:
    return limits[0] - JOINT_MARGIN, limits[1] + JOINT_MARGIN


def _count_rates(profile: DeviceProfile) -> Triple:
    """Counts/s at :data:`JUMP_SHARE` times the velocity limit. Body A has no lever of its own, for it gets shorter the
    nearer the tip is to the axis: half the shorter of the other two stands for it."""
    _, upper, fore = profile.lengths
    levers = 0.5 * min(upper, fore), upper, fore
    a, b, c = (
        JUMP_SHARE * profile.max_velocity / (lever * abs(step))
        for lever, step in zip(levers, profile.radians_per_count, strict=True)
    )
    return a, b, c
