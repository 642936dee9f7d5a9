# SPDX-License-Identifier: GPL-3.0-or-later
"""What protects the hand: every state with every event, every limit at its edge, and any sequence of anything."""

from collections import Counter
from dataclasses import replace
from itertools import pairwise
from math import dist, exp, hypot, inf, isfinite, nan
from random import Random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from repousse.device import heat, kinematics, safety
from repousse.device.limits import LOCK_STEP_PERIOD, PERIOD, Limits, limits_of
from repousse.device.profile import builtin_profiles
from repousse.device.safety import (
    FADE_FROM,
    FADE_TO,
    NOTICES,
    RAMP_TIME,
    SMALL_FORCE,
    STALE_SENSOR,
    Fault,
    Given,
    Motors,
    Seen,
    State,
    Status,
)

CLOSED, OPEN, HOMED, ARMED, RUN, SAFE = State
ZERO = (0.0, 0.0, 0.0)
AT_HOME = (0.1, 1.2, 0.3)
COUNTS = (100.0, 7700.0, -50.0)
LIMITS = Limits(
    max_force=4.0,
    force_scale=1.0,
    reason="",
    max_stiffness=800.0,
    max_damping=8.0,
    max_velocity=1.0,
    max_slew=400.0,
    damping=1.505,
    period=PERIOD,
    max_current=3.0,
    continuous_current=1.24,
    firmware_current=2.85,
    steady_current=1.24,
    winding_time=12.0,
    joint_limits=((-1.5, 1.5), (0.0, 2.5), (-1.0, 2.0)),
    elbow_limits=(-1.2, 1.2),
    max_count_rate=(1e5, 1e5, 1e5),
)
STEP = LIMITS.max_slew * PERIOD
"""Newtons that a period may add."""
NOW = 50.0
SCENE = 7
PRESSING = (0.3, -0.4, 1.2)
"""What RUN gives when a test begins: 1.3 N."""
NOT_NUMBERS = [nan, inf, -inf]


def at(state, force=PRESSING, ramp=1.0, now=NOW, fault=Fault.NONE, heat=ZERO, speed=0.0):
    """A status in this state; in RUN it gives a force, and its motors have the currents for it."""
    runs = state is RUN
    return Status(
        state,
        fault if state is not SAFE else fault or Fault.SILENT,
        Seen(now, now, COUNTS, speed),
        Given(force, ramp, SCENE, 1.0) if runs else Given(),
        Motors((0.5, -0.2, 0.1) if runs else ZERO, heat),
    )


def sense(status, after=PERIOD, age=0.0, counts=COUNTS, angles=AT_HOME, velocity=ZERO, limits=LIMITS):
    """The next period; its report came ``age`` ago, and if that is longer than a period it was there already."""
    now = status.seen.time + after
    if age > after:
        status = status._replace(seen=status.seen._replace(report_time=now - age))
    return safety.sensed(status, limits, now, now - age, counts, angles, velocity)


def render(status, force=PRESSING, dt=PERIOD, age=0.001, scene=SCENE, limits=LIMITS, now=NOW + PERIOD, magnitude=None):
    strength = hypot(*force) if magnitude is None else magnitude
    return safety.rendered(status, limits, now, dt, now - age, scene, force, strength)


def home(status, counts=COUNTS, angles=AT_HOME, age=0.0):
    return safety.homed(status, LIMITS, counts, angles, status.seen.report_time + age)


def currents_of(status, currents=(0.1, 0.2, 0.3), dt=PERIOD, limits=LIMITS):
    return safety.limited_currents(status, limits, currents, dt)[0]


def with_speed(status, speed):
    return status._replace(seen=status.seen._replace(speed=speed))


def older_report(status):
    now = status.seen.time + PERIOD
    return safety.sensed(status, LIMITS, now, now - 0.0011, COUNTS, AT_HOME, ZERO)


def among(values, at, value):
    return tuple(value if i == at else v for i, v in enumerate(values))


DRIVEN = (HOMED, ARMED, RUN)
"""States in which the arm has to be trusted."""


def event(does, leads, fault=None):
    """What an event does, from which states it leads where, and the fault it leaves there."""
    return does, leads, fault


def to_safe(*states):
    return dict.fromkeys(states, SAFE)


