# SPDX-License-Identifier: GPL-3.0-or-later
"""The couplings at work: the default is at rest over a reduced map, on walls and on the material; what it was before is
not; and what a guard is for."""

import numpy as np
import pytest

from tests.bench.stability import material
from tests.bench.stability.arm import OneAxis
from tests.bench.stability.cells import Cell, all_cells, press
from tests.bench.stability.collision import Collision, Timing
from tests.bench.stability.couplings import Coupling, Passivity
from tests.bench.stability.naive import BoundByAge, WithoutMemory
from tests.bench.stability.pictures import FAILURE
from tests.bench.stability.scenes import DEVICES, HANDS, MS, at_block, at_wall
from tests.bench.stability.worlds import ForceModel

TOUCH, OMNI, DESKTOP = DEVICES

REDUCED = all_cells([Coupling.LOCAL], ["none"], [1.0, 16.7, 33.0], [0.0, 1.0], [0.5])


@pytest.mark.parametrize("period", [1.0, 16.7, 33.0])
@pytest.mark.parametrize("hand", HANDS)
def test_the_default_is_at_rest_over_the_map_with_all_the_stiffness_that_is_asked_for(hand, period):
    """Less than one encoder step of movement after two seconds, all of the slope granted, and no click: no force rises
    faster than safety lets it."""
    for cell in REDUCED:
        if (cell.hand, cell.collision_ms) == (hand, period):
            trace = press(cell, ideal=True)
            assert trace.peak_to_peak(2.0) < cell.device.mechanics.encoder, cell
            assert trace.granted(0.0) == 1.0, cell
            assert trace.max_slew < 1.5 * cell.device.limits.max_slew * 1e-3, cell
            assert trace.force[-1, 2] == pytest.approx(1.5, rel=0.02), cell


def test_with_friction_and_encoder_steps_it_stands_still():
    for device in DEVICES:
        cell = Cell("local", "none", 20.0, 20.0, 10.0, "soft", device.stiffness)
        assert press(cell, ideal=False).peak_to_peak(2.0) < 0.02 * device.mechanics.encoder


def test_a_slope_that_is_bounded_by_the_age_of_its_model_shakes_the_hand():
    """It sags and comes back with each model: the force of a hand that does not even move."""
    for coupled, at_least in ((BoundByAge, 50.0), (WithoutMemory, 50.0)):
        trace = at_wall(OMNI, HANDS["soft"], FAILURE, Coupling.LOCAL, coupled=coupled).run(2.5)
        assert trace.peak_to_peak(2.0) > at_least * OMNI.mechanics.encoder, coupled
    trace = at_wall(OMNI, HANDS["soft"], FAILURE, Coupling.LOCAL).run(2.5)
    assert trace.peak_to_peak(2.0) < 0.1 * OMNI.mechanics.encoder


def test_a_bound_by_age_shakes_a_hand_that_never_leaves_the_wall():
    """500 N/m and models up to 40 ms old: the force itself swings, whatever the hand does."""
    timing = Timing(20.0 * MS, 20.0 * MS)
    for coupled, shakes in ((BoundByAge, True), (None, False)):
        how = {"coupled": coupled} if coupled else {}
        loop = at_wall(OMNI, HANDS["firm"], timing, Coupling.LOCAL, stiffness=500.0, **how)
        trace = loop.run(2.5)
        late = trace.force[2000:, 2]
        assert late.min() > 0.5
        assert np.ptp(late) > 0.3 if shakes else np.ptp(late) < 0.01


@pytest.mark.parametrize("spot", [spot for spot in material.SPOTS if spot.hand == "soft" and spot.coupling == "local"])
def test_a_hand_that_presses_into_the_material_comes_to_rest(spot):
    """The real core, as steep as the arm can render, by models late by a period; the arm in software included."""
    trace, _ = material.press(spot)
    assert trace.peak_to_peak(material.SETTLED) < material.encoder(spot.arm)


def test_the_papers_coupling_shakes_a_hand_in_the_material_as_well():
    spot = next(spot for spot in material.SPOTS if spot.coupling == "interpolate" and spot.hand == "soft")
    trace, _ = material.press(spot)
    assert trace.peak_to_peak(material.SETTLED) > 100.0 * DESKTOP.mechanics.encoder


