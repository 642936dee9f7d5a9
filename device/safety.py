# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands between a model of clay and a person's hand: a state machine, and every limit on the way to the motors.

Pure functions of a :class:`Status` and of time. Each period the loop calls, in this order, :func:`sensed` (may the arm
be trusted), :func:`rendered` (which of the force that was felt is given) and :func:`limited_currents` (what the motors
can bear); :func:`opened`, :func:`homed`, :func:`armed`, :func:`disarmed` and :func:`failed` are events between them.

- Nothing but RUN gives force. Only :func:`rendered` leads there, only from ARMED, and only while the force is small.
- Nothing but :func:`armed` leads from HOMED to ARMED, nothing but :func:`homed` out of OPEN and SAFE. From RUN back to
  ARMED, to the small-force gate and the ramp, lead a change of scene, a stale model and a stalled loop.
- What makes a force smaller happens at once, what makes it greater takes its time: its ramp and its slew.
"""

from __future__ import annotations

from itertools import repeat
from math import hypot, isfinite
from typing import NamedTuple

from . import heat
from .fault import NOTICES, Fault, State, fault_text, state_text
from .kinematics import elbow_difference
from .limits import Limits, Triple, limits_of

__all__ = [
    "Fault",
    "Limits",
    "State",
    "Status",
    "armed",
    "disarmed",
    "failed",
    "fault_text",
    "homed",
    "limited_currents",
    "limits_of",
    "opened",
    "rendered",
    "sensed",
    "state_text",
    "warmth",
]

SMALL_FORCE = 0.2
"""Newtons below which a force may engage: so CHAI3D's cGenericTool waits for one before it gives any."""
RAMP_TIME = 1.5
"""Seconds in which an engagement gets to its full force."""
FADE_FROM, FADE_TO = 0.09, 0.1
"""Seconds of a model's age at which the force begins to fade, and is gone. Ages that come round with every model are
below: a collision each 33 ms, late by as much and at times by half a period more, makes models of 82 ms, and a force
that fades and comes back with each of them would shake the hand (tests/bench/STABILITY.md)."""
STALE_SENSOR = 0.02
"""Seconds without a report after which nobody knows where the arm is."""
ANSWER_TIME = 1.0
"""Seconds in which an arm that was just opened has to send its first report."""
LONGEST_STALL = STALE_SENSOR
"""Seconds for which the loop may have stood still and go on giving force: meanwhile it saw no report either."""
LONGEST_GAP = 0.25
"""Seconds of standstill after which a 16-bit encoder counter may have wrapped unseen."""
EARLY = 0.005
"""Seconds by which what is read during a period may be newer than its beginning."""
HOMING_SPEED = 0.1
"""Metres per second at which an arm is not held still any more."""
FADED_SPEED = 2.0
"""Times the velocity limit at which the force, which fades from the limit on, is gone; faster is a fault."""
JITTER = 0.002
"""Seconds by which the reports of two poses may have been under way differently long."""
MOST_COUNTS = float(1 << 31)
"""Counts that no arm gets to."""

ZERO: Triple = (0.0, 0.0, 0.0)


class Seen(NamedTuple):
    """What :func:`sensed` remembers: ``time`` of its last call, ``report_time``, ``counts`` and ``speed`` (m/s) of the
    newest report; seconds."""

    time: float = 0.0
    report_time: float = 0.0
    counts: Triple = ZERO
    speed: float = 0.0


class Given(NamedTuple):
    """What :func:`rendered` remembers: the ``force`` (N) on the hand, ``ramp`` 0 to 1 of the engagement, for which
    ``scene`` and ``force_scale`` that was, and ``waiting``: there is something to be felt, but more than may engage."""

    force: Triple = ZERO
    ramp: float = 0.0
    scene: int = 0
    force_scale: float = 0.0
    waiting: bool = False


class Motors(NamedTuple):
    """What :func:`limited_currents` remembers: ``currents`` (A) that the motors have, and their ``heat`` (A^2)."""

    currents: Triple = ZERO
    heat: Triple = ZERO


NO_FORCE = Given()
WAITING = Given(waiting=True)


class Status(NamedTuple):
    """What is known of the arm from one period to the next.

    ``fault``: the reason of the last fault, or why an order was refused or the force waits; NONE when the user got on.
    """

    state: State = State.CLOSED
    fault: Fault = Fault.NONE
    seen: Seen = Seen()
    given: Given = NO_FORCE
    motors: Motors = Motors()

    @property
    def force(self) -> Triple:
        """The force (3,) on the hand in N, as it was rendered last."""
        return self.given.force

    @property
    def ramp(self) -> float:
        """0 to 1: how much of its force an engagement has reached."""
        return self.given.ramp

    @property
    def waiting(self) -> bool:
        """Armed, and there is something to be felt, but more than may engage."""
        return self.given.waiting