EVENTS = {
    "home": event(home, dict.fromkeys((OPEN, HOMED, ARMED, RUN, SAFE), HOMED), Fault.NONE),
    "home while moving": event(
        lambda s: home(with_speed(s, 0.11)), dict.fromkeys((HOMED, ARMED, RUN), OPEN), Fault.HOME_MOVING
    ),
    "home without a report": event(
        lambda s: home(s, age=0.021), dict.fromkeys((HOMED, ARMED, RUN), OPEN), Fault.HOME_SILENT
    ),
    "home out of reach": event(
        lambda s: home(s, angles=(0.1, 2.6, 0.3)), dict.fromkeys((HOMED, ARMED, RUN), OPEN), Fault.HOME_IMPLAUSIBLE
    ),
    "arm": event(lambda s: safety.armed(s), {HOMED: ARMED}, Fault.NONE),
    "disarm": event(lambda s: safety.disarmed(s), {ARMED: HOMED, RUN: HOMED}, Fault.NONE),
    "a good report": event(sense, {}),
    "no report for 20 ms": event(lambda s: sense(s, age=0.0199), {}),
    "no report for longer": event(lambda s: sense(s, age=0.021), to_safe(*DRIVEN), Fault.SILENT),
    "no first report": event(lambda s: sense(s, age=1.01), to_safe(OPEN, *DRIVEN), Fault.SILENT),
    "a report from the future": event(lambda s: sense(s, age=-0.006), to_safe(*DRIVEN), Fault.CLOCK),
    "a clock that goes back": event(lambda s: sense(s, after=-1e-6), to_safe(*DRIVEN), Fault.CLOCK),
    "a report older than the last": event(older_report, to_safe(*DRIVEN), Fault.CLOCK),
    "a loop that stood still": event(lambda s: sense(s, after=0.021), {RUN: ARMED}, Fault.STALL),
    "a loop that slept": event(lambda s: sense(s, after=0.251), to_safe(*DRIVEN), Fault.OVERRUN),
    "an elbow too straight": event(lambda s: sense(s, angles=(0.1, 2.3, 0.5)), to_safe(*DRIVEN), Fault.JOINT_LIMIT),
    "an elbow too bent": event(lambda s: sense(s, angles=(0.1, 0.1, 0.2)), to_safe(*DRIVEN), Fault.JOINT_LIMIT),
    "a runaway": event(lambda s: sense(s, velocity=(0.0, 1.5, 1.5)), to_safe(RUN), Fault.VELOCITY),
    "a small force": event(lambda s: render(s, (0.0, 0.0, 0.19)), {ARMED: RUN}),
    "a force that is not small": event(lambda s: render(s, (0.0, 0.0, 0.2)), {}),
    "nothing to be felt": event(lambda s: render(s, ZERO, scene=0), {RUN: ARMED}, Fault.NONE),
    "another scene": event(lambda s: render(s, scene=SCENE + 1), {RUN: ARMED}, Fault.NONE),
    "another scene, out of it": event(lambda s: render(s, ZERO, scene=SCENE + 1), {ARMED: RUN, RUN: ARMED}),
    "a model of 99 ms": event(lambda s: render(s, age=0.0999), {}),
    "a model of 100 ms": event(lambda s: render(s, age=0.1001), {RUN: ARMED}, Fault.MODEL_STALE),
    "a model of 100 ms, out of it": event(lambda s: render(s, ZERO, age=0.1001), {RUN: ARMED}, Fault.MODEL_STALE),
    "a model from the future": event(lambda s: render(s, ZERO, age=-0.006), {RUN: ARMED}, Fault.MODEL_STALE),
    "a model of no time": event(lambda s: render(s, ZERO, age=nan), {RUN: ARMED}, Fault.MODEL_STALE),
    "no time": event(lambda s: render(s, ZERO, now=nan), {RUN: ARMED}, Fault.MODEL_STALE),
    "currents": event(currents_of, {}),
}
for number in NOT_NUMBERS:
    for axis in range(3):
        name = f"{number} at {axis}"
        wrong = among(ZERO, axis, number)
        EVENTS |= {
            f"an angle {name}": event(lambda s, w=wrong: sense(s, angles=w), to_safe(OPEN, *DRIVEN), Fault.NOT_FINITE),
            f"a velocity {name}": event(
                lambda s, w=wrong: sense(s, velocity=w), to_safe(OPEN, *DRIVEN), Fault.NOT_FINITE
            ),
            f"a count {name}": event(lambda s, w=wrong: sense(s, counts=w), to_safe(OPEN, *DRIVEN), Fault.NOT_FINITE),
            f"a force {name}": event(lambda s, w=wrong: render(s, w), to_safe(ARMED, RUN), Fault.MODEL_NOT_FINITE),
            f"a current {name}": event(lambda s, w=wrong: currents_of(s, w), to_safe(RUN), Fault.NOT_FINITE),
            f"home with an angle {name}": event(
                lambda s, w=wrong: home(s, angles=w), dict.fromkeys(DRIVEN, OPEN), Fault.HOME_IMPLAUSIBLE
            ),
            f"home with a count {name}": event(
                lambda s, w=wrong: home(s, counts=w), dict.fromkeys(DRIVEN, OPEN), Fault.HOME_IMPLAUSIBLE
            ),
        }
    EVENTS |= {
        f"a report of the time {number}": event(
            lambda s, n=number: sense(s, age=n), to_safe(OPEN, *DRIVEN), Fault.NOT_FINITE
        ),
        f"the time {number}": event(lambda s, n=number: sense(s, after=n), to_safe(OPEN, *DRIVEN), Fault.NOT_FINITE),
        f"home at the time {number}": event(
            lambda s, n=number: home(s, age=n), dict.fromkeys(DRIVEN, OPEN), Fault.HOME_SILENT
        ),
        f"home at the speed {number}": event(
            lambda s, n=number: home(with_speed(s, abs(n))), dict.fromkeys(DRIVEN, OPEN), Fault.HOME_MOVING
        ),
    }
