# SPDX-License-Identifier: GPL-3.0-or-later
"""How an arm moves under its motors, its friction and a hand: rigid-body dynamics, for an arm in software.

The equations are Lagrange's for the mass matrix of profile.EmulatedPlant, with a hand's mass at the tip. Angles tA, tB,
tC are those of kinematics.py. Nothing here knows of reports, encoders or firmware. Plain floats, for a step each
millisecond must cost little beside whatever drives the arm.
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, cos, sin

from . import kinematics
from .profile import DeviceProfile

Triple = tuple[float, float, float]
Masses = tuple[float, float, float, float]
"""M_aa, M_bb, M_cc and M_bc in kg m^2; the rest of the matrix is zero."""
Pull = Callable[[float], tuple[Triple, Triple]]
"""Where a hand wants the tip at a time (s), and how fast that point moves: m and m/s."""

LONGEST_STEP = 5e-4
"""Seconds that are integrated at once. A firm hand on a light arm swings in 60 ms; the error of the motion goes with
the square of this (tests/device/test_plant.py)."""
STOP_STIFFNESS, STOP_DAMPING = 30.0, 0.1
"""N m/rad and N m s/rad of the mechanical stops at the ends of the joints: 10 N at the tip give less than 5 degrees."""

_ZERO: Triple = (0.0, 0.0, 0.0)


class Plant:
    """The arm's mechanics: `angles` (rad), `rates` (rad/s) and the `friction` torques (N m) of the last step.

    Parameters
    ----------
    profile
        Of an arm that can be emulated. Raises ValueError for any other.
    mass, damping, stiffness
        Of a hand at the tip, in kg, N s/m and N/m.
    """

    def __init__(self, profile: DeviceProfile, mass: float = 0.0, damping: float = 0.0, stiffness: float = 0.0) -> None:
        plant = profile.emulated
        if plant is None:
            raise ValueError(f"{profile.name}: its masses and friction are not known, so it cannot be emulated")
        _, upper, fore = profile.lengths
        ra, rb, rc = (plant.rotor_inertia * turns * turns for turns in profile.transmission)
        self.profile = profile
        self.angles: Triple = kinematics.joint_angles(profile, profile.home_counts)
        self.rates: Triple = _ZERO
        self.friction: Triple = _ZERO
        self.hand_force: Triple = _ZERO
        """Of the hand on the tip, in N: at the middle of the last step."""
        self._grip = (damping, stiffness)
        self._viscous, self._coulomb, self._gravity = plant.viscous, plant.coulomb, plant.gravity
        self._inertia = (
            plant.base_inertia + ra,
            plant.yaw_inertia[0] + mass * upper * upper,
            plant.yaw_inertia[1] + mass * fore * fore,
            plant.coupling + mass * upper * fore,
            plant.link_inertia[0] + mass * upper * upper + rb,
            plant.link_inertia[1] + mass * fore * fore + rc,
        )

    def position(self) -> Triple:
        """Of the tip, in metres."""
        return kinematics.position(self.profile, self.angles)

    def velocity(self) -> Triple:
        """Of the tip, in m/s."""
        a, b, c = self.rates
        (xa, xb, xc), (ya, yb, yc), (za, zb, zc) = kinematics.jacobian(self.profile, self.angles)
        return xa * a + xb * b + xc * c, ya * a + yb * b + yc * c, za * a + zb * b + zc * c

    def masses(self) -> Masses:
        """The mass matrix, the hand's mass and the motors included."""
        base, yaw_b, yaw_c, coupling, link_b, link_c = self._inertia
        _, b, c = self.angles
        sin_b, sin_c = sin(b), sin(c)
        yaw = base + yaw_b * sin_b * sin_b + yaw_c * sin_c * sin_c + 2.0 * coupling * sin_b * sin_c
        return yaw, link_b, link_c, coupling * cos(b + c)

    def kinetic_energy(self) -> float:
        """In joules."""
        aa, bb, cc, bc = self.masses()
        a, b, c = self.rates
        return 0.5 * (aa * a * a + bb * b * b + cc * c * c) + bc * b * c

    def step(self, dt: float, torques: Triple, pull: Pull | None = None, time: float = 0.0) -> None:
        """Move on by `dt` seconds from `time` under the motors' `torques` at the bodies (N m), held meanwhile, and a
        hand that pulls.
        """
        pieces = max(1, ceil(dt / LONGEST_STEP - 1e-9))
        piece = dt / pieces
        for number in range(pieces):
            wanted = pull(time + (number + 0.5) * piece) if pull else None
            self._piece(piece, torques, wanted)

    def _piece(self, dt: float, torques: Triple, wanted: tuple[Triple, Triple] | None) -> None:
        """A step of the midpoint rule. Friction is found at its end, so that what should stick is at rest exactly; the
        angles move by the mean of both ends' rates, so what sticks does not creep."""
        a, b, c = self.angles
        ra, rb, rc = self.rates
        half = 0.5 * dt
        (la, lb, lc), _ = self._accelerations(self.angles, self.rates, torques, wanted)
        middle = (a + half * ra, b + half * rb, c + half * rc)
        halfway = (ra + half * la, rb + half * lb, rc + half * lc)
        (la, lb, lc), masses = self._accelerations(middle, halfway, torques, wanted)
        free = (ra + dt * la, rb + dt * lb, rc + dt * lc)
        self.friction, (na, nb, nc) = rubbed(dt, free, masses, self._coulomb)
        self.rates = (na, nb, nc)
        self.angles = (a + half * (ra + na), b + half * (rb + nb), c + half * (rc + nc))

    def _accelerations(
        self, angles: Triple, rates: Triple, torques: Triple, wanted: tuple[Triple, Triple] | None
    ) -> tuple[Triple, Masses]:
        """Those of the joints (rad/s^2) under these torques, friction, gravity, hand and stops; and the masses."""
        base, yaw_b, yaw_c, coupling, bb, cc = self._inertia
        _, b, c = angles
        ra, rb, rc = rates
        ta, tb, tc = torques
        va, vb, vc = self._viscous
        gb, gc = self._gravity
        sin_b, cos_b, sin_c, cos_c = sin(b), cos(b), sin(c), cos(c)
        if wanted:
            ha, hb, hc = self._pulled(angles, rates, wanted)
            ta, tb, tc = ta + ha, tb + hb, tc + hc
        if kinematics.beyond_limits(self.profile, angles) > 0.0:
            sa, sb, sc = self._stopped(angles, rates)
            ta, tb, tc = ta + sa, tb + sb, tc + sc
        # Half of what M_aa changes by with tB and tC: it slows the turn, and throws B and C outward.
        by_b = cos_b * (yaw_b * sin_b + coupling * sin_c)
        by_c = cos_c * (yaw_c * sin_c + coupling * sin_b)
        aa = base + yaw_b * sin_b * sin_b + yaw_c * sin_c * sin_c + 2.0 * coupling * sin_b * sin_c
        bc, turned = coupling * cos(b + c), coupling * sin(b + c)
        ta -= va * ra + 2.0 * ra * (by_b * rb + by_c * rc)
        tb += gb * sin_b - vb * rb + ra * ra * by_b + turned * rc * rc
        tc -= gc * sin_c + vc * rc - ra * ra * by_c - turned * rb * rb
        share = 1.0 / (bb * cc - bc * bc)
        return (ta / aa, (cc * tb - bc * tc) * share, (bb * tc - bc * tb) * share), (aa, bb, cc, bc)

    def _pulled(self, angles: Triple, rates: Triple, wanted: tuple[Triple, Triple]) -> Triple:
        """The torques of the hand: its spring and damper act between the tip and the point that it wants."""
        ground, upper, fore = self.profile.lengths
        ox, oy, oz = self.profile.origin
        damping, stiffness = self._grip
        (px, py, pz), (vx, vy, vz) = wanted
        a, b, c = angles
        ra, rb, rc = rates
        sin_a, cos_a, sin_b, cos_b, sin_c, cos_c = sin(a), cos(a), sin(b), cos(b), sin(c), cos(c)
        reach, height = upper * sin_b + fore * sin_c, ground + upper * cos_b - fore * cos_c
        around, outward = reach * ra, upper * cos_b * rb + fore * cos_c * rc
        upward = fore * sin_c * rc - upper * sin_b * rb
        fx = stiffness * (px + ox - cos_a * reach) + damping * (vx - cos_a * outward + sin_a * around)
        fy = stiffness * (py + oy - sin_a * reach) + damping * (vy - sin_a * outward - cos_a * around)
        fz = stiffness * (pz + oz - height) + damping * (vz - upward)
        self.hand_force = (fx, fy, fz)
        forward = cos_a * fx + sin_a * fy
        return (
            reach * (cos_a * fy - sin_a * fx),
            upper * (cos_b * forward - sin_b * fz),
            fore * (cos_c * forward + sin_c * fz),
        )

    def _stopped(self, angles: Triple, rates: Triple) -> Triple:
        """The torques of the mechanical stops."""
        a, b, c = angles
        ra, rb, rc = rates
        limits = self.profile.joint_limits
        elbow = _stop(kinematics.elbow_difference(angles), -rb - rc, self.profile.difference_limits)
        return _stop(a, ra, limits[0]), _stop(b, rb, limits[1]) - elbow, _stop(c, rc, limits[2]) - elbow