def _moved(status: Status, state: State, fault: Fault) -> Status:
    """Into another state, which begins without force."""
    return Status(state, fault, status.seen, NO_FORCE, Motors(ZERO, status.motors.heat))


def opened(now: float) -> Status:
    """The arm was opened: it may be read, and nothing is written to it."""
    return Status(State.OPEN, seen=Seen(now, now))


def homed(status: Status, limits: Limits, counts: Triple, angles: Triple, now: float) -> Status:
    """The user says that the arm is in its home pose; ``counts`` and ``angles`` (rad) are as they read from now on.

    Whatever was, the arm gives no force and has to be armed afterwards. Refused, with the reason as ``fault``, when it
    does not report, moves, or cannot be there: then it is not homed, whatever it was before.
    """
    if status.state is State.CLOSED:
        return status
    refused = _no_home(status, limits, counts, angles, now)
    if refused:
        return _moved(status, State.SAFE if status.state is State.SAFE else State.OPEN, refused)
    seen = Seen(now, status.seen.report_time, counts, status.seen.speed)
    return _moved(status._replace(seen=seen), State.HOMED, Fault.NONE)


def _no_home(status: Status, limits: Limits, counts: Triple, angles: Triple, now: float) -> Fault:
    """Why this cannot be a home pose."""
    if not -EARLY <= now - status.seen.report_time <= STALE_SENSOR:
        return Fault.HOME_SILENT
    if not status.seen.speed <= HOMING_SPEED:
        return Fault.HOME_MOVING
    plausible = all(abs(count) < MOST_COUNTS for count in counts)
    return Fault.NONE if plausible and _within_reach(limits, angles) else Fault.HOME_IMPLAUSIBLE


def _within_reach(limits: Limits, angles: Triple) -> bool:
    """Whether every joint is where it can be, and the elbow between two of them."""
    a, b, c = angles
    (a0, a1), (b0, b1), (c0, c1) = limits.joint_limits
    d0, d1 = limits.elbow_limits
    return a0 <= a <= a1 and b0 <= b <= b1 and c0 <= c <= c1 and d0 <= elbow_difference(angles) <= d1


def armed(status: Status) -> Status:
    """The user wants force. Refused where the arm is not homed; after a fault its reason stays."""
    if status.state is State.HOMED:
        return _moved(status, State.ARMED, Fault.NONE)
    if status.state is State.OPEN:
        return status._replace(fault=Fault.NOT_HOMED)
    return status


def disarmed(status: Status) -> Status:
    """The user wants no force any more."""
    if status.state in (State.ARMED, State.RUN):
        return _moved(status, State.HOMED, Fault.NONE)
    return status


def failed(status: Status, fault: Fault) -> Status:
    """Something is wrong: no force from now on, whatever the state.

    Of several faults the first stays, for the others follow from it; but that the arm is unplugged says more than they.
    """
    if status.state is State.SAFE and status.fault not in NOTICES and fault is not Fault.UNPLUGGED:
        return status
    return _moved(status, State.CLOSED if status.state is State.CLOSED else State.SAFE, fault)


def sensed(
    status: Status,
    limits: Limits,
    now: float,
    report_time: float,
    counts: Triple,
    angles: Triple,
    velocity: Triple,
) -> Status:
    """What the newest report says, be it new or not; called once a period.

    ``report_time`` is when it came; ``counts`` of its encoders, unwrapped; ``angles`` (rad) and ``velocity`` (m/s) are
    what follows from it. A homed arm that cannot be trusted any more is failed.
    """
    state, fault, former, given, motors = status
    if state is State.CLOSED:
        return status
    speed = hypot(*velocity)
    if not isfinite(now + report_time + speed + sum(angles) + sum(counts)):
        return failed(status, Fault.NOT_FINITE)
    seen = Status(state, fault, Seen(now, report_time, counts, speed), given, motors)
    if state is State.SAFE:
        return seen
    age = now - report_time
    if state is State.OPEN:
        return failed(seen, Fault.SILENT) if age > ANSWER_TIME else seen
    gap = now - former.time
    if gap < 0.0 or age < -EARLY or report_time < former.report_time:
        return failed(seen, Fault.CLOCK)
    if age > STALE_SENSOR:
        return failed(seen, Fault.SILENT)
    if gap > LONGEST_GAP:
        return failed(seen, Fault.OVERRUN)
    if _jumped(former, limits, report_time, counts):
        return failed(seen, Fault.ENCODER_JUMP)
    if not _within_reach(limits, angles):
        return failed(seen, Fault.JOINT_LIMIT)
    if state is State.RUN:
        if speed > FADED_SPEED * limits.max_velocity:
            return failed(seen, Fault.VELOCITY)
        if gap > LONGEST_STALL:
            return _moved(seen, State.ARMED, Fault.STALL)
    return seen