for axis in range(3):
    for sign in (-1, 1):
        counts = among(COUNTS, axis, COUNTS[axis] + sign * 301)  # 1e5 counts/s in a period and 2 ms of jitter: 300
        low, high = LIMITS.joint_limits[axis]
        angles = among((0.1, 1.2, 0.3), axis, (low if sign < 0 else high) + sign * 1e-3)
        EVENTS |= {
            f"encoder {axis} jumps {sign}": event(
                lambda s, c=counts: sense(s, counts=c), to_safe(*DRIVEN), Fault.ENCODER_JUMP
            ),
            f"joint {axis} is beyond {sign}": event(
                lambda s, a=angles: sense(s, angles=a), to_safe(*DRIVEN), Fault.JOINT_LIMIT
            ),
        }
for fault in Fault:
    EVENTS[f"fails: {fault.name}"] = event(lambda s, f=fault: safety.failed(s, f), to_safe(OPEN, *DRIVEN), fault)


@pytest.mark.parametrize("name", EVENTS)
@pytest.mark.parametrize("state", State)
def test_every_state_with_every_event(state, name):
    """Each event leads where the table says, and nowhere else; what ends in any state but RUN ends without force."""
    does, leads, fault = EVENTS[name]
    status = does(at(state))
    assert status.state is leads.get(state, state)
    if state in leads and fault is not None:
        assert status.fault is fault
    if status.state is not RUN:
        assert status.force == ZERO
        assert status.motors.currents == ZERO
        assert status.ramp == 0.0


def test_nothing_is_given_before_it_is_asked_for():
    """The whole way, each step by its own order: no force in any of them but the last."""
    status = safety.opened(NOW)
    assert status.state is OPEN
    for order, state in ((sense, OPEN), (home, HOMED), (sense, HOMED), (lambda s: safety.armed(s), ARMED)):
        status = order(status)
        assert status.state is state
        assert render(status, (0.0, 0.0, 9.0)).force == ZERO
    status = render(status, ZERO)
    assert status.state is RUN
    assert status.force == ZERO
    assert 0.0 < hypot(*render(status).force) < 0.01


@pytest.mark.parametrize("fault", [f for f in Fault if f not in NOTICES])
def test_after_a_fault_the_user_has_to_home_and_to_arm(fault):
    status = safety.failed(at(RUN), fault)
    for order in (sense, lambda s: safety.armed(s), lambda s: safety.disarmed(s), render):
        status = order(status)
        assert status.state is SAFE
        assert status.fault is fault
    status = home(status)
    assert (status.state, status.fault) == (HOMED, Fault.NONE)
    assert render(status, ZERO).state is HOMED
    assert render(safety.armed(status), ZERO).state is RUN


def test_of_several_faults_the_first_is_told_but_for_a_pulled_plug():
    first = safety.failed(at(RUN), Fault.SILENT)
    assert safety.failed(first, Fault.WRITE_FAILED).fault is Fault.SILENT
    assert safety.failed(first, Fault.UNPLUGGED).fault is Fault.UNPLUGGED
    refused = home(with_speed(first, 1.0))
    assert (refused.state, refused.fault) == (SAFE, Fault.HOME_MOVING)
    assert safety.failed(refused, Fault.WRITE_FAILED).fault is Fault.WRITE_FAILED


def test_a_stopped_arm_may_be_anywhere_and_its_reason_stays():
    """It is moved by hand to be homed: nothing that it reports is a fault, or tells something else than what counts."""
    for fault in (Fault.WRITE_FAILED, Fault.HOME_MOVING):
        for how in ({"angles": (9.0, 9.0, 9.0)}, {"counts": (1e5, 0.0, 0.0)}, {"age": 5.0}, {"after": 5.0}):
            status = sense(at(SAFE, fault=fault), **how)
            assert (status.state, status.fault) == (SAFE, fault)


def test_arming_is_refused_with_the_reason():
    assert safety.armed(at(OPEN)).fault is Fault.NOT_HOMED
    assert safety.armed(at(CLOSED)) == at(CLOSED)


def test_after_homing_the_counts_begin_anew():
    """Homing tells the firmware other counts: that is no jump. What jumps afterwards is one."""
    status = home(at(SAFE), counts=(-9000.0, 0.0, 20000.0))
    assert sense(status, counts=(-9000.0, 0.0, 20000.0)).state is HOMED
    assert sense(status).fault is Fault.ENCODER_JUMP


