# SPDX-License-Identifier: GPL-3.0-or-later
"""The arm's geometry against derivatives, energy and published figures, for every arm that is driven."""

from dataclasses import replace
from math import cos, degrees, hypot, isclose, nan, pi, radians, sin, tau

import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.device import kinematics
from repousse.device.profile import builtin_profiles

DRIVEN = [profile for profile in builtin_profiles().values() if profile.driven]
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

each_arm = pytest.mark.parametrize("arm", DRIVEN, ids=lambda profile: profile.key)
angle = st.floats(-3.0, 3.0)
anywhere = st.tuples(angle, angle, angle)
newtons = st.floats(-10.0, 10.0)
forces = st.tuples(newtons, newtons, newtons)
inside = st.tuples(st.floats(0.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.0, tau))  # of a ball: radius, height, turn


def the(key):
    return builtin_profiles()[key]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def shifted(values, axis, by):
    return tuple(value + by * (at == axis) for at, value in enumerate(values))


def in_workspace(arm, ball):
    radius, height, turn = ball
    across = (1.0 - height * height) ** 0.5
    direction = (across * cos(turn), across * sin(turn), height)
    return tuple(c + arm.workspace_radius * radius * d for c, d in zip(arm.workspace_centre, direction))


@each_arm
@given(angles=anywhere)
def test_jacobian_is_the_derivative_of_position(arm, angles):
    step = 1e-5
    rows = kinematics.jacobian(arm, angles)
    for joint in range(3):
        ahead = kinematics.position(arm, shifted(angles, joint, step))
        behind = kinematics.position(arm, shifted(angles, joint, -step))
        for row, a, b in zip(rows, ahead, behind):
            assert abs(row[joint] - (a - b) / (2.0 * step)) <= 1e-8


@each_arm
@given(angles=anywhere, force=forces)
def test_joint_torques_are_the_transposed_jacobian_times_the_force(arm, angles, force):
    rows = kinematics.jacobian(arm, angles)
    torques = kinematics.joint_torques(arm, angles, force)
    for joint, torque in enumerate(torques):
        assert isclose(torque, dot([row[joint] for row in rows], force), rel_tol=0.0, abs_tol=1e-12)


@each_arm
@given(angles=anywhere, force=forces, speeds=forces)
def test_the_motors_do_the_work_that_the_tip_does(arm, angles, force, speeds):
    """Power in, current x torque constant x speed of the motor as its encoder tells it, is power out at the tip.

    So the sign of each motor goes with that of its encoder: a wall never pulls.
    """
    rows = kinematics.jacobian(arm, angles)
    at_the_tip = dot(force, [dot(row, speeds) for row in rows])
    step = 1e-3
    moved = kinematics.counts_of(arm, tuple(a + s * step for a, s in zip(angles, speeds)))
    counts = (m - c for m, c in zip(moved, kinematics.counts_of(arm, angles)))
    motor_speeds = [tau * n / turn / step for n, turn in zip(counts, arm.counts_per_turn)]
    amperes = kinematics.currents(arm, angles, force)
    in_the_motors = sum(i * k * w for i, k, w in zip(amperes, arm.torque_constant, motor_speeds))
    assert isclose(in_the_motors, at_the_tip, rel_tol=1e-6, abs_tol=1e-6)


@each_arm
@given(angles=anywhere, force=forces)
def test_motor_torques_undo_currents(arm, angles, force):
    torques = kinematics.motor_torques(arm, kinematics.currents(arm, angles, force))
    assert torques == pytest.approx(kinematics.joint_torques(arm, angles, force), rel=1e-12, abs=1e-15)


@each_arm
@given(counts=st.tuples(*[st.integers(-32768, 32767)] * 3))
def test_counts_and_angles_undo_each_other(arm, counts):
    assert kinematics.counts_of(arm, kinematics.joint_angles(arm, counts)) == pytest.approx(counts, abs=1e-6)


def test_angle_offsets_are_where_the_counts_are_zero():
    arm = replace(the("woodenhaptics-2015"), angle_offset=(0.1, 0.2, 0.3))
    assert kinematics.joint_angles(arm, (0, 0, 0)) == (0.1, 0.2, 0.3)
    assert kinematics.counts_of(arm, (0.1, 0.2, 0.3)) == (0.0, 0.0, 0.0)


@each_arm
@given(ball=inside)
def test_the_whole_workspace_is_within_reach_and_limits(arm, ball):
    point = in_workspace(arm, ball)
    angles = kinematics.angles_of(arm, point)
    assert kinematics.position(arm, angles) == pytest.approx(point, abs=1e-12)
    assert kinematics.beyond_limits(arm, angles) <= 0.0
    assert kinematics.elbow_difference(angles) == pytest.approx(pi / 2 - angles[1] - angles[2])


@given(a=st.floats(-1.5, 1.5), upper=st.floats(-2.0, 2.0), difference=st.floats(-0.95, 1.13))
def test_every_pose_in_the_limits_is_found_from_its_position(a, upper, difference):
    """Of the PHANToM Premium, but for those behind its own axis."""
    arm = the("phantom-premium-1.5")
    angles = (a, pi / 2 - upper, upper - difference)
    reach = arm.lengths[1] * cos(upper) + arm.lengths[2] * sin(angles[2])
    if reach < 1e-3 or kinematics.beyond_limits(arm, angles) > 0.0:
        return
    assert kinematics.angles_of(arm, kinematics.position(arm, angles)) == pytest.approx(angles, abs=1e-9)


