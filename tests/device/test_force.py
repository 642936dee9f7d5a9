# SPDX-License-Identifier: GPL-3.0-or-later
"""What the hand feels of a local model: the law, its direction, and that neither age nor a stall makes it push."""

from dataclasses import replace
from itertools import pairwise
from math import cos, hypot, inf, isfinite, nan, pi, sin, sqrt

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from repousse.device import safety
from repousse.device.force import PLASTIC_FROM, REST_SPEED, Felt, felt_force, granted_slope, surface_known
from repousse.device.protocol import Coupling, ForceModel
from repousse.device.safety import Fault, Given, Motors, Seen, State, Status

from .test_safety import LIMITS, STEP, away_from_what_shrinks

ZERO = (0.0, 0.0, 0.0)
NOW = 20.0
UP = (0.0, 0.0, 1.0)
MODEL = ForceModel(NOW, (0.01, 0.02, 0.03), 1.0, 2.0, (0.0, 0.0, -300.0), UP, 1)
"""A surface that is pressed from above: 1 N here, 0.3 N more for each millimetre down, and it yields at 2 N."""
NOT_NUMBERS = [nan, inf, -inf]

lengths = st.floats(-0.05, 0.05)
positions = st.tuples(lengths, lengths, lengths)
slopes = st.tuples(*[st.floats(-3000.0, 3000.0)] * 3)
velocities = st.tuples(*[st.floats(-1.5, 1.5)] * 3)
ages = st.floats(0.0, 0.2)
models = st.builds(
    lambda stress, share, gradient, fading, damping, exponent: ForceModel(
        NOW, ZERO, stress, stress * share, gradient, outward(gradient, fading), 1, damping, exponent
    ),
    st.floats(0.0, 5.0),
    st.floats(0.0, 2.0),
    slopes,
    st.floats(0.0, 1.0),
    st.one_of(st.just(0.0), st.floats(0.0, 20.0)),
    st.one_of(st.just(1.0), st.floats(0.5, 1.5)),
)


def outward(gradient, length):
    steepness = hypot(*gradient)
    return tuple(-length * g / steepness for g in gradient) if steepness > 1e-6 else (0.0, 0.0, length)


def feel(model=MODEL, position=None, velocity=ZERO, age=0.001, limits=LIMITS, previous=None, coupling=Coupling.LOCAL):
    where = model.position if position is None and model is not None else position or ZERO
    return felt_force(model, previous, where, velocity, NOW + age, limits, coupling)


def below(depth, model=MODEL):
    """The position so many metres deeper than the model's."""
    x, y, z = model.position
    return x, y, z - depth


def dot(a, b):
    return sum(p * q for p, q in zip(a, b))


@pytest.mark.parametrize(
    ("depth", "force"),
    [(0.0, 1.0), (0.001, 1.3), (0.003, 1.9), (0.004, 2.0), (0.1, 2.0), (-0.001, 0.7), (-0.0034, 0.0), (-0.1, 0.0)],
)
def test_the_force_follows_the_tangent_between_nothing_and_the_yield_stress(depth, force):
    felt = feel(position=below(depth))
    assert felt.force == pytest.approx((0.0, 0.0, force), abs=1e-12)
    assert felt.magnitude == pytest.approx(force)
    assert (felt.asked, felt.granted, felt.fault) == (300.0, 300.0, Fault.NONE)


@given(positions, positions)
def test_only_the_way_along_the_gradient_counts(at, aside):
    """F = clamp(sigma + g . (x - x_k), 0, sigma_f) along the normal, in any direction of both."""
    gradient, normal = (120.0, -80.0, -200.0), (-0.48, 0.64, 0.6)
    model = MODEL._replace(position=at, gradient=gradient, normal=normal)
    where = tuple(a + b for a, b in zip(at, aside))
    force = min(max(1.0 + dot(gradient, aside), 0.0), 2.0)
    assert feel(model, where).force == pytest.approx([force * n for n in normal], abs=1e-9)


def test_what_is_not_there_is_not_felt():
    assert feel(None) == Felt()
    assert feel(MODEL._replace(scene=0)) == Felt()
    for how in ({"stress": -1.0}, {"yield_stress": 0.0}, {"yield_stress": -2.0}, {"normal": ZERO}):
        assert feel(MODEL._replace(**how), velocity=(0.0, 0.0, -1e-3)).force == pytest.approx(ZERO)
    assert feel(MODEL._replace(gradient=ZERO)).force == (0.0, 0.0, 1.0)