def test_an_encoder_may_turn_as_fast_as_a_hand_but_no_farther_than_in_20_ms():
    """Reports may be lost or late: what counts is the time from one to the next."""
    for after in (0.001, 0.005, 0.0199):
        most = 1e5 * (after + safety.JITTER)
        near, far = ((COUNTS[0] + d, *COUNTS[1:]) for d in (0.99 * most, 1.01 * most))
        assert sense(at(HOMED), after=after, counts=near).state is HOMED
        assert sense(at(HOMED), after=after, counts=far).fault is Fault.ENCODER_JUMP
    later = (COUNTS[0] + 1e5 * 0.1, *COUNTS[1:])
    assert sense(at(HOMED), after=0.2, counts=later).fault is Fault.ENCODER_JUMP


def test_a_pose_at_the_edge_of_what_is_allowed_is_fine():
    for axis, limits in enumerate(LIMITS.joint_limits):
        for limit in limits:
            angles = among((0.1, 1.2, 0.3), axis, limit)
            if abs(kinematics.elbow_difference(angles)) < 1.2:
                assert sense(at(RUN), angles=angles).state is RUN
    assert sense(at(RUN), velocity=(0.0, 0.0, 2.0)).state is RUN


def test_the_age_of_a_report_counts_in_every_period():
    """A device that falls silent is noticed in the first period that begins more than 20 ms after its last report."""
    status, last = at(RUN), NOW
    for n in range(1, 40):
        now = NOW + n * PERIOD
        status = safety.sensed(status, LIMITS, now, last, COUNTS, AT_HOME, ZERO)
        assert (status.state is RUN) == (now - last <= STALE_SENSOR)
    assert status.fault is Fault.SILENT


def run_for(status, seconds, force=PRESSING, dt=PERIOD, limits=LIMITS, **how):
    """Periods of the same force; gives all statuses."""
    passed = []
    for _ in range(round(seconds / dt)):
        status = render(status, force, dt=dt, limits=limits, **how)
        passed.append(status)
    return passed


@pytest.mark.parametrize("strength", [0.2, 0.3, 1.0, 40.0])
def test_an_engagement_waits_for_a_small_force_and_says_so(strength):
    for status in run_for(at(ARMED), 0.1, (0.0, strength, 0.0)):
        assert status.state is ARMED
        assert status.waiting
        assert status.force == ZERO
    status = render(status, (0.0, 0.199, 0.0))
    assert status.state is RUN
    assert not status.waiting


def test_where_nothing_is_felt_yet_nothing_is_waited_for():
    """Neither no material nor a model that nobody renews opens the gate, and neither is too strong a force."""
    for how in ({"scene": 0}, {"age": FADE_FROM + 1e-3}, {"age": nan}, {"age": -inf}):
        for force in (ZERO, PRESSING):
            status = render(at(ARMED), force, **how)
            assert (status.state, status.waiting) == (ARMED, False)


def test_the_force_rises_in_a_straight_line_for_a_second_and_a_half():
    """From an engagement at a small force to all of it, in proportion to the time."""
    status = render(at(ARMED), ZERO)
    passed = run_for(status, 2.0)
    for n, status in enumerate(passed, start=1):
        share = min(n * PERIOD / RAMP_TIME, 1.0)
        assert status.ramp == pytest.approx(share)
        assert status.force == pytest.approx([share * f for f in PRESSING])


@pytest.mark.parametrize(
    "again",
    [
        lambda s: render(render(s, scene=SCENE + 1), ZERO, scene=SCENE + 1),
        lambda s: render(render(s, age=0.2), ZERO),
        lambda s: render(sense(s, after=0.03), ZERO),
        lambda s: render(safety.armed(home(sense(s, age=0.03), age=-0.001)), ZERO),
        lambda s: render(safety.armed(safety.disarmed(s)), ZERO),
    ],
    ids=["scene", "stale model", "stalled loop", "fault", "disarmed"],
)
def test_every_engagement_has_its_own_ramp(again):
    status = again(at(RUN))
    assert status.state is RUN
    assert status.ramp == 0.0
    assert hypot(*render(status, scene=status.given.scene).force) < 2e-3 * hypot(*PRESSING)


def test_a_stale_model_fades_from_50_ms_and_is_gone_at_100():
    for age in (0.0, 0.02, 0.0499, 0.06, 0.075, 0.09, 0.0999):
        share = min(1.0, (FADE_TO - age) / (FADE_TO - FADE_FROM))
        assert render(at(RUN), age=age).force == pytest.approx([share * f for f in PRESSING])
    assert render(at(RUN), age=FADE_TO).force == ZERO


def test_why_the_force_waits_is_told_until_it_is_back():
    status = render(at(RUN), age=0.2)
    assert render(status, PRESSING).fault is Fault.MODEL_STALE
    assert render(status, ZERO).fault is Fault.NONE


def test_a_fast_arm_gets_less_force():
    """All up to the profile's speed, none at twice it, in a straight line between."""
    for speed, share in ((0.0, 1.0), (1.0, 1.0), (1.25, 0.75), (1.75, 0.25), (2.0, 0.0), (5.0, 0.0)):
        status = render(with_speed(at(RUN), speed))
        assert status.force == pytest.approx([share * f for f in PRESSING])