@each_arm
def test_what_is_out_of_reach_is_said(arm):
    longest = arm.lengths[1] + arm.lengths[2]
    for point in ((longest + 1e-6 - arm.origin[0], 0.0, arm.lengths[0] - arm.origin[2]), (9.0, 9.0, 9.0)):
        with pytest.raises(ValueError, match="cannot reach"):
            kinematics.angles_of(arm, tuple(point))
    with pytest.raises(ValueError, match="cannot reach"):
        kinematics.angles_of(arm, (nan, 0.0, 0.0))


@pytest.mark.parametrize("end", range(2))
@pytest.mark.parametrize("at", range(4))
def test_beyond_limits_measures_each_limit(at, end):
    """Of three joints and the elbow: how far the one outside is so, and how close the nearest is where none is."""
    limits = ((-1.0, 2.0), (-3.0, 4.0), (-5.0, 6.0))
    elbow = (-0.5, 0.7)
    if at == 3:
        angles = (0.0, 0.5 * pi, 0.0 - elbow[end])
        alone = replace(the("phantom-premium-1.5"), joint_limits=((-9.0, 9.0),) * 3, difference_limits=elbow)
        out = (0.0, 0.0, 0.01 if end == 0 else -0.01)
    else:
        angles = tuple(limits[at][end] * (joint == at) for joint in range(3))
        alone = replace(the("phantom-premium-1.5"), joint_limits=limits, difference_limits=(-9.0, 9.0))
        out = tuple((0.01 if end else -0.01) * (joint == at) for joint in range(3))
    assert kinematics.beyond_limits(alone, angles) == pytest.approx(0.0, abs=1e-12)
    assert kinematics.beyond_limits(alone, tuple(a + o for a, o in zip(angles, out))) == pytest.approx(0.01)
    assert kinematics.beyond_limits(alone, tuple(a - o for a, o in zip(angles, out))) == pytest.approx(-0.01)


@pytest.mark.parametrize(
    ("key", "millimetres", "angles"),
    [
        ("woodenhaptics-2015", (25.0, 0.0, 205.0), (0, 0, 90)),
        ("woodenhaptics-2019", (25.0, 0.0, 205.0), (0, 0, 90)),
        ("phantom-vintage", (0.0, 0.0, -15.0), (0, 90, 0)),
        ("phantom-premium-1.5", (0.0, 0.0, 0.0), (0, 90, 0)),
        ("aluhaptics", (0.0, 0.0, 0.0), (0, 90, 0)),
    ],
)
def test_home(key, millimetres, angles):
    """Where each arm's published numbers put it (aluhaptics: ours)."""
    arm = the(key)
    home = kinematics.joint_angles(arm, arm.home_counts)
    assert [degrees(angle) for angle in home] == pytest.approx(angles, abs=0.02)
    assert [1000.0 * x for x in kinematics.position(arm, home)] == pytest.approx(millimetres, abs=0.05)


@pytest.mark.parametrize(
    ("key", "count", "amperes", "force"),
    [
        ("woodenhaptics-2015", (0.048, 0.054, 0.064), 3.0, (4.55, 5.07, 3.81)),
        ("phantom-vintage", (0.024, 0.028, 0.023), 1.24, (1.99, 1.89, 1.62)),
        ("phantom-premium-1.5", (0.024, 0.029, 0.023), 5.5, (8.5, 8.2, 6.9)),
    ],
)
def test_resolution_and_strength_at_home(key, count, amperes, force):
    """One count in mm, by body, and the force along each axis that a current allows: 8.5 N is the Premium's
    published strength, the others follow from the published numbers by hand."""
    arm = the(key)
    home = kinematics.joint_angles(arm, arm.home_counts)
    rows = kinematics.jacobian(arm, home)
    steps = [1000.0 * abs(arm.radians_per_count[joint]) * hypot(*(row[joint] for row in rows)) for joint in range(3)]
    assert steps == pytest.approx(count, abs=0.0006)
    strengths = [amperes / max(map(abs, kinematics.currents(arm, home, axis))) for axis in AXES]
    assert strengths == pytest.approx(force, rel=0.008)


@given(q=st.tuples(st.floats(-1.5, 1.5), st.floats(-2.0, 2.0), st.floats(-0.5, 3.5)))
def test_premium_is_the_phantom_of_the_literature(q):
    """x = c1 (l1 c2 + l2 s3), y = s1 (same), z = l1 s2 - l2 c3 in PhantomModel.cpp, but for the origin."""
    arm = the("phantom-premium-1.5")
    q1, q2, q3 = q
    l1, l2 = 0.20955, 0.169545
    counts = tuple(v * ratio * 4096 / tau for v, ratio in zip(q, (13.3, 11.2, 11.2)))
    x, y, z = kinematics.position(arm, kinematics.joint_angles(arm, counts))
    reach = l1 * cos(q2) + l2 * sin(q3)
    assert (x + l1, y, z - l2) == pytest.approx(
        (cos(q1) * reach, sin(q1) * reach, l1 * sin(q2) - l2 * cos(q3)), abs=1e-12
    )
    assert kinematics.elbow_difference(kinematics.joint_angles(arm, counts)) == pytest.approx(q2 - q3, abs=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_the_frame(axis):
    """x is towards the user, y to the right, z up: body A turns to the right, B leans forward, C lifts the tip."""
    arm = the("woodenhaptics-2015")
    before = kinematics.position(arm, (0.0, radians(20), radians(40)))
    after = kinematics.position(arm, shifted((0.0, radians(20), radians(40)), axis, 0.01))
    moved = [b - a for a, b in zip(before, after)]
    assert moved[(1, 0, 2)[axis]] > 1e-3