@pytest.mark.parametrize("number", NOT_NUMBERS)
def test_what_is_no_number_is_no_force_and_a_fault(number):
    """In any field of the model, and in any number from the arm."""
    nothing = Felt(fault=Fault.MODEL_NOT_FINITE)
    for name, value in MODEL._asdict().items():
        if isinstance(value, float):
            assert feel(MODEL._replace(**{name: number})) == nothing, name
        elif isinstance(value, tuple):
            for axis in range(3):
                wrong = tuple(number if i == axis else v for i, v in enumerate(value))
                assert feel(MODEL._replace(**{name: wrong}), MODEL.position) == nothing, name
    for axis in range(3):
        wrong = tuple(number if i == axis else 0.0 for i in range(3))
        assert feel(position=wrong) == nothing
        assert feel(velocity=wrong) == nothing
    assert feel(age=number) == nothing


@pytest.mark.parametrize("number", NOT_NUMBERS)
@pytest.mark.parametrize("field", ["time", "stress", "yield_stress"])
def test_a_former_model_that_is_no_number_does_not_count(number, field):
    wrong = MODEL._replace(**{"time": NOW - 0.01, "stress": 0.2, field: number})
    felt = feel(previous=wrong, coupling=Coupling.INTERPOLATE)
    assert all(map(isfinite, felt.force))
    assert 0.0 <= felt.magnitude <= 1.0


def test_numbers_that_overflow_are_no_force_either():
    felt = feel(MODEL._replace(gradient=(1e308, 1e308, 1e308)), (1e3, 1e3, 1e3))
    assert felt == Felt(fault=Fault.MODEL_NOT_FINITE)


@given(models, positions, velocities, ages, st.sampled_from(Coupling))
def test_no_force_is_greater_than_what_the_material_bears(model, position, velocity, age, coupling):
    """|F| <= sigma_f, and never negative, whatever the gradient, the speed and the damping."""
    felt = feel(model, position, velocity, age, previous=model._replace(time=NOW - 0.01), coupling=coupling)
    assert felt.fault is Fault.NONE
    assert 0.0 <= felt.magnitude <= max(model.yield_stress, 0.0) + 1e-12
    assert hypot(*felt.force) <= felt.magnitude * (1.0 + 1e-9)
    assert 0.0 <= felt.granted <= felt.asked


# Age and stalls


@given(models, positions, ages, ages)
def test_an_ageing_model_never_raises_the_force_of_an_arm_that_is_held(model, position, one, other):
    """|F| does not grow with age at a held pose, wherever that is, and its direction stays."""
    young, old = feel(model, position, age=min(one, other)), feel(model, position, age=max(one, other))
    assert hypot(*old.force) <= hypot(*young.force) + 1e-12
    assert dot(old.force, young.force) >= hypot(*old.force) * hypot(*young.force) - 1e-9


def running(force, speed=0.0):
    """A status long after an engagement, with a force."""
    seen = Seen(NOW, NOW, ZERO, speed)
    return Status(State.RUN, Fault.NONE, seen, Given(force, 1.0, 1, 1.0), Motors())


def settled(model, position, previous=None, coupling=Coupling.LOCAL):
    """What is given after a while with that model, always new, at that place."""
    status = running(ZERO)
    for _ in range(30):
        felt = feel(model, position, age=0.0, previous=previous, coupling=coupling)
        status = safety.rendered(status, LIMITS, NOW, 1e-3, NOW, 1, felt.force, felt.magnitude)
    return status


@given(models, positions)
def test_a_stall_of_blender_never_raises_the_force_of_an_arm_that_is_held(model, position):
    """From the last model on, period by period: the force only falls, and after 100 ms there is none."""
    status = settled(model, position)
    strengths = [hypot(*status.force)]
    for n in range(1, 120):
        now = NOW + n * 1e-3
        felt = felt_force(model, None, position, ZERO, now, LIMITS)
        status = safety.rendered(status, LIMITS, now, 1e-3, model.time, 1, felt.force, felt.magnitude)
        strengths.append(hypot(*status.force))
    assert all(later <= sooner + 1e-12 for sooner, later in pairwise(strengths))
    assert not any(strengths[101:])
    assert status.state is State.ARMED


