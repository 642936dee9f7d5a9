# SPDX-License-Identifier: GPL-3.0-or-later
"""The arm's mechanics are those of rigid bodies, with friction that really sticks.

What the plant is held against is written anew here: the mass matrix as profile.EmulatedPlant states it, Lagrange's
equations by numerical derivatives, and the tip's position of kinematics.py.
"""

from dataclasses import replace
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.device import kinematics
from repousse.device.plant import LONGEST_STEP, Plant, rubbed
from repousse.device.profile import builtin_profiles

PREMIUM = builtin_profiles()["phantom-premium-1.5"]
ZERO = (0.0, 0.0, 0.0)
STILL = (ZERO, ZERO)
COULOMB = np.array(PREMIUM.emulated.coulomb)

# Well inside of the Premium's limits, difference of the elbow included.
poses = st.tuples(st.floats(-0.8, 0.8), st.floats(1.2, 1.9), st.floats(-0.3, 0.4))
rates = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


def without_friction(gravity=(0.0, 0.0)):
    return replace(PREMIUM, emulated=replace(PREMIUM.emulated, viscous=ZERO, coulomb=ZERO, gravity=gravity))


def at(plant, angles, rates=ZERO):
    plant.angles, plant.rates = angles, rates
    return plant


def mass_matrix(angles, mass=0.0):
    """As profile.EmulatedPlant describes it, with a point mass at the tip by its Jacobian."""
    _, b, c = angles
    plant = PREMIUM.emulated
    yaw = plant.base_inertia + plant.yaw_inertia[0] * sin(b) ** 2 + plant.yaw_inertia[1] * sin(c) ** 2
    matrix = np.diag([yaw + 2 * plant.coupling * sin(b) * sin(c), *plant.link_inertia])
    matrix[1, 2] = matrix[2, 1] = plant.coupling * cos(b + c)
    matrix += np.diag([plant.rotor_inertia * turns**2 for turns in (13.3, 11.2, 11.2)])
    jacobian = np.array(kinematics.jacobian(PREMIUM, angles))
    return matrix + mass * jacobian.T @ jacobian


def lagrange(angles, rates, accelerations, mass, gravity):
    """Torques that Lagrange's equations ask for."""
    q, w = np.array(angles), np.array(rates)
    step = 1e-5
    by = []
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = step
        by.append((mass_matrix(q + shift, mass) - mass_matrix(q - shift, mass)) / (2 * step))
    changing = sum(matrix * rate for matrix, rate in zip(by, w))
    kinetic = np.array([0.5 * w @ matrix @ w for matrix in by])
    potential = np.array([0.0, -gravity[0] * sin(q[1]), gravity[1] * sin(q[2])])
    return mass_matrix(q, mass) @ accelerations + changing @ w - kinetic + potential


@given(poses, rates, st.floats(0.0, 0.3), st.tuples(*[st.floats(-0.3, 0.3)] * 3))
def test_its_accelerations_are_lagranges(angles, rates, mass, torques):
    gravity = (0.1, -0.05)
    plant = at(Plant(without_friction(gravity), mass), angles, rates)
    step = 1e-7
    plant.step(step, torques)
    accelerations = (np.array(plant.rates) - rates) / step
    wanted = lagrange(angles, rates, accelerations, mass, gravity)
    assert np.allclose(wanted, torques, rtol=0, atol=1e-4)


@pytest.mark.parametrize("mass", [0.0, 0.1])
@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, -0.5, 0.62)])
def test_a_blow_at_the_tip_meets_the_apparent_mass(mass, direction):
    angles = (0.3, 1.4, 0.2)
    plant = at(Plant(without_friction(), mass), angles)
    force = np.array(direction) * 2.0
    torques = kinematics.joint_torques(PREMIUM, angles, tuple(force))
    plant.step(1e-5, torques)
    jacobian = np.array(kinematics.jacobian(PREMIUM, angles))
    apparent = np.linalg.inv(jacobian @ np.linalg.inv(mass_matrix(angles, mass)) @ jacobian.T)
    momentum = apparent @ plant.velocity()
    assert np.allclose(momentum, force * 1e-5, rtol=1e-4, atol=1e-10)


def test_the_arm_alone_feels_as_heavy_as_the_published_ones():
    # 45 g of the Omni and the Desktop to 75 g of the first PHANToM, and this one is larger.
    jacobian = np.array(kinematics.jacobian(PREMIUM, (0.0, pi / 2, 0.0)))
    apparent = np.linalg.inv(jacobian @ np.linalg.inv(mass_matrix((0.0, pi / 2, 0.0))) @ jacobian.T)
    assert all(0.03 < mass < 0.15 for mass in np.diag(apparent))


@given(poses, rates)
def test_without_friction_energy_and_angular_momentum_stay(angles, rates):
    plant = at(Plant(without_friction(), 0.1), angles, tuple(rate / 10 for rate in rates))
    energy, momentum = plant.kinetic_energy(), mass_matrix(angles, 0.1)[0, 0] * plant.rates[0]
    for _ in range(200):
        plant.step(1e-3, ZERO)
    assert plant.kinetic_energy() == pytest.approx(energy, rel=1e-4, abs=1e-12)
    assert mass_matrix(plant.angles, 0.1)[0, 0] * plant.rates[0] == pytest.approx(momentum, rel=1e-4, abs=1e-9)


def test_gravity_is_paid_back():
    gravity = (0.05, -0.08)
    plant = at(Plant(without_friction(gravity)), (0.0, 1.5, 0.1))

    def energy():
        _, b, c = plant.angles
        return plant.kinetic_energy() + gravity[0] * cos(b) - gravity[1] * cos(c)

    start, most = energy(), 0.0
    for _ in range(150):
        plant.step(1e-3, ZERO)
        most = max(most, plant.kinetic_energy())
    assert most > 0.005
    assert energy() == pytest.approx(start, abs=1e-4 * most)


