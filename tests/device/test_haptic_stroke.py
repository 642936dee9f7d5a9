# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand presses and draws through an arm: what it feels is the column law, what it leaves is what it recorded.

The hand moves slowly, and its force is held against the law at the depth where it was, never at a time: so a machine
that is slow makes fewer points, not other ones.
"""

import copy
from math import hypot

import numpy as np
import pytest

from repousse.core import Regime, Stroke
from repousse.device.safety import RAMP_TIME, State

from .haptic_stroke import ARM, perform
from .haptic_tasks import LAW, column, groove

WITHIN = 0.05
FRESH = 0.005
"""Seconds of a model's age up to which the hand, at 20 mm/s, has moved less than a twentieth of a voxel since."""
UNDER_WAY = 5
"""Milliseconds within which a force is at the motors."""
ROUNDED = 0.002
"""Newtons that half a milliampere, the step of a report, is at the tip; for three motors, and an encoder's step."""
CLEAR = 1.0
"""Voxels from a kink of the law within which whole voxels show."""


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    return perform(column(), tmp_path_factory.mktemp("pressed"))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    return perform(groove(), tmp_path_factory.mktemp("drawn"))


@pytest.fixture(params=["pressed", "drawn"])
def performed(request):
    return request.getfixturevalue(request.param)


def seen_by(performance, who):
    trace = performance.told() if who == "the loop" else performance.given()
    if not len(trace.time):
        pytest.skip("the arm is within the loop's process here, and keeps no log")
    return trace


@pytest.mark.parametrize("who", ["the motors", "the loop"])
@pytest.mark.parametrize("row", list(LAW.expected))
def test_each_row_of_the_column_law_is_felt(pressed, who, row):
    trace = seen_by(pressed, who)
    found, expected = LAW.rows(pressed.task.depth(trace.place), trace.force[:, 2])[row]
    assert found == pytest.approx(expected, rel=WITHIN)


@pytest.mark.parametrize("who", ["the motors", "the loop"])
def test_the_force_is_that_of_the_law_at_every_depth(pressed, who):
    """But within a voxel of the end of unloading, where the law of a column of whole voxels has a tail."""
    trace = seen_by(pressed, who)
    fresh = np.array([seen.state.time for seen in pressed.moments if seen.state.model_age <= FRESH])
    near = np.abs(fresh[np.searchsorted(fresh, trace.time).clip(0, len(fresh) - 1)] - trace.time) <= FRESH
    depth, force = pressed.task.depth(trace.place), trace.force[:, 2]
    turn = int(depth.argmax())
    deepest = depth[turn]
    way_in = np.arange(len(depth)) < turn
    tail = ~way_in & (np.abs(deepest - depth - LAW.yield_depth) <= CLEAR)
    expected = np.where(way_in, LAW.pressed(depth), LAW.released(depth, deepest))
    compared = near & ~tail
    assert compared.sum() > 500
    assert np.abs(force - expected)[compared].max() <= WITHIN * LAW.plateau
    assert np.quantile(np.abs(force - expected)[compared], 0.9) <= 0.01 * LAW.plateau


def test_the_hand_feels_it_yield_and_harden(pressed):
    """The force goes on rising where the material has yielded, but at a smaller slope; then it rises no more."""
    trace = pressed.told()
    depth, force = pressed.task.depth(trace.place), trace.force[:, 2]
    turn = int(depth.argmax())

    def felt_at(wanted):
        return float(np.median(force[:turn][np.abs(depth[:turn] - wanted) <= 0.25]))

    half, at_yield, between, hard, end = map(felt_at, (1.8, 3.6, 10.0, 17.0, 25.0))
    elastic = (at_yield - half) / 1.8
    plastic = (hard - between) / 7.0
    assert 0.0 < plastic < 0.5 * elastic
    assert at_yield < between < hard < end
    assert end > 1.7 * at_yield
    order = [seen.regime for seen in pressed.moments]
    firsts = [order.index(regime) for regime in (Regime.NONE, Regime.ELASTIC, Regime.PLASTIC, Regime.UNLOADING)]
    assert firsts == sorted(firsts)


def test_the_material_pushes_straight_back(pressed):
    trace = pressed.told()
    assert np.abs(trace.force[:, :2]).max() <= WITHIN * LAW.plateau
    assert trace.force[:, 2].min() >= 0.0


def test_the_slope_is_told_in_the_arms_own_metres(pressed):
    """The loop is asked for E at the loose front, and for E / d0 where it is compacted."""
    asked = [seen.state.slope_asked for seen in pressed.moments if seen.state.slope_asked > 0.0]
    assert min(asked) == pytest.approx(LAW.elastic_slope * pressed.task.scale, rel=WITHIN)
    assert max(asked) == pytest.approx(LAW.stiffness * pressed.task.scale, rel=WITHIN)