@given(models, positions, st.floats(0.001, 0.09))
def test_a_stall_of_the_loop_never_raises_the_force_of_an_arm_that_is_held(model, position, stall):
    """The first period after it: no stronger than before, whether Blender stood still as well or not."""
    before = settled(model, position)
    for renewed in (model, model._replace(time=NOW + stall)):
        felt = felt_force(renewed, model, position, ZERO, NOW + stall, LIMITS)
        after = safety.rendered(before, LIMITS, NOW + stall, stall, renewed.time, 1, felt.force, felt.magnitude)
        assert hypot(*after.force) <= hypot(*before.force) + 1e-12


@given(models, positions, models, positions, velocities, st.floats(0.001, 0.09), st.sampled_from(Coupling))
def test_a_stall_in_which_arm_and_material_went_on_adds_what_a_period_may(
    model, position, other, elsewhere, velocity, stall, coupling
):
    """Whatever has become of both meanwhile."""
    before = settled(model, position, coupling=coupling)
    after = other._replace(time=NOW + stall)
    felt = felt_force(after, model, elsewhere, velocity, NOW + stall, LIMITS, coupling)
    status = safety.rendered(before, LIMITS, NOW + stall, stall, after.time, 1, felt.force, felt.magnitude)
    assert away_from_what_shrinks(status.force, before.force) <= STEP + 1e-9
    assert hypot(*status.force) <= hypot(*before.force) + STEP + 1e-9


@settings(max_examples=60)
@given(
    st.floats(0.0, 3.0),
    st.floats(0.1, 2.0),
    st.floats(100.0, 3000.0),
    st.lists(st.tuples(st.floats(-0.004, 0.004), st.floats(0.0, 0.02)), min_size=1, max_size=6),
    st.sampled_from([1.0, 0.5, 0.75, 1.5]),
)
def test_an_ageing_model_never_gives_energy_to_the_hand(stress, share, slope, turns, exponent):
    """Along any path from outside the material and back there, at any pace: the work on the hand is not positive."""
    model = ForceModel(NOW, ZERO, stress, stress * share, (0.0, 0.0, -slope), UP, 1, exponent=exponent)
    outside = stress / slope
    legs = pairwise([(outside, 0.0), *turns, (outside, 0.001)])
    work = error = began = 0.0
    steps = 50
    for (start, _), (end, time) in legs:
        step = (end - start) / steps
        for n in range(steps):
            middle = (n + 0.5) / steps
            work += step * feel(model, (0.0, 0.0, start + (end - start) * middle), age=began + time * middle).force[2]
        began += time
        error += slope / min(exponent, 1.0) * step * step
    assert work <= error + 1e-12


# Stiffness


def test_a_device_is_never_stiffer_than_its_profile_allows():
    """A slope over 800 N/m softens the whole force: both what was there and what is added to it."""
    model = MODEL._replace(gradient=(0.0, 0.0, -1600.0), yield_stress=6.0)
    here, deeper = feel(model), feel(model, below(0.001))
    assert (here.asked, here.granted) == (1600.0, 800.0)
    assert here.magnitude == pytest.approx(0.5)
    assert deeper.magnitude - here.magnitude == pytest.approx(800.0 * 0.001)
    assert feel(model, below(1.0)).magnitude == pytest.approx(3.0)


def test_what_is_granted_is_what_the_loop_renders_stably_however_old_the_model_is():
    """b > K T/2, the profile's own stiffness, and no slope that is asked for is made steeper."""
    assert granted_slope(1e9, LIMITS) == 800.0
    assert granted_slope(1e9, replace(LIMITS, damping=0.3)) == pytest.approx(600.0)
    assert granted_slope(1e9, replace(LIMITS, period=0.01)) == pytest.approx(301.0)
    assert granted_slope(30.0, LIMITS) == 30.0
    steep = MODEL._replace(gradient=(0.0, 0.0, -1600.0))
    assert {feel(steep, age=age).granted for age in (0.0, 0.001, 0.02, 0.08)} == {800.0}
    assert len({feel(steep, below(0.0005), age=age).magnitude for age in (0.0, 0.001, 0.02, 0.08)}) == 1