def _jumped(former: Seen, limits: Limits, report_time: float, counts: Triple) -> bool:
    """Whether an encoder has turned farther since the last report than a hand can turn it."""
    time = min(report_time - former.report_time, STALE_SENSOR) + JITTER
    a, b, c = counts
    i, j, k = former.counts
    u, v, w = limits.max_count_rate
    return abs(a - i) > u * time or abs(b - j) > v * time or abs(c - k) > w * time


def rendered(
    status: Status,
    limits: Limits,
    now: float,
    dt: float,
    model_time: float,
    scene: int,
    force: Triple,
    magnitude: float,
) -> Status:
    """How much of a felt ``force`` (N) is given: ``.force`` of the result.

    ``dt`` is the time since the last call, of which no more than a period counts, so that a loop that stood still goes
    on where it was. ``model_time`` is the age of what is felt, ``scene`` what it is: 0 for nothing. ``magnitude`` (N)
    is that of the force before it faded with the contact normal: deep inside, where it comes as soon as the hand moves,
    it is not small.
    """
    state, fault, seen, given, motors = status
    if state is not State.RUN and state is not State.ARMED:
        return status
    x, y, z = force
    strength = hypot(x, y, z)
    if not isfinite(strength + magnitude):
        return failed(status, Fault.MODEL_NOT_FINITE)
    age, scale = now - model_time, limits.force_scale
    if state is State.ARMED:
        there = scene != 0 and -EARLY <= age <= FADE_FROM
        if there and max(strength, magnitude) < SMALL_FORCE:
            return Status(State.RUN, Fault.NONE, seen, Given(ZERO, 0.0, scene, scale), motors)
        return Status(state, fault, seen, WAITING if there else NO_FORCE, motors)
    if scene != given.scene:
        return _moved(status, State.ARMED, Fault.NONE)
    if not -EARLY <= age < FADE_TO:
        return _moved(status, State.ARMED, Fault.MODEL_STALE)
    step = min(dt, limits.period) if dt > 0.0 else 0.0
    ramp = given.ramp
    if scale > given.force_scale:
        ramp *= given.force_scale / scale  # the same force as before, and from there on up
    ramp = min(ramp + step / RAMP_TIME, 1.0)
    share = limits.max_force / strength if strength * scale > limits.max_force else scale
    share *= ramp * _fade(age, FADE_FROM, FADE_TO)
    share *= _fade(seen.speed, limits.max_velocity, FADED_SPEED * limits.max_velocity)
    force = _towards(given.force, (x * share, y * share, z * share), limits.max_slew * step)
    return Status(state, fault, seen, Given(force, ramp, scene, scale), motors)


def _fade(value: float, full: float, none: float) -> float:
    """1 up to ``full``, 0 from ``none`` on, straight in between."""
    if value <= full:
        return 1.0
    return max((none - value) / (none - full), 0.0)


def _towards(force: Triple, target: Triple, most: float) -> Triple:
    """The force nearest to ``target`` that is at most ``most`` newtons from what the last one can shrink to.

    So a force that gets smaller does so at once (late, it would put energy into the hand), also where it turns; what is
    added to it comes bit by bit. The result is never greater than the target, or than what it was.
    """
    x, y, z = force
    u, v, w = target
    square = x * x + y * y + z * z
    along = x * u + y * v + z * w
    left = 0.0 if along <= 0.0 else along / square if along < square else 1.0
    x, y, z = left * x, left * y, left * z
    i, j, k = u - x, v - y, w - z
    way = hypot(i, j, k)
    if way <= most:
        return target
    part = most / way
    return x + part * i, y + part * j, z + part * k


def limited_currents(status: Status, limits: Limits, currents: Triple, dt: float) -> tuple[Status, Triple]:
    """The ``currents`` (A) as the motors and the firmware can bear them: all scaled together, so the force keeps its
    direction. ``dt``, the time since the last call, is that in which the motors had what was given then."""
    state, fault, seen, given, motors = status
    warm = heat.warmed(motors.heat, motors.currents, dt if dt > 0.0 else 0.0, limits)
    if state is not State.RUN:
        return Status(state, fault, seen, given, Motors(ZERO, warm)), ZERO
    a, b, c = currents
    if not isfinite(a + b + c):
        return failed(status, Fault.NOT_FINITE)._replace(motors=Motors(ZERO, warm)), ZERO
    if max(abs(a), abs(b), abs(c)) > limits.steady_current:
        share = min(map(heat.bearable_share, currents, warm, repeat(limits)))
        currents = a * share, b * share, c * share
        x, y, z = given.force
        given = given._replace(force=(x * share, y * share, z * share))
    return Status(state, fault, seen, given, Motors(currents, warm)), currents


def warmth(status: Status, limits: Limits) -> float:
    """0 to 1, of the warmest motor; 1 is as warm as its continuous current makes it."""
    return heat.warmth(status.motors.heat, limits)
