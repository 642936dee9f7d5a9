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
        self._hand = (damping, stiffness)
        self._inertia = (
            plant.base_inertia + ra,
            plant.yaw_inertia[0] + mass * upper * upper,
            plant.yaw_inertia[1] + mass * fore * fore,
            plant.coupling + mass * upper * fore,
            plant.link_inertia[0] + mass * upper * upper + rb,
            plant.link_inertia[1] + mass * fore * fore + rc,
        )
        self._limits = (*profile.joint_limits, profile.difference_limits)

    def position(self) -> Triple:
        """Of the tip, in metres."""
        return kinematics.position(self.profile, self.angles)

    def velocity(self) -> Triple:
        """Of the tip, in m/s."""
        a, b, c = self.rates
        (xa, xb, xc), (ya, yb, yc), (za, zb, zc) = kinematics.jacobian(self.profile, self.angles)
        return xa * a + xb * b + xc * c, ya * a + yb * b + yc * c, za * a + zb * b + zc * c

    def mass_matrix(self) -> tuple[float, float, float, float]:
        """M_aa, M_bb, M_cc and M_bc in kg m^2, the hand's mass and the motors included; the rest is zero."""
        base, yaw_b, yaw_c, coupling, link_b, link_c = self._inertia
        _, b, c = self.angles
        sin_b, sin_c = sin(b), sin(c)
        yaw = base + yaw_b * sin_b * sin_b + yaw_c * sin_c * sin_c + 2.0 * coupling * sin_b * sin_c
        return yaw, link_b, link_c, coupling * cos(b + c)

    def kinetic_energy(self) -> float:
        """In joules."""
        aa, bb, cc, bc = self.mass_matrix()
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
        fa, fb, fc = self.friction
        la, lb, lc, *_ = self._accelerations(self.angles, self.rates, torques, wanted, (fa, fb, fc))
        middle = (a + half * ra, b + half * rb, c + half * rc)
        halfway = (ra + half * la, rb + half * lb, rc + half * lc)
        la, lb, lc, aa, bb, cc, bc = self._accelerations(middle, halfway, torques, wanted, _ZERO)
        free = (ra + dt * la, rb + dt * lb, rc + dt * lc)
        self.friction, (na, nb, nc) = self._rubbed(dt, free, aa, bb, cc, bc)
        self.rates = (na, nb, nc)
        self.angles = (a + half * (ra + na), b + half * (rb + nb), c + half * (rc + nc))

    def _accelerations(
        self,
        angles: Triple,
        rates: Triple,
        torques: Triple,
        wanted: tuple[Triple, Triple] | None,
        friction: Triple,
    ) -> tuple[float, float, float, float, float, float, float]:
        """Those of the joints (rad/s^2), then M_aa, M_bb, M_cc and M_bc."""
        base, yaw_b, yaw_c, coupling, bb, cc = self._inertia
        plant = self.profile.emulated
        assert plant is not None
        a, b, c = angles
        ra, rb, rc = rates
        va, vb, vc = plant.viscous
        gb, gc = plant.gravity
        sin_b, cos_b, sin_c, cos_c = sin(b), cos(b), sin(c), cos(c)
        ta = torques[0] + friction[0] - va * ra
        tb = torques[1] + friction[1] - vb * rb + gb * sin_b
        tc = torques[2] + friction[2] - vc * rc - gc * sin_c
        if wanted:
            (px, py, pz), (vx, vy, vz) = wanted
            ground, upper, fore = self.profile.lengths
            ox, oy, oz = self.profile.origin
            damping, stiffness = self._hand
            sin_a, cos_a = sin(a), cos(a)
            reach = upper * sin_b + fore * sin_c
            height = ground + upper * cos_b - fore * cos_c
            outward = upper * cos_b * rb + fore * cos_c * rc
            upward = fore * sin_c * rc - upper * sin_b * rb
            around = reach * ra
            fx = stiffness * (px + ox - cos_a * reach) + damping * (vx - cos_a * outward + sin_a * around)
            fy = stiffness * (py + oy - sin_a * reach) + damping * (vy - sin_a * outward - cos_a * around)
            fz = stiffness * (pz + oz - height) + damping * (vz - upward)
            self.hand_force = (fx, fy, fz)
            forward = cos_a * fx + sin_a * fy
            ta += reach * (cos_a * fy - sin_a * fx)
            tb += upper * (cos_b * forward - sin_b * fz)
            tc += fore * (cos_c * forward + sin_c * fz)
        (a0, a1), (b0, b1), (c0, c1), (d0, d1) = self._limits
        d = 1.5707963267948966 - b - c
        if not (a0 <= a <= a1 and b0 <= b <= b1 and c0 <= c <= c1 and d0 <= d <= d1):
            ta += _stop(a, ra, a0, a1)
            elbow = _stop(d, -rb - rc, d0, d1)
            tb += _stop(b, rb, b0, b1) - elbow
            tc += _stop(c, rc, c0, c1) - elbow
        aa = base + yaw_b * sin_b * sin_b + yaw_c * sin_c * sin_c + 2.0 * coupling * sin_b * sin_c
        # Half of what M_aa changes by with tB and tC: it slows the turn, and throws B and C outward.
        by_b = cos_b * (yaw_b * sin_b + coupling * sin_c)
        by_c = cos_c * (yaw_c * sin_c + coupling * sin_b)
        bc, turned = coupling * cos(b + c), coupling * sin(b + c)
        tb += ra * ra * by_b + turned * rc * rc
        tc += ra * ra * by_c + turned * rb * rb
        of_pair = 1.0 / (bb * cc - bc * bc)
        return (
            (ta - 2.0 * ra * (by_b * rb + by_c * rc)) / aa,
            (cc * tb - bc * tc) * of_pair,
            (bb * tc - bc * tb) * of_pair,
            aa,
            bb,
            cc,
            bc,
        )

    def _rubbed(self, dt: float, free: Triple, aa: float, bb: float, cc: float, bc: float) -> tuple[Triple, Triple]:
        """Coulomb friction over a step that would end with the rates `free` without it, and the rates with it.

        Each joint's friction is what stops it, or else its Coulomb torque against its motion (the discrete form of
        Coulomb's law; exact for the two joints that are coupled).
        """
        plant = self.profile.emulated
        assert plant is not None
        la, lb, lc = plant.coulomb
        ra, rb, rc = free
        fa = _clamped(-aa * ra / dt, la)
        fb, fc = -(bb * rb + bc * rc) / dt, -(bc * rb + cc * rc) / dt
        if -lb <= fb <= lb and -lc <= fc <= lc:
            return (fa, fb, fc), (ra + dt * fa / aa, 0.0, 0.0)
        step = dt / (bb * cc - bc * bc)
        wbb, wcc, wbc = cc * step, bb * step, -bc * step
        # One slides at least. Which, and to which side, is what agrees with itself; the likeliest is tried first.
        for gb in (-lb if rb > 0.0 else lb, -lb if rb <= 0.0 else lb):
            fc = _clamped(-(rc + wbc * gb) / wcc, lc)
            if (rb + wbb * gb + wbc * fc) * gb <= 0.0:
                fb = gb
                break
        else:
            for gc in (-lc if rc > 0.0 else lc, -lc if rc <= 0.0 else lc):
                fb = _clamped(-(rb + wbc * gc) / wbb, lb)
                fc = gc
                if (rc + wbc * fb + wcc * gc) * gc <= 0.0:
                    break
        rates = (ra + dt * fa / aa, rb + wbb * fb + wbc * fc, rc + wbc * fb + wcc * fc)
        # What friction has stopped is at rest, not nearly so: otherwise rounding would keep it creeping.
        return (fa, fb, fc), (
            rates[0] if abs(fa) >= la else 0.0,
            rates[1] if abs(fb) >= lb else 0.0,
            rates[2] if abs(fc) >= lc else 0.0,
        )


def _clamped(value: float, limit: float) -> float:
    return limit if value > limit else -limit if value < -limit else value


def _stop(angle: float, rate: float, low: float, high: float) -> float:
    """The torque of a mechanical stop: it pushes back, and never holds."""
    if angle > high:
        return min(0.0, -STOP_STIFFNESS * (angle - high) - STOP_DAMPING * rate)
    if angle < low:
        return max(0.0, STOP_STIFFNESS * (low - angle) - STOP_DAMPING * rate)
    return 0.0