@pytest.mark.parametrize("grip", [(0.10, 1.5, 200.0), (0.15, 4.5, 500.0)], ids=["soft", "firm"])
def test_what_a_hand_brings_in_goes_into_friction_alone(grip):
    """A hand that holds still, 2 cm away: its spring's energy ends as heat in its damper and the arm's friction."""
    mass, damping, stiffness = grip
    plant = at(Plant(PREMIUM, mass, damping, stiffness), (0.3, 1.5, 0.1))
    goal = tuple(np.add(plant.position(), (0.012, 0.01, -0.013)))

    def energy():
        way = np.subtract(goal, plant.position())
        return plant.kinetic_energy() + 0.5 * stiffness * way @ way

    start, heat = energy(), 0.0
    for _ in range(4000):
        angles, rates, velocity = np.array(plant.angles), np.array(plant.rates), np.array(plant.velocity())
        plant.step(LONGEST_STEP, ZERO, lambda _: (goal, ZERO))
        turned = plant.angles - angles
        rate = (rates + plant.rates) / 2
        speed = (velocity + plant.velocity()) / 2
        heat += 0.0005 * rate @ rate * LONGEST_STEP + damping * speed @ speed * LONGEST_STEP - turned @ plant.friction
        assert turned @ plant.friction <= 1e-9  # friction gives nothing back, but for the step in which a joint stops
    assert plant.rates == ZERO
    assert energy() + heat == pytest.approx(start, rel=2e-3)
    # It stops where friction holds what is left of the spring's pull, not where the spring is slack.
    held = kinematics.joint_torques(PREMIUM, plant.angles, plant.hand_force)
    assert np.all(np.abs(held) <= COULOMB * 1.000001)


@pytest.mark.parametrize("share, moves", [(0.99, False), (1.02, True)])
@pytest.mark.parametrize("joint", [0, 1, 2])
def test_below_its_coulomb_torque_a_joint_does_not_move_at_all(joint, share, moves):
    plant = at(Plant(PREMIUM, 0.1), (0.3, 1.5, 0.1))
    start = plant.angles
    torques = [0.0, 0.0, 0.0]
    torques[joint] = share * COULOMB[joint]
    for _ in range(1000):
        plant.step(1e-3, tuple(torques))
    assert (plant.angles[joint] != start[joint]) == moves
    if not moves:
        assert plant.angles == start


@given(st.tuples(*[st.floats(-0.01, 0.01)] * 3), poses)
def test_friction_opposes_each_joint_or_stops_it(free, angles):
    """Coulomb's law for three joints, two of them coupled: each is at rest, or has all of its torque against it."""
    matrix = mass_matrix(angles, 0.1)
    masses = (matrix[0, 0], matrix[1, 1], matrix[2, 2], matrix[1, 2])
    friction, after = rubbed(LONGEST_STEP, free, masses, tuple(COULOMB))
    assert np.allclose(matrix @ (np.array(after) - free), np.array(friction) * LONGEST_STEP, rtol=0, atol=1e-12)
    for torque, rate, most in zip(friction, after, COULOMB):
        assert abs(torque) <= most
        assert rate == 0.0 or (abs(torque) == most and torque * rate < 0.0)


def test_a_constant_force_of_the_motors_moves_a_spring_by_hookes_law():
    plant = at(Plant(without_friction(), 0.1, 4.0, 400.0), (0.2, 1.5, 0.1))
    goal = plant.position()
    force = (0.5, -0.8, 1.1)
    for _ in range(3000):
        torques = kinematics.motor_torques(PREMIUM, kinematics.currents(PREMIUM, plant.angles, force))
        plant.step(1e-3, torques, lambda _: (goal, ZERO))
    assert np.allclose(np.subtract(plant.position(), goal) * 400.0, force, rtol=0, atol=1e-6)
    assert np.allclose(plant.hand_force, np.negative(force), rtol=0, atol=1e-6)


def test_the_error_goes_with_the_square_of_the_step(monkeypatch):
    def end(step):
        monkeypatch.setattr("repousse.device.plant.LONGEST_STEP", step)
        plant = at(Plant(without_friction(), 0.15, 4.5, 500.0), (0.3, 1.5, 0.1), (0.5, -0.3, 0.4))
        goal = tuple(np.add(plant.position(), (0.01, 0.01, 0.01)))
        plant.step(0.05, ZERO, lambda _: (goal, ZERO))
        return np.array(plant.position())

    exact = end(1e-5)
    coarse, fine = np.linalg.norm(end(1e-3) - exact), np.linalg.norm(end(5e-4) - exact)
    assert fine < 5e-6  # metres: an encoder step is five times that
    assert 3.0 < coarse / fine < 5.0


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, 0, -1), (1, 0, 1), (-1, 0, 1)])
def test_the_ends_of_its_joints_stop_it(direction):
    plant = Plant(PREMIUM, 0.1, 2.0, 0.0)
    force = tuple(5.0 * axis for axis in direction)
    for _ in range(3000):
        plant.step(1e-3, kinematics.joint_torques(PREMIUM, plant.angles, force), lambda _: STILL)
    assert kinematics.beyond_limits(PREMIUM, plant.angles) < 0.15
    assert np.linalg.norm(plant.velocity()) < 1e-3


def test_an_arm_of_unknown_masses_is_refused():
    with pytest.raises(ValueError, match="cannot be emulated"):
        Plant(builtin_profiles()["woodenhaptics-2015"])