def powered(depth, stiffness, exponent):
    """Stress (N) and slope (N/m) of 3.3 N (stiffness depth / 3.3 N)^exponent: of a wall where that is 1."""
    if depth <= 0.0:
        return 0.0, 0.0
    stress = 3.3 * (stiffness * depth / 3.3) ** exponent
    return stress, exponent * stress / depth


@pytest.mark.parametrize("exponent", [0.5, 0.75, 1.0])
@pytest.mark.parametrize("depth", [1e-4, 4e-4, 1e-3])
def test_softened_a_power_is_a_wall_of_the_slope_granted_wherever_its_model_was_made(exponent, depth):
    stress, slope = powered(depth, 1500.0, exponent)
    model = ForceModel(NOW, (0.0, 0.0, -depth), stress, 1e3, (0.0, 0.0, -slope), UP, 1, exponent=exponent)
    here = feel(model)
    assert here.asked == pytest.approx(stress / depth) and here.granted == 800.0
    for there in (0.2 * depth, depth, 1.05 * depth):
        assert feel(model, (0.0, 0.0, -there)).magnitude == pytest.approx(800.0 * there)


def test_where_it_is_not_softened_a_power_is_its_tangent_on_the_way_in_and_less_on_the_way_out():
    stress, slope = powered(0.004, 100.0, 0.5)
    model = ForceModel(NOW, (0.0, 0.0, -0.004), stress, 1e3, (0.0, 0.0, -slope), UP, 1, exponent=0.5)
    here, deeper, out = (feel(model, (0.0, 0.0, -depth)) for depth in (0.004, 0.005, 0.003))
    assert here.asked == here.granted == pytest.approx(2.0 * slope) and here.magnitude == pytest.approx(stress)
    assert deeper.magnitude == pytest.approx(stress + slope * 0.001)
    assert out.magnitude == pytest.approx(stress - 2.0 * slope * 0.001)
    assert out.magnitude < powered(0.003, 100.0, 0.5)[0]


@pytest.mark.parametrize("exponent", [-1e300, -1.0, 0.0, 1e-300, 2.0, 1e300])
def test_an_exponent_that_is_none_makes_no_force_greater(exponent):
    for depth in (-0.001, 0.0, 0.001):
        told = feel(MODEL._replace(exponent=exponent), below(depth))
        assert told.fault is Fault.NONE and 0.0 <= told.magnitude <= feel(position=below(depth)).magnitude


def shaking(stiffness, model_period, latency, coupling, limits=LIMITS, exponent=1.0):
    """How far (m, peak to peak) the hand still moves after 2.5 s of pressing 2 N against a wall.

    45 g of arm and a hand with a soft grip (0.1 kg, 1.5 N s/m, 200 N/m), no friction, no encoder steps; a model each
    ``model_period`` that arrives ``latency`` milliseconds late.
    """
    mass, damping, grip, parts = 0.145, 1.505, 200.0, 10
    z = speed = taken = 0.0
    goal = -2.0 / grip - 2.0 / min(stiffness, 800.0)
    model = previous = surface = None
    under_way, places = [], []
    for tick in range(3000):
        now = tick * 1e-3
        if tick % model_period == 0:
            stress, slope = powered(-z, stiffness, exponent)
            made = ForceModel(now, (0.0, 0.0, z), stress, 1e3, (0.0, 0.0, -slope), UP, 1, exponent=exponent)
            under_way.append((tick + latency, made))
        while under_way and under_way[0][0] <= tick:
            previous, model, taken = model, under_way.pop(0)[1], now
            surface = surface_known(model, surface)
        followed = surface if coupling is Coupling.LOCAL else model
        felt = felt_force(followed, previous, (0.0, 0.0, z), (0.0, 0.0, speed), now, limits, coupling, taken)
        for _ in range(parts):
            speed += (felt.force[2] - damping * speed - grip * (z - goal)) / mass * 1e-3 / parts
            z += speed * 1e-3 / parts
        places.append(z)
    return max(places[-500:]) - min(places[-500:])


ENCODER_STEP = 23e-6
"""Metres: the finest of the arms here."""