vectors = st.tuples(*[st.floats(-12.0, 12.0)] * 3)


@given(vectors)
def test_a_strong_force_keeps_its_direction(force):
    """However strong, it is given as far as the device may, along the same line."""
    status = run_for(at(RUN, ZERO), 0.03, force)[-1]
    share = min(1.0, 4.0 / hypot(*force)) if any(force) else 0.0
    assert status.force == pytest.approx([share * f for f in force], abs=1e-9)


def away_from_what_shrinks(force, former):
    """Newtons from a force to the nearest that the former one can shrink to."""
    square = sum(f * f for f in former)
    share = min(max(sum(a * b for a, b in zip(force, former)) / square, 0.0), 1.0) if square > 1e-30 else 0.0
    return dist(force, [share * f for f in former])


@given(vectors, vectors, st.floats(0.0, 1.0))
@example((0.0, 0.0, 3.0), (0.0, 0.0, -3.0), 1.0)
@example((3.0, 0.0, 0.0), (0.0, 3.0, 0.0), 1.0)
@example((5e-324, 0.0, 0.0), (4.0, 0.0, 0.0), 1.0)
@example((1e-200, 0.0, 0.0), (4.0, 0.0, 0.0), 1.0)
def test_what_is_added_in_a_period_is_limited_and_what_is_taken_is_not(former, force, ramp):
    """The force is a part of the former one and at most 0.4 N more; it is never greater than both it and its target;
    and of all such forces none is nearer to the target."""
    former = tuple(f / max(hypot(*former) / 4.0, 1.0) for f in former)
    status = render(at(RUN, former, ramp), force)
    share = min(4.0 / max(hypot(*force), 4.0), 1.0) * status.ramp
    target = [share * f for f in force]
    assert away_from_what_shrinks(status.force, former) <= STEP + 1e-9
    assert hypot(*status.force) <= max(hypot(*target), hypot(*former)) + 1e-9
    assert hypot(*status.force) <= hypot(*target) + 1e-9
    assert dist(status.force, target) <= max(away_from_what_shrinks(target, former) - STEP, 0.0) + 1e-9


def test_a_force_that_ends_ends_at_once_and_one_that_turns_round_does_not_push_on():
    pushing = at(RUN, (0.0, 0.0, 3.0))
    assert render(pushing, ZERO).force == ZERO
    assert render(pushing, (0.0, 0.0, 1.0)).force == pytest.approx((0.0, 0.0, 1.0))
    assert render(pushing, (0.0, 0.0, -3.0)).force == pytest.approx((0.0, 0.0, -STEP))
    assert render(pushing, (0.0, 3.0, 0.0)).force == pytest.approx((0.0, STEP, 0.0))


@given(vectors, vectors, st.floats(0.0, 0.999), st.one_of(st.floats(0.0, 30.0), st.sampled_from([inf, nan, -1.0])))
def test_a_loop_that_stood_still_adds_no_more_than_one_that_did_not(former, force, ramp, stall):
    """However long it took, neither the slew nor the ramp gets more than one period."""
    former = tuple(f / max(hypot(*former) / 4.0, 1.0) for f in former)
    before, after = at(RUN, former, ramp), render(at(RUN, former, ramp), force, dt=stall)
    assert after.ramp - before.ramp <= PERIOD / RAMP_TIME + 1e-12
    assert away_from_what_shrinks(after.force, former) <= STEP + 1e-9
    assert hypot(*after.force) <= hypot(*former) + STEP + 1e-9


@given(vectors, st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.05, 1.0))
def test_a_scale_that_is_raised_does_not_raise_the_force_at_once(force, former, scale, ramp):
    """It goes on from the force that was given, at the pace of the ramp."""
    old = replace(LIMITS, force_scale=former, max_force=4.0 * former)
    new = replace(LIMITS, force_scale=scale, max_force=4.0 * scale)
    status = at(RUN, ZERO, ramp)
    status = status._replace(given=status.given._replace(force_scale=former))
    settled = run_for(status, 0.05, force, limits=old)[-1]
    after = render(settled, force, limits=new)
    slow = min(hypot(*force), 4.0) * scale * PERIOD / RAMP_TIME
    assert hypot(*after.force) <= hypot(*settled.force) + slow + 1e-9
    if scale <= former:
        assert hypot(*after.force) <= scale * 4.0 + 1e-9
        assert after.ramp >= settled.ramp
    last = run_for(after, RAMP_TIME, force, limits=replace(new, period=0.05, max_slew=8.0), dt=0.05)[-1]
    assert last.force == pytest.approx([scale * f * min(1.0, 4.0 / max(hypot(*force), 1e-9)) for f in force], abs=1e-6)


def test_a_scale_of_nothing_is_no_force():
    nothing = replace(LIMITS, force_scale=0.0, max_force=0.0)
    assert render(at(RUN), limits=nothing).force == ZERO
    assert render(render(at(ARMED), ZERO, limits=nothing), limits=nothing).force == ZERO


