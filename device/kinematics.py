# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the arm's tip is, and what its motors must do for a force there. Pure, of plain tuples, for a loop at 1 kHz.

All arms here are of one kind (Haptikfabriken's WoodenHaptics; a PHANToM is the same with other numbers): body A turns
about the vertical, and on it two bodies B and C move in one plane. Both are driven from the base, through a parallel
linkage, so their angles are absolute: tB is B's from straight up, tC is C's from hanging down, and tA is zero towards
the user. Angles are in radians, positions in metres in the device's frame (x to the user, y right, z up, from the
profile's origin), forces in newtons, torques in N m, currents in amperes.

Source of the equations: src/kinematics.cpp in the repository forsslund/haptikfabrikenapi. In the words of
cpp/src/PhantomModel.cpp in mahilab/Phantom, q1 = tA, q2 = pi/2 - tB and q3 = tC.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import acos, atan2, cos, hypot, pi, sin
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .profile import DeviceProfile

Triple = tuple[float, float, float]
Rows = tuple[Triple, Triple, Triple]


def joint_angles(profile: DeviceProfile, counts: Sequence[float]) -> Triple:
    """Body angles (tA, tB, tC) of encoder counts, which are those since the zero of ``profile.home_counts``."""
    ka, kb, kc = profile.radians_per_count
    oa, ob, oc = profile.angle_offset
    a, b, c = counts
    return ka * a + oa, kb * b + ob, kc * c + oc


def counts_of(profile: DeviceProfile, angles: Triple) -> Triple:
    """The inverse of joint_angles, not rounded."""
    ka, kb, kc = profile.radians_per_count
    oa, ob, oc = profile.angle_offset
    a, b, c = angles
    return (a - oa) / ka, (b - ob) / kb, (c - oc) / kc


def position(profile: DeviceProfile, angles: Triple) -> Triple:
    """Where the tip is, in metres."""
    base, upper, fore = profile.lengths
    ox, oy, oz = profile.origin
    a, b, c = angles
    reach = upper * sin(b) + fore * sin(c)
    return cos(a) * reach - ox, sin(a) * reach - oy, base + upper * cos(b) - fore * cos(c) - oz


def elbow_difference(angles: Triple) -> float:
    """What ``profile.difference_limits`` bounds: the PHANToM's q2 - q3, zero where the bodies are at right angles."""
    return 0.5 * pi - angles[1] - angles[2]


def beyond_limits(profile: DeviceProfile, angles: Triple) -> float:
    """By how many radians the worst joint, or the elbow between two, is outside of its limits; negative inside."""
    a, b, c = angles
    (a0, a1), (b0, b1), (c0, c1) = profile.joint_limits
    d0, d1 = profile.difference_limits
    d = 0.5 * pi - b - c
    return max(a0 - a, a - a1, b0 - b, b - b1, c0 - c, c - c1, d0 - d, d - d1)


def angles_of(profile: DeviceProfile, point: Triple) -> Triple:
    """The inverse of position, with the elbow above the line from shoulder to tip and the tip in front of the axis.

    tA and tB are within half a turn of zero. ValueError for a point that no pose of the arm brings the tip to, whatever
    its limits.
    """
    base, upper, fore = profile.lengths
    ox, oy, oz = profile.origin
    x, y, height = point[0] + ox, point[1] + oy, point[2] + oz - base
    reach = hypot(x, y)
    fold = (upper * upper + fore * fore - reach * reach - height * height) / (2.0 * upper * fore)
    if not abs(fold) <= 1.0:  # written so that NaN fails too
        raise ValueError(f"the arm cannot reach ({point[0]:g}, {point[1]:g}, {point[2]:g}) m")
    elbow = acos(fold)  # tB + tC
    along, across = upper - fore * fold, fore * sin(elbow)
    b = atan2(along * reach - across * height, across * reach + along * height)
    return atan2(y, x), b, elbow - b


def jacobian(profile: DeviceProfile, angles: Triple) -> Rows:
    """d position / d angles in m/rad: a row for each of x, y, z."""
    _, upper, fore = profile.lengths
    a, b, c = angles
    sin_a, cos_a, sin_b, cos_b, sin_c, cos_c = sin(a), cos(a), sin(b), cos(b), sin(c), cos(c)
    reach = upper * sin_b + fore * sin_c
    return (
        (-sin_a * reach, upper * cos_a * cos_b, fore * cos_a * cos_c),
        (cos_a * reach, upper * sin_a * cos_b, fore * sin_a * cos_c),
        (0.0, -upper * sin_b, fore * sin_c),
    )


def joint_torques(profile: DeviceProfile, angles: Triple, force: Triple) -> Triple:
    """The torques at the bodies that hold a force at the tip, J^T f, in N m."""
    _, upper, fore = profile.lengths
    a, b, c = angles
    fx, fy, fz = force
    sin_a, cos_a, sin_b, sin_c = sin(a), cos(a), sin(b), sin(c)
    forward = cos_a * fx + sin_a * fy
    return (
        (upper * sin_b + fore * sin_c) * (cos_a * fy - sin_a * fx),
        upper * (cos(b) * forward - sin_b * fz),
        fore * (cos(c) * forward + sin_c * fz),
    )


def currents(profile: DeviceProfile, angles: Triple, force: Triple) -> Triple:
    """Amperes for each motor to give a force at the tip, whatever the limits: safety.py knows those."""
    a, b, c = joint_torques(profile, angles, force)
    ia, ib, ic = profile.amperes_per_torque
    return ia * a, ib * b, ic * c


def motor_torques(profile: DeviceProfile, amperes: Triple) -> Triple:
    """The torques at the bodies that motor currents give, in N m: the inverse of the last step of currents."""
    a, b, c = amperes
    ia, ib, ic = profile.amperes_per_torque
    return a / ia, b / ib, c / ic