@pytest.mark.parametrize(("model_period", "latency"), [(1, 1), (5, 5), (10, 10), (20, 20), (33, 33)])
@pytest.mark.parametrize("stiffness", [300.0, 800.0, 1500.0, 3000.0])
def test_a_hand_that_presses_a_wall_comes_to_rest(stiffness, model_period, latency):
    """However stiff the wall, and with models up to 66 ms old: less than an encoder step of movement is left."""
    assert shaking(stiffness, model_period, latency, Coupling.LOCAL) < ENCODER_STEP


@pytest.mark.parametrize(("model_period", "latency"), [(1, 1), (5, 5)])
@pytest.mark.parametrize("stiffness", [150.0, 300.0, 1500.0])
@pytest.mark.parametrize("exponent", [0.5, 0.75])
def test_a_hand_that_presses_what_is_steepest_at_first_touch_comes_to_rest(stiffness, model_period, latency, exponent):
    assert shaking(stiffness, model_period, latency, Coupling.LOCAL, exponent=exponent) < ENCODER_STEP


@pytest.mark.parametrize(("stiffness", "model_period", "latency"), [(800.0, 1, 1), (500.0, 2, 2), (300.0, 5, 1)])
def test_interpolation_shakes_where_the_tangent_is_at_rest(stiffness, model_period, latency):
    """The paper's coupling is later by a model's period: that is what it is compared for."""
    assert shaking(stiffness, model_period, latency, Coupling.INTERPOLATE) > 10 * ENCODER_STEP
    assert shaking(stiffness, model_period, latency, Coupling.LOCAL) < ENCODER_STEP


# What is followed where a model feels nothing

OUTSIDE = MODEL._replace(time=NOW + 0.01, position=(0.01, 0.02, 0.034), stress=0.0, gradient=ZERO)
"""Half a millimetre and a bit above where MODEL's tangent ends."""


def test_a_tip_that_has_left_a_surface_meets_it_again_where_it_was():
    """The last surface is followed until a model contradicts it: felt where it is, and nothing where it is not."""
    known = surface_known(OUTSIDE, MODEL)
    assert known == MODEL._replace(time=OUTSIDE.time)
    assert feel(known, OUTSIDE.position, age=0.02).force == ZERO
    assert feel(known, below(0.001), age=0.02).force == pytest.approx((0.0, 0.0, 1.3))
    assert feel(OUTSIDE, below(0.001), age=0.02).force == ZERO


@pytest.mark.parametrize(
    "model",
    [
        MODEL._replace(stress=0.3),  # it is felt itself
        OUTSIDE._replace(scene=2),  # all has changed
        OUTSIDE._replace(position=MODEL.position),  # here it should be felt, were it there
    ],
)
def test_a_surface_is_forgotten_for_one_that_is_felt_in_another_scene_and_where_it_is_gone(model):
    assert surface_known(model, MODEL) is model
    assert surface_known(model, None) is model


@pytest.mark.parametrize("number", NOT_NUMBERS)
def test_no_known_surface_hides_what_is_no_number(number):
    for name, value in OUTSIDE._asdict().items():
        if isinstance(value, float):
            wrong = [OUTSIDE._replace(**{name: number})]
        elif isinstance(value, tuple):
            wrong = [
                OUTSIDE._replace(**{name: tuple(number if i == a else v for i, v in enumerate(value))})
                for a in range(3)
            ]
        else:
            continue
        for model in wrong:
            if model.stress == -inf:
                continue  # nothing is there, whatever else it says
            assert feel(surface_known(model, MODEL)).fault is Fault.MODEL_NOT_FINITE, name


# Direction

FLOWING = MODEL._replace(stress=2.0)
"""Its stress is the yield stress."""


@given(st.floats(0.0, 2.0 * pi), st.floats(-1.0, 1.0), st.floats(0.0, 1.5))
def test_in_plastic_flow_the_force_leans_against_the_motion_and_keeps_its_strength(around, rise, speed):
    """Never to the other side of the surface, and as a drag never above the device's highest damping."""
    flat = sqrt(1.0 - rise * rise)
    velocity = (speed * flat * cos(around), speed * flat * sin(around), speed * rise)
    felt = feel(FLOWING, velocity=velocity)
    drag = hypot(felt.force[0], felt.force[1])
    assert hypot(*felt.force) == pytest.approx(2.0)
    assert felt.force[2] >= -1e-12
    assert dot(felt.force[:2], velocity[:2]) <= 1e-12
    assert drag <= LIMITS.max_damping * max(speed - REST_SPEED, 0.0) * flat + 1e-9
    if 0.02 < speed < 0.2 and flat > 0.1:
        assert drag == pytest.approx(LIMITS.max_damping * (speed - REST_SPEED) * flat)