# Motors


def give(status, currents, seconds, dt=PERIOD, limits=LIMITS):
    """(status, currents) after each period that asked for these currents."""
    passed = []
    for _ in range(round(seconds / dt)):
        status = status._replace(given=status.given._replace(force=PRESSING))
        status, given_ = safety.limited_currents(status, limits, currents, dt)
        passed.append((status, given_))
    return passed


@given(st.tuples(*[st.floats(-20.0, 20.0)] * 3), st.tuples(*[st.floats(0.0, 1.5376)] * 3))
def test_currents_are_scaled_together_below_what_motors_and_firmware_take(currents, warm):
    status, given_ = safety.limited_currents(at(RUN, heat=warm), LIMITS, currents, PERIOD)
    for current, hot in zip(given_, status.motors.heat):
        assert abs(current) <= min(2.85, heat.allowed_current(hot, LIMITS)) + 1e-12
    shares = [g / c for g, c in zip(given_, currents) if abs(c) > 1e-9]
    if shares:
        assert shares == pytest.approx([shares[0]] * len(shares))
        assert 0.0 < shares[0] <= 1.0
        assert status.force == pytest.approx([shares[0] * f for f in PRESSING])
        if max(map(abs, currents)) <= 1.24:
            assert given_ == currents


def test_what_the_firmware_would_drop_is_never_sent():
    """Teensy firmware makes zero of what is over its limit: the arm would let go where it should push most."""
    for profile in builtin_profiles().values():
        for link in profile.links if profile.driven else ():
            limits = limits_of(profile, link)
            _, sent = safety.limited_currents(at(RUN), limits, (900.0, -500.0, 1.0), PERIOD)
            assert max(map(abs, sent)) <= 0.95 * link.firmware_current_limit + 1e-12
            assert max(map(abs, sent)) <= profile.max_current
            assert max(map(abs, sent)) >= 0.9 * min(profile.max_current, 0.95 * link.firmware_current_limit)


def test_a_motor_that_is_driven_hard_ends_at_its_continuous_current_and_no_warmer():
    """From cold the peak is there; the heat never passes that of the continuous current, and the current ends there."""
    passed = give(at(RUN), (0.0, 40.0, 0.0), 120.0, dt=0.01)
    given_ = [g[1] for _, g in passed]
    assert given_[0] == pytest.approx(2.85, rel=0.01)
    assert all(b <= a + 1e-12 for a, b in pairwise(given_))
    assert given_[-1] == pytest.approx(1.24, rel=0.01)
    assert max(s.motors.heat[1] for s, _ in passed) <= 1.24**2 + 1e-9
    assert safety.warmth(passed[-1][0], LIMITS) == pytest.approx(1.0, abs=0.01)


def test_heat_follows_its_time_constant_and_cools_in_every_state():
    """A steady current's square, approached as 1 - e^(-t / 12 s); and back without current, in whatever state."""
    status = give(at(RUN), (1.0, 0.5, 0.0), 12.0, dt=0.01)[-1][0]
    assert status.motors.heat == pytest.approx([(1 - exp(-1)) * i * i for i in (1.0, 0.5, 0.0)], rel=2e-3, abs=1e-4)
    for state in State:
        resting = at(state, heat=(1.0, 0.5, 0.0))._replace(motors=Motors(ZERO, (1.0, 0.5, 0.0)))
        cooled = give(resting, ZERO, 12.0, dt=0.1)[-1][0]
        assert cooled.motors.heat == pytest.approx([exp(-1) * h for h in (1.0, 0.5, 0.0)], rel=2e-3, abs=1e-4)


@pytest.mark.parametrize("dt", [nan, inf, -inf, -1.0, 0.0, 1e300])
def test_no_time_makes_a_motor_colder_than_its_current(dt):
    status = currents_of(at(RUN, heat=(0.2, 0.02, 0.005)), dt=dt)
    assert all(map(isfinite, status.motors.heat))
    assert all(h >= min(w, i * i) for h, w, i in zip(status.motors.heat, (0.2, 0.02, 0.005), (0.5, -0.2, 0.1)))


def test_a_fault_keeps_the_heat():
    warm = (0.4, 0.5, 0.6)
    for does in (lambda s: safety.failed(s, Fault.SILENT), home, lambda s: safety.disarmed(s)):
        assert does(at(RUN, heat=warm)).motors.heat == warm
    assert currents_of(at(RUN, heat=warm), (nan, 0.0, 0.0)).motors.heat == pytest.approx(warm, abs=1e-3)


# Any sequence of anything

ODD_NUMBERS = [0.0, nan, inf, -inf, 1e308, -1e308, 1e-308, 5e-324, -1e-200, 3.0]