# Guard


@pytest.mark.parametrize("coupling", ["hold", "interpolate", "local", "in_loop"])
@pytest.mark.parametrize("device", DEVICES, ids=lambda device: device.name)
def test_with_a_guard_the_hand_gets_back_no_more_than_it_gave(coupling, device):
    """Energy at the port never below -1 mJ, by models up to 10 ms old; and without one, for what shakes, far below."""
    guarded = Cell(coupling, "passivity", 5.0, 5.0, 0.0, "soft", device.stiffness)
    assert press(guarded, ideal=True).lowest_energy > -1e-3
    if coupling in ("hold", "interpolate"):
        assert press(guarded._replace(guard="none"), ideal=True).lowest_energy < -0.1


def test_a_guard_adds_the_damping_that_makes_up_for_the_energy():
    """E - (F - alpha v) . v T = 0 at the speed of the last period; none while there is energy, and bounded."""
    still, after = (0.0, 0.0, 0.0), (0.0, 0.0, 1e-4)
    guard = Passivity(still, most=50.0)
    assert guard.controlled((0.0, 0.0, -2.0), still) == (0.0, 0.0, -2.0)  # pushed in by 0.2 mJ:
    assert guard.controlled((0.0, 0.0, 1.0), after) == (0.0, 0.0, 1.0)
    assert guard.energy == pytest.approx(2e-4)
    back = guard.controlled((0.0, 0.0, 3.0), (0.0, 0.0, 2e-4))  # 0.1 mJ is left, and 0.3 would be taken
    assert guard.energy == pytest.approx(1e-4)
    assert back == pytest.approx((0.0, 0.0, 1.0))
    bounded = guard.controlled((0.0, 0.0, 100.0), (0.0, 0.0, 3e-4))
    assert bounded[2] == pytest.approx(100.0 - 50.0 * 0.1)


# Determinism and timing


def test_a_run_is_the_same_each_time_to_the_last_bit():
    """Jitter comes from a seed, and no clock is read: on a wall and on the material. Another seed is another run."""
    cell = Cell("local", "passivity", 5.0, 2.5, 2.5, "soft", 1000.0)
    assert press(cell, ideal=False).moments == press(cell, ideal=False).moments
    runs = []
    for seed in (1, 1, 2):
        loop = at_block(TOUCH, HANDS["soft"], Timing(5.0 * MS, 2.5 * MS, 2.5 * MS, seed), Coupling.LOCAL)
        runs.append((loop.run(0.4).moments, loop.world.push.grid.density.tobytes()))
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_models_come_when_they_should():
    """Each look sees the arm as of the loop's last period, is late by its jitter, and arrives a latency later."""
    looks = []

    def collide(time):
        looks.append(time)
        return ForceModel(time)

    collision = Collision(Timing(5.0 * MS, 2.5 * MS, 2.0 * MS), collide)
    arrivals = {}
    for tick in range(100):
        arrivals |= {model.time: tick * MS for model in collision.due(tick * MS)}
    assert len(looks) == 20
    late = np.array(looks) - 5.0 * MS * np.arange(20)
    assert late.min() >= 0.0 and late.max() <= 2.0 * MS and np.ptp(late) > 1.0 * MS
    waited = np.array([arrived - made for made, arrived in arrivals.items()])
    assert waited.min() >= 2.5 * MS - 1e-9 and waited.max() < 3.5 * MS


def test_the_energy_is_the_work_that_the_hand_does_at_the_port():
    """What it has put in by the end is what the wall holds: K d^2 / 2, once all is at rest."""
    trace = at_wall(TOUCH, HANDS["firm"], Timing(1.0 * MS), Coupling.IN_LOOP).run(2.0)
    depth = -trace.height[-1]
    assert trace.moments[-1].energy == pytest.approx(0.5 * TOUCH.stiffness * depth**2, rel=0.03)


def test_an_arm_shows_whole_encoder_steps():
    arm = OneAxis(TOUCH.mechanics, HANDS["soft"], 1.234e-3)
    step = TOUCH.mechanics.encoder
    assert arm.seen[2] / step == pytest.approx(round(arm.seen[2] / step))
    assert 0.0 <= arm.height - arm.seen[2] < step