def test_a_fast_push_is_opposed_by_all_of_the_force():
    """The paper's "opposed to motion", where the arm is fast enough for that to mean something."""
    felt = feel(FLOWING, velocity=(0.6, 0.0, -0.8))
    assert felt.force == pytest.approx((-1.2, 0.0, 1.6))
    assert feel(FLOWING, velocity=(0.0, 0.0, -1.0)).force == pytest.approx((0.0, 0.0, 2.0))
    assert feel(FLOWING, velocity=(0.0, 0.0, 1.0)).force == pytest.approx((0.0, 0.0, 2.0))


@given(st.tuples(*[st.floats(-REST_SPEED / 2, REST_SPEED / 2)] * 3))
def test_at_rest_the_force_is_along_the_normal(velocity):
    """What the encoders make of standing still has no direction."""
    assert feel(FLOWING, velocity=velocity).force == (0.0, 0.0, 2.0)


def test_a_motion_that_turns_round_turns_the_force_without_a_step():
    """Through rest and back: for each 1 mm/s no more than the device's highest damping gives."""
    forces = [feel(FLOWING, velocity=(n * 1e-3, 0.0, 0.0)).force[0] for n in range(-100, 101)]
    changes = [b - a for a, b in pairwise(forces)]
    assert min(changes) >= -LIMITS.max_damping * 1e-3 - 1e-12
    assert max(changes) <= 1e-12
    assert forces[0] == pytest.approx(-forces[-1])
    assert forces[0] > 0.7


def test_elastic_material_does_not_drag_and_the_lean_begins_without_a_step():
    sideways = (0.1, 0.0, 0.0)
    most = LIMITS.max_damping * (0.1 - REST_SPEED)
    for share, part in ((0.2, 0.0), (PLASTIC_FROM, 0.0), (0.95, 0.5), (1.0, 1.0), (1.5, 1.0)):
        felt = feel(MODEL._replace(stress=2.0 * share), velocity=sideways)
        assert felt.force[0] == pytest.approx(-part * most)
        assert hypot(*felt.force) == pytest.approx(min(2.0 * share, 2.0))


def test_the_lean_asks_for_stress_here_not_for_that_of_the_model():
    sideways = (0.1, 0.0, 0.0)
    assert feel(position=below(0.004), velocity=sideways).force[0] < 0.0
    assert feel(FLOWING, below(-0.002), velocity=sideways).force[0] == 0.0


def test_where_there_is_no_outside_there_is_only_drag():
    """In uniform surroundings the normal fades: the force fades with it at rest, and opposes the motion otherwise."""
    inside = FLOWING._replace(gradient=ZERO, normal=ZERO)
    assert feel(inside).force == ZERO
    assert feel(inside, velocity=(1.0, 0.0, 0.0)).force == pytest.approx((-2.0, 0.0, 0.0))
    slow = feel(inside, velocity=(0.0, -0.05, 0.0)).force
    assert slow == pytest.approx((0.0, LIMITS.max_damping * (0.05 - REST_SPEED), 0.0))
    half = FLOWING._replace(normal=(0.0, 0.0, 0.5))
    assert feel(half).force == pytest.approx((0.0, 0.0, 1.0))
    assert feel(half, velocity=(0.0, 0.0, -1.0)).force == pytest.approx((0.0, 0.0, 2.0))


@given(models, positions, velocities, ages)
def test_a_force_never_pulls_into_the_material(model, position, velocity, age):
    """Where the normal is sure."""
    assume(hypot(*model.normal) > 1e-3)
    unit = tuple(n / hypot(*model.normal) for n in model.normal)
    felt = feel(model._replace(normal=unit), position, velocity, age)
    assert dot(felt.force, unit) >= -1e-9


def test_a_normal_that_is_too_long_makes_no_force_greater():
    assert feel(MODEL._replace(normal=(0.0, 0.0, 50.0))).force == pytest.approx((0.0, 0.0, 1.0))
    fast = feel(FLOWING._replace(normal=(30.0, 0.0, 40.0)), velocity=(0.0, -1.0, 0.0))
    assert hypot(*fast.force) == pytest.approx(2.0)