class Anything:
    """What may happen next: mostly sensible, at times not at all."""

    def __init__(self, seed):
        self.random = Random(seed)
        self.usual = (0.0, 0.0, 0.0)

    def odd(self):
        return self.random.random() < 0.004

    def one(self, usual, *others):
        return self.random.choice(others) if self.odd() else usual

    def vector(self, most):
        if self.odd():
            return tuple(self.random.choice(ODD_NUMBERS) for _ in range(3))
        return tuple(self.random.uniform(-most, most) for _ in range(3))

    def order(self, state):
        """Users press what leads on; now and then anything is pressed, or breaks."""
        leads_on = {OPEN: "home", SAFE: "home", HOMED: "arm"}.get(state)
        if leads_on and self.random.random() < 0.1:
            return leads_on
        return self.one("period", "home", "arm", "disarm", "fail", "scale")

    def felt(self):
        """Some strength for a while, then another: little often enough to engage."""
        if self.random.random() < 0.02:
            self.usual = self.vector(self.random.choice([0.1, 2.0, 12.0]))
        return tuple(u + self.random.uniform(-0.02, 0.02) for u in self.usual)


@pytest.mark.parametrize("seed", range(24))
def test_no_sequence_of_anything_gives_a_force_that_it_should_not(seed):
    """Whatever comes: force and currents are numbers, within their limits, zero outside of RUN, and rise slowly; RUN
    comes only after ARMED, ARMED only by an order or out of RUN, and out of SAFE leads only homing."""
    may = Anything(seed)
    status, now, limits, reported, periods = safety.opened(NOW), NOW, LIMITS, NOW, 0
    seen = Counter()
    for _ in range(2500):
        former, order = status, may.order(status.state)
        if order == "home":
            angles = may.one(AT_HOME, may.vector(3.0))
            status = safety.homed(status, limits, COUNTS, angles, now)
        elif order == "arm":
            status = safety.armed(status)
        elif order == "disarm":
            status = safety.disarmed(status)
        elif order == "fail":
            status = safety.failed(status, may.random.choice(list(Fault)))
        elif order == "scale":
            scale = may.one(may.random.random(), *NOT_NUMBERS)
            scale = limits_of(*driven()[0], scale).force_scale
            limits = replace(LIMITS, force_scale=scale, max_force=4.0 * scale)
        else:
            dt = may.one(PERIOD, 0.002, 0.019, 0.025, 0.3, 0.0, -0.01, nan, inf)
            late = now + dt
            reported = may.one(late, reported, late - 0.5, late + 1.0, nan)
            angles, velocity = may.one(AT_HOME, may.vector(3.0)), may.one((0.0, 0.0, 0.1), may.vector(3.0))
            counts = may.one(COUNTS, may.vector(20000.0))
            sensed = safety.sensed(status, limits, late, reported, counts, angles, velocity)
            assert former.state is RUN or sensed.state is not RUN
            age, scene, felt = may.one(0.002, 0.04, 0.07, 0.2, -1.0, nan, inf), may.one(1, 0, 2), may.felt()
            status = safety.rendered(sensed, limits, late, dt, late - age, scene, felt, hypot(*felt))
            if status.state is RUN and sensed.state is not RUN:
                assert sensed.state is ARMED
                assert hypot(*felt) < SMALL_FORCE
                assert scene != 0
                periods = -1
            periods += 1
            assert away_from_what_shrinks(status.force, former.force) <= STEP + 1e-9
            status, sent = safety.limited_currents(status, limits, may.vector(4.0), dt)
            assert sent == status.motors.currents
            assert max(map(abs, sent)) <= LIMITS.firmware_current + 1e-12
            assert hypot(*status.force) <= limits.max_force + 1e-9
            seen.update([status.state, "force" if any(status.force) else "none"])
            now = late if dt >= 0.0 and isfinite(late) else now
        if former.state is SAFE:
            assert status.state is SAFE or (order == "home" and status.state is HOMED)
        if former.state is OPEN:
            assert status.state in (OPEN, SAFE) or (order == "home" and status.state is HOMED)
        if former.state is HOMED:
            assert status.state in (HOMED, SAFE) or (status.state, order) in [(ARMED, "arm"), (OPEN, "home")]
        if status.state is ARMED:
            assert former.state in (ARMED, RUN) or order == "arm"
        assert all(map(isfinite, (*status.force, *status.motors.currents, *status.motors.heat)))
        assert 0.0 <= status.ramp <= min(1.0, periods * PERIOD / RAMP_TIME) + 1e-9
        if status.state is not RUN:
            assert status.force == status.motors.currents == ZERO
    assert {HOMED, ARMED, RUN, SAFE} <= seen.keys()
    assert seen["force"] > 200


# Limits of real arms


def driven():
    return [(p, link) for p in builtin_profiles().values() if p.driven for link in p.links]