def test_what_was_compacted_stands_ahead_of_the_punch(pressed):
    """(d0 delta - kappa D) / (1 - d0) of full material, at the deepest that was solved."""
    deepest = max(pressed.task.place[2] - sample.position[2] for sample in pressed.stroke.samples)
    expected = (LAW.density * deepest - LAW.yield_depth) / (1.0 - LAW.density)
    surface = pressed.before.shape[2] - 4
    profile = pressed.task.grid.density.mean(axis=(0, 1))[: int(surface - deepest)]
    compacted = (profile - LAW.density).sum() / (1.0 - LAW.density)
    assert compacted == pytest.approx(expected, rel=WITHIN)


def test_nothing_but_the_material_limits_the_force(performed):
    """The motors could do this for ever, and the loop grants the slope that the material asks for."""
    currents = np.abs(performed.told().currents)
    assert 0.1 < currents.max() <= ARM.continuous_current
    granted = [seen.state.slope_granted >= seen.state.slope_asked for seen in performed.moments]
    assert np.mean(granted) >= 0.95


def test_it_comes_on_softly(performed):
    """Above the material, where there is little to be felt, and in as long as it takes."""
    moments = performed.approach
    last = max(n for n, seen in enumerate(moments) if seen.state.ramp < 1.0)
    first = max(n for n, seen in enumerate(moments[: last + 1]) if seen.state.state is not State.RUN) + 1
    rising = moments[first : last + 1]
    assert rising[0].state.ramp < 0.5
    took = rising[-1].state.time - rising[0].state.time
    assert took >= 0.95 * RAMP_TIME * (rising[-1].state.ramp - rising[0].state.ramp)
    for seen in rising:  # the loop may have had the model before
        assert hypot(*seen.state.force) <= 1.05 * seen.state.ramp * seen.model.yield_stress + 0.02
    assert rising[-1].model.stress == 0.0


def test_the_motors_gave_what_the_loop_says(performed):
    """The arm's own log of currents, through its kinematics, against the loop's words just before."""
    motors, told = seen_by(performed, "the motors"), performed.told()
    largest = np.linalg.norm(told.force, axis=1).max()
    next_one = np.searchsorted(motors.time, told.time)
    entries = (next_one[:, None] + np.arange(UNDER_WAY)).clip(0, len(motors.time) - 1)
    apart = np.linalg.norm(motors.force[entries] - told.force[:, None], axis=2).min(axis=1)
    assert np.quantile(apart, 0.9) <= 0.01 * largest + ROUNDED


def test_the_sculpture_is_that_of_its_recording(performed, tmp_path):
    """Bit for bit, from the file."""
    performed.stroke.save(tmp_path / "stroke.jsonl")
    recorded = Stroke.load(tmp_path / "stroke.jsonl")
    grid = copy.deepcopy(performed.before)
    recorded.push(grid).follow(recorded)
    assert not np.array_equal(grid.density, performed.before.density)
    assert np.array_equal(grid.density, performed.task.grid.density)


def test_mass_stays(performed):
    after = performed.task.grid.mass + performed.mass_out
    assert after == pytest.approx(performed.before.mass, rel=1e-7)
    assert performed.mass_out == 0.0
    density = performed.task.grid.density
    assert density.min() >= 0.0 and density.max() <= 1.0


def test_the_groove_is_where_the_hand_drew_it(drawn):
    """As deep as the tool went there, all along, with a ridge on either side of it."""
    task, density = drawn.task, drawn.sculpted
    tips = np.array([sample.position for sample in drawn.stroke.samples])
    radius = task.stroke.tool.radius
    top = round(task.place[2] - radius + 0.5)  # the first empty voxels
    for along in (45, 55, 65):
        passing = np.abs(tips[:, 1] - along) <= 1.0
        depth = (task.place[2] - tips[passing, 2]).max()
        across = round(float(np.median(tips[passing, 0])))
        assert density[across, along, top:].max() < 0.01
        assert top - density[across, along, :top].sum() == pytest.approx(depth, abs=1.0)
        risen = density[:, along, top:].sum(axis=1)
        assert min(risen[:across].max(), risen[across:].max()) > 0.3


def test_the_hand_feels_the_clay_against_its_way(drawn):
    """All the way that it draws; how much of the force is upwards depends on how much clay it has before it."""
    trace, (_, y, _) = drawn.told(), ARM.workspace_centre
    drawing = np.abs(trace.place[:, 1] - y) <= 0.02
    drawing[trace.place[:, 1].argmax() :] = False  # by then it is on its way out
    assert drawing.sum() > 200
    force = trace.force[drawing]
    assert np.quantile(np.linalg.norm(force, axis=1), 0.05) > 0.1
    assert np.quantile(force[:, 1], 0.95) < -0.1
    assert np.quantile(force[:, 2], 0.05) > -0.02
    assert np.quantile(np.abs(force[:, 0]), 0.95) < 0.05