def rubbed(dt: float, free: Triple, masses: Masses, limits: Triple) -> tuple[Triple, Triple]:
    """Coulomb friction over a step that would end with the rates `free` without it, and the rates with it.

    Each joint's friction (N m) is what stops it, or else its limit against its motion: the discrete form of Coulomb's
    law, exact for the two joints that are coupled.
    """
    aa, bb, cc, bc = masses
    la, lb, lc = limits
    ra, rb, rc = free
    fa = _clamped(-aa * ra / dt, la)
    fb, fc = -(bb * rb + bc * rc) / dt, -(bc * rb + cc * rc) / dt
    share = dt / (bb * cc - bc * bc)
    if not (-lb <= fb <= lb and -lc <= fc <= lc):
        fb, fc = _sliding_pair((rb, rc), (share * cc, share * bb, -share * bc), (lb, lc))
    return (fa, fb, fc), (
        _left(ra + dt * fa / aa, fa, la),
        _left(rb + share * (cc * fb - bc * fc), fb, lb),
        _left(rc + share * (bb * fc - bc * fb), fc, lc),
    )


def _sliding_pair(free: tuple[float, float], moved: Triple, limits: tuple[float, float]) -> tuple[float, float]:
    """The friction of two coupled joints of which one slides at least; `moved`: what 1 N m at b moves b, at c moves c,
    and at one moves the other.

    Which of them slides, and to which side, is what agrees with itself; the likeliest is tried first.
    """
    rb, rc = free
    bb, cc, bc = moved
    lb, lc = limits
    for fb in (-lb, lb) if rb > 0.0 else (lb, -lb):
        fc = _clamped(-(rc + bc * fb) / cc, lc)
        if (rb + bb * fb + bc * fc) * fb <= 0.0:
            return fb, fc
    for fc in (-lc, lc) if rc > 0.0 else (lc, -lc):
        fb = _clamped(-(rb + bc * fc) / bb, lb)
        if (rc + bc * fb + cc * fc) * fc <= 0.0:
            return fb, fc
    return fb, fc  # never but for rounding


def _left(rate: float, friction: float, limit: float) -> float:
    """A rate, or none where friction has stopped it: with what rounding leaves it would creep."""
    return rate if abs(friction) >= limit and rate * friction <= 0.0 else 0.0


def _clamped(value: float, limit: float) -> float:
    return limit if value > limit else -limit if value < -limit else value


def _stop(angle: float, rate: float, limits: tuple[float, float]) -> float:
    """The torque of a mechanical stop: it pushes back, and never holds."""
    low, high = limits
    if angle > high:
        return min(0.0, -STOP_STIFFNESS * (angle - high) - STOP_DAMPING * rate)
    if angle < low:
        return max(0.0, STOP_STIFFNESS * (low - angle) - STOP_DAMPING * rate)
    return 0.0
