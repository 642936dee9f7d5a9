# SPDX-License-Identifier: GPL-3.0-or-later
"""The loop, closed over an arm in software and a world, without a clock: the same every time, faster than life.

What the loop does in a period is what device/loop.py does, by the product's own functions: velocity over 15 ms, the
force of the model there, safety's share of it. Only orders, reports and the shared memory between are left out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from math import hypot
from typing import NamedTuple

import numpy as np

from repousse.device import safety
from repousse.device.limits import PERIOD, Limits
from repousse.device.loop import VELOCITY_WINDOW
from repousse.device.safety import Given, Motors, Seen, State, Status

from .arm import Arm
from .collision import Collision, Timing
from .couplings import ZERO, Coupled, Coupling, Passivity
from .worlds import World

Triple = tuple[float, float, float]
Goal = Callable[[float], tuple[Triple, Triple]]
"""Where the hand wants to be at a time, and how fast it moves there: m and m/s."""


def limits_for(max_force: float, max_stiffness: float, max_damping: float, damping: float = 1.505) -> Limits:
    """Limits of an arm of which only these are known; the others never bind here."""
    wide = (-10.0, 10.0)
    return Limits(
        max_force=max_force,
        force_scale=1.0,
        reason="",
        max_stiffness=max_stiffness,
        max_damping=max_damping,
        max_velocity=1.0,
        max_slew=1e3 * max_stiffness * 0.5e-3,  # as the profiles: the stiffest wall at half the highest speed
        damping=damping,
        period=PERIOD,
        max_current=10.0,
        continuous_current=10.0,
        firmware_current=10.0,
        steady_current=10.0,
        winding_time=12.0,
        joint_limits=(wide, wide, wide),
        elbow_limits=wide,
        max_count_rate=(1e9, 1e9, 1e9),
    )


GUARD_DAMPING = 70.0
"""N s/m, at most, of a passivity controller: half of m/T, from which on damping by the last period's motion shakes an
arm of 45 g in a hand of 0.1 kg."""


class Moment(NamedTuple):
    """One period: s, where the tip is (m), the force given (N), slopes asked and granted (N/m), the energy (J) that the
    hand has put in so far, and the age of what was felt (s)."""

    time: float
    place: Triple
    force: Triple
    asked: float
    granted: float
    energy: float
    age: float


@dataclass
class Trace:
    """All periods of a run."""

    moments: list[Moment] = field(default_factory=list)

    @property
    def time(self) -> np.ndarray:
        """(n,) s."""
        return np.array([moment.time for moment in self.moments])

    @property
    def height(self) -> np.ndarray:
        """(n,) m: the last coordinate of the tip."""
        return np.array([moment.place[2] for moment in self.moments])

    @property
    def force(self) -> np.ndarray:
        """(n, 3) N."""
        return np.array([moment.force for moment in self.moments])

    def peak_to_peak(self, since: float) -> float:
        """Metres that the tip still moves from then on: the largest side of the box around its path."""
        path = np.array([moment.place for moment in self.moments if moment.time >= since])
        return float(np.ptp(path, axis=0).max())

    @property
    def max_slew(self) -> float:
        """The greatest change of force from one period to the next, N/ms."""
        return float(np.linalg.norm(np.diff(self.force, axis=0), axis=1).max()) * 1e-3 / PERIOD

    @property
    def lowest_energy(self) -> float:
        """J; below 0 the hand has got back more than it had put in."""
        return min(moment.energy for moment in self.moments)

    def granted(self, since: float) -> float:
        """The least share of the slope that was granted from then on; 1 where none was asked for."""
        shares = [m.granted / m.asked for m in self.moments if m.time >= since and m.asked > 0.0]
        return min(shares, default=1.0)


class ClosedLoop:
    """One run, period by period.

    Parameters
    ----------
    arm, world, goal
        What is held, what is touched, and what the hand wants.
    timing
        The collision's.
    coupling, guarded
        Which, and whether a passivity observer and controller watches the port.
    limits
        The arm's.
    coupled
        What the coupling is made by, for who wants another.
    """

    def __init__(
        self,
        arm: Arm,
        world: World,
        goal: Goal,
        timing: Timing,
        coupling: Coupling,
        limits: Limits,
        guarded: bool = False,
        coupled: type[Coupled] = Coupled,
    ) -> None:
        self.arm, self.world, self.goal, self.limits = arm, world, goal, limits
        self.trace = Trace()
        self._coupled = coupled(coupling, limits, world.feel)
        self._collision = Collision(timing, lambda now: world.collide(self._seen, now))
        self._guard = Passivity(arm.seen, GUARD_DAMPING) if guarded else None
        self._seen = arm.seen
        self._path: deque[tuple[float, Triple]] = deque()
        self._status = Status(State.RUN, given=Given(ZERO, 1.0, 1, 1.0), motors=Motors())
        self._periods = 0
        self._energy = 0.0

    def know(self, times: tuple[float, ...]) -> None:
        """Let what is felt at the tip have been known from before the first period, by models made at these ``times``
        (s, below 0): else there is no force until the first one comes."""
        for time in times:
            self._coupled.take(self.world.feel(self._seen, time), time)

    def run(self, seconds: float) -> Trace:
        """Go on for so long; returns all that was so far."""
        for _ in range(round(seconds / PERIOD)):
            self._period(self._periods * PERIOD)
            self._periods += 1
        return self.trace

    def _period(self, now: float) -> None:
        self._seen = seen = self.arm.seen
        velocity = self._velocity(now)
        for model in self._collision.due(now):
            self._coupled.take(model, now)
        force = self._given(seen, velocity, now)
        x, y, z = self.arm.place
        self.arm.step(force, *self.goal(now))
        (u, v, w), (a, b, c) = self.arm.place, force
        self._energy -= a * (u - x) + b * (v - y) + c * (w - z)

    def _given(self, seen: Triple, velocity: Triple, now: float) -> Triple:
        """The force of this period, after safety and guard; into the trace."""
        felt = self._coupled.felt(seen, velocity, now)
        model = self._coupled.model
        time, scene = (model.time, model.scene) if model is not None else (now, 1)
        state, fault, _, given, motors = self._status
        status = Status(state, fault, Seen(now, now, ZERO, hypot(*velocity)), given, motors)
        self._status = safety.rendered(status, self.limits, now, PERIOD, time, scene, felt.force, felt.magnitude)
        force = self._status.force
        if self._guard is not None:
            force = self._guard.controlled(force, seen)
        self.trace.moments.append(
            Moment(now, self.arm.place, force, felt.asked, felt.granted, self._energy, now - time)
        )
        return force

    def _velocity(self, now: float) -> Triple:
        """Over 15 ms, as device/loop.py finds it."""
        path = self._path
        path.append((now, self._seen))
        while len(path) > 2 and path[1][0] <= now - VELOCITY_WINDOW:
            path.popleft()
        then, (x, y, z) = path[0]
        way, (u, v, w) = now - then, self._seen
        return ((u - x) / way, (v - y) / way, (w - z) / way) if way > 0.0 else ZERO