# Damping


@given(st.floats(-1.5, 1.5), st.floats(0.0, 50.0), st.floats(0.0, 2.5))
def test_damping_only_ever_takes_energy(speed, damping, stress):
    """Against the motion along the normal, within the device's own bound, at most the force again, never a pull."""
    plain = MODEL._replace(stress=stress, gradient=ZERO)
    damped = plain._replace(damping=damping)
    velocity = (0.0, 0.0, speed)
    added = feel(damped, velocity=velocity).force[2] - feel(plain, velocity=velocity).force[2]
    elastic = min(stress, 2.0)
    assert added * speed <= 1e-12
    assert abs(added) <= min(min(damping, LIMITS.max_damping) * abs(speed), elastic) + 1e-12
    assert elastic + added <= 2.0 + 1e-12


def test_damping_is_what_it_says_and_none_out_of_contact():
    damped = MODEL._replace(damping=4.0)
    assert feel(damped, velocity=(0.3, 0.0, -0.1)).force == pytest.approx((0.0, 0.0, 1.4))
    assert feel(damped, velocity=(0.3, 0.0, 0.1)).force == pytest.approx((0.0, 0.0, 0.6))
    assert feel(damped, below(-0.01), velocity=(0.0, 0.0, -1.0)).force == ZERO
    assert feel(damped._replace(damping=-4.0), velocity=(0.0, 0.0, -0.1)).force == pytest.approx((0.0, 0.0, 1.0))


# The paper's coupling


def test_interpolation_goes_from_the_last_estimate_but_one_to_the_last():
    """In the time that was between them, and then stays; where the arm is does not count."""
    former = MODEL._replace(time=NOW - 0.02, stress=0.2)
    for age, force in ((-0.001, 0.2), (0.0, 0.2), (0.005, 0.4), (0.01, 0.6), (0.02, 1.0), (0.04, 1.0)):
        felt = feel(position=below(0.003), age=age, previous=former, coupling=Coupling.INTERPOLATE)
        assert felt.force == pytest.approx((0.0, 0.0, force))
        assert (felt.asked, felt.granted) == (300.0, 0.0)


def test_interpolation_takes_each_estimate_as_it_was_felt():
    """min(sigma, sigma_f) of each; without a former one in the same scene, or with one of no earlier time, the last."""
    over = MODEL._replace(time=NOW - 0.02, stress=9.0, yield_stress=0.5)
    halfway = {"age": 0.01, "coupling": Coupling.INTERPOLATE}
    assert feel(previous=over, **halfway).magnitude == pytest.approx(0.75)
    for former in (None, over._replace(scene=2), over._replace(time=NOW), over._replace(time=NOW + 1.0)):
        assert feel(previous=former, **halfway).magnitude == pytest.approx(1.0)


# The normal turns


TURNING = MODEL._replace(turning_x=(-40.0, 0.0, 0.0), turning_y=(0.0, -40.0, 0.0))
"""In a pit: aside, the normal points back by 0.04 for each millimetre."""


def aside(way, model=TURNING):
    x, y, z = model.position
    return x + way, y, z


def test_aside_the_normal_points_back():
    felt = feel(TURNING, aside(0.002)).force
    assert felt[0] / felt[2] == pytest.approx(-0.08) and felt[1] == 0.0
    assert hypot(*felt) == pytest.approx(1.0)  # as strong as it was
    assert feel(TURNING).force == feel(MODEL).force


@given(st.floats(-0.05, 0.05), st.floats(0.0, 1e6))
def test_turning_is_no_steeper_than_the_loop_can_render(way, steepness):
    """However sharp the edge, and never over to the other side of the surface."""
    model = TURNING._replace(turning_x=(-steepness, 0.0, 0.0), turning_y=ZERO)
    x, _, z = feel(model, aside(way, model)).force
    assert abs(x) <= granted_slope(inf, LIMITS) * abs(way) + 1e-9
    assert z >= 0.0 and x * way <= 0.0


def test_a_held_force_does_not_turn():
    assert feel(TURNING._replace(gradient=ZERO), aside(0.002)).force == (0.0, 0.0, 1.0)