@pytest.mark.parametrize(("profile", "link"), driven(), ids=lambda x: getattr(x, "key", getattr(x, "name", "")))
def test_every_arm_of_ours_can_be_homed_armed_and_moved(profile, link):
    """In its home pose, and at twice its greatest speed anywhere between it and the middle of its workspace, its joints
    and encoders are within the limits."""
    limits = limits_of(profile, link)
    angles = kinematics.joint_angles(profile, profile.home_counts)
    counts = tuple(map(float, profile.home_counts))
    status = safety.homed(safety.opened(NOW), limits, counts, angles, NOW)
    assert status.state is HOMED
    point, goal, now = kinematics.position(profile, angles), profile.workspace_centre, NOW
    speed = safety.FADED_SPEED * profile.max_velocity
    while dist(point, goal) > 1e-9:
        share = min(1.0, speed * PERIOD / dist(point, goal))
        point = tuple(p + share * (g - p) for p, g in zip(point, goal))
        angles, now = kinematics.angles_of(profile, point), now + PERIOD
        counts = kinematics.counts_of(profile, angles)
        status = safety.sensed(status, limits, now, now, counts, angles, (speed, 0.0, 0.0))
        assert (status.state, status.fault) == (HOMED, Fault.NONE)
    far = (counts[0] + 16384, *counts[1:])
    assert safety.sensed(status, limits, now + PERIOD, now + PERIOD, far, angles, ZERO).fault is Fault.ENCODER_JUMP


@pytest.mark.parametrize(("profile", "link"), driven(), ids=lambda x: getattr(x, "key", getattr(x, "name", "")))
def test_limits_are_those_of_the_profile_in_the_units_of_the_loop(profile, link):
    """Newtons a second for newtons a millisecond, and encoder counts for three times the highest speed of the tip."""
    limits = limits_of(profile, link)
    assert limits.max_slew == pytest.approx(profile.max_slew / 1e-3)
    assert limits.damping == pytest.approx(profile.device_damping + profile.hand_damping)
    assert (limits.max_stiffness, limits.max_damping) == (profile.max_stiffness, profile.max_damping)
    assert limits.steady_current <= min(profile.continuous_current, 0.95 * link.firmware_current_limit)
    _, upper, fore = profile.lengths
    for rate, step, lever in zip(limits.max_count_rate, profile.radians_per_count, (min(upper, fore) / 2, upper, fore)):
        assert rate * abs(step) * lever == pytest.approx(3.0 * profile.max_velocity)


@pytest.mark.parametrize(("profile", "link"), driven(), ids=lambda x: getattr(x, "key", getattr(x, "name", "")))
def test_an_arm_that_lets_go_late_has_a_quarter_of_its_force_and_says_why(profile, link):
    for watchdog, share in ((0.0, 0.25), (50.0, 1.0), (100.0, 1.0), (100.1, 0.25), (500.0, 0.25), (nan, 0.25)):
        limits = limits_of(profile, replace(link, firmware_watchdog_ms=watchdog))
        assert limits.max_force == pytest.approx(share * profile.max_force)
        assert bool(limits.reason) == (share < 1.0)
        assert "\n" not in limits.reason
    assert "500 ms" in limits_of(profile, replace(link, firmware_watchdog_ms=500.0)).reason


@pytest.mark.parametrize(
    ("asked", "scale"),
    [(1.0, 1.0), (0.3, 0.3), (0.0, 0.0), (-1.0, 0.0), (7.0, 1.0), (nan, 0.0), (inf, 1.0), (-inf, 0.0)],
)
def test_a_scale_is_from_none_to_all(asked, scale):
    profile, link = driven()[0]
    limits = limits_of(profile, link, asked)
    assert limits.force_scale == scale
    assert limits.max_force == pytest.approx(scale * limits_of(profile, link).max_force)


def test_an_arm_in_lock_step_takes_two_frames_for_a_period():
    profile, link = driven()[0]
    assert limits_of(profile, replace(link, lock_step=True)).period == LOCK_STEP_PERIOD
    assert limits_of(profile, replace(link, lock_step=False)).period == PERIOD


# Words


def test_every_state_and_every_fault_is_one_line_that_says_what_to_do():
    for state in State:
        assert 5 < len(safety.state_text(state)) < 90
    texts = [safety.fault_text(fault) for fault in Fault if fault]
    for text in texts:
        assert 20 < len(text) < 160
        assert "\n" not in text
        assert ":" in text, "what is wrong, then what to do"
    assert len(set(texts)) == len(texts)
    assert safety.fault_text(Fault.NONE) == ""


@pytest.mark.parametrize("number", [-1, 6, 99, 1 << 70])
def test_a_number_that_means_nothing_is_told_as_that(number):
    """It comes through shared memory."""
    assert str(number) in safety.state_text(number)
    assert str(number + 14) in safety.fault_text(number + 14) or number == -1
    assert str(-5) in safety.fault_text(-5)


def test_a_force_that_has_faded_is_not_small():
    """Deep inside uniform material there is no outside to push to, but drag as soon as the hand moves."""
    waiting = render(at(ARMED), ZERO, magnitude=SMALL_FORCE)
    assert waiting.state is ARMED and waiting.waiting and waiting.force == ZERO
    assert render(at(ARMED), ZERO, magnitude=0.99 * SMALL_FORCE).state is RUN
    assert render(at(RUN), ZERO, magnitude=nan).state is SAFE
