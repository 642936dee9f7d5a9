# SPDX-License-Identifier: GPL-3.0-or-later
"""Each choice that fails, failing, beside the one that was made: so that nobody brings it back."""

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.local_model import Feeler
from repousse.device.force import felt_force
from repousse.device.limits import PERIOD
from repousse.device.loop import VELOCITY_WINDOW
from tests.bench.stability.cases.looping import LEAST_ENERGY, LIMITS, clay, held, held_in
from tests.bench.stability.collision import Timing
from tests.bench.stability.contact import MIDDLE, RADIUS, SIDE, SURFACE, above, block, coming, pushed, run
from tests.bench.stability.couplings import ZERO, Coupling
from tests.bench.stability.scenes import DEVICES, HANDS, at_wall
from tests.core.volumes import TINY, speckled

from .naive import (
    OneSolve,
    empty_from_the_rear,
    empty_innermost_first,
    float32_mass,
    opposed_to_motion,
    share_alike,
    share_by_room,
    whole_voxel_mass,
)

NOTHING = 0.4
"""Share of moves of a hundredth of a voxel at which whole voxels feel nothing: 44 % in facts/physics.md 5."""
JUMP = 3.0
"""Times the mean change by which they jump at others."""
SMOOTH = 1.25
"""Times by which fractional coverage may: the slope itself grows by a tenth on the way."""


def test_whole_voxels_feel_nothing_and_then_jump():
    grid = block(1.0)
    push = pushed(grid)
    feeler, radius = Feeler(push), RADIUS
    places = [above(depth) for depth in np.arange(3.0, 5.0, 0.01)]
    whole = np.diff([whole_voxel_mass(grid.density, place, radius) for place in places])
    ours = np.diff([feeler.feel(place, push.tool).stress / push.k_t for place in places])
    assert (whole == 0.0).mean() > NOTHING and whole.max() > JUMP * whole.mean()
    assert (ours > 0.0).all() and ours.max() < SMOOTH * ours.mean()


STIFFNESS = 190.0
"""N/m: with a collision each 10 ms and a soft hand, held forces are stable to 295 and interpolated ones to 147
(facts/physics.md 3)."""
COUNT = 0.055
"""Millimetres of an encoder step: what moves by less is at rest."""


def test_interpolating_shakes_where_holding_rests():
    moved = {}
    for coupling in (Coupling.HOLD, Coupling.INTERPOLATE, Coupling.LOCAL):
        loop = at_wall(DEVICES[1], HANDS["soft"], Timing(10e-3), coupling, stiffness=STIFFNESS)
        moved[coupling] = loop.run(4.0).peak_to_peak(3.0) * 1e3
    assert moved[Coupling.INTERPOLATE] > 10.0 * COUNT
    assert moved[Coupling.HOLD] < COUNT and moved[Coupling.LOCAL] < COUNT


LEFT = 0.4
"""Share of its mass that a tool wholly inside still has after a pass of "innermost first": 57 % was measured."""
EMPTIED = 0.02
"""The same after a sweep."""


def test_innermost_first_stalls_where_a_sweep_empties():
    n, r = 22, 5.0
    middle = np.full(3, 10.5)
    tool = np.sqrt(((np.indices((n,) * 3) - 10.5) ** 2).sum(axis=0)) < r
    left = []
    for empty in (empty_innermost_first, empty_from_the_rear):
        density = np.full((n,) * 3, 0.5)
        empty(density, middle, r)
        assert density.sum() == pytest.approx(0.5 * n**3, rel=1e-12)
        left.append(density[tool].sum() / (0.5 * tool.sum()))
    assert left[0] > LEFT and left[1] < EMPTIED
    push = pushed(DensityGrid(np.full((SIDE,) * 3, 0.5, np.float32)), r, Material(3.3, TINY))
    push.move_to((MIDDLE - 0.5, MIDDLE, MIDDLE))
    assert push.move_to((MIDDLE,) * 3).tool_mass < EMPTIED * 0.5 * tool.sum()


ORDER = 0.05
"""Density by which a voxel differs when sources share in another order: .06 here, up to .27 in facts/physics.md 0."""
ORDER_SUM = 0.02
"""The same over all voxels, of the mass that moved: .03 here, up to .11 there."""
NO_ORDER = 1e-6
"""What rounding may make of it."""


def test_sharing_by_room_depends_on_the_order_of_the_sources():
    random = np.random.default_rng(1)
    before = random.uniform(0.2, 1.0, (3, 12, 12))
    sources = [(0, j, k) for j in range(1, 11) for k in range(1, 11)]
    orders = [random.permutation(len(sources)) for _ in range(4)]
    for share, depends in ((share_by_room, True), (share_alike, False)):
        ends = []
        for order in orders:
            density = before.copy()
            share(density, [sources[i] for i in order], 0.3)
            ends.append(density)
        apart = max(np.abs(end - ends[0]).max() for end in ends[1:])
        summed = max(np.abs(end - ends[0]).sum() / 2.0 for end in ends[1:]) / (ends[0] - before).sum()
        if depends:
            assert apart > ORDER and summed > ORDER_SUM
        else:
            assert apart < NO_ORDER


def test_a_sweep_has_no_order():
    """Turned round, all voxels come in the other order, and end as they would have."""
    ends = []
    for turned in (False, True):
        values = speckled(SIDE).density
        grid = DensityGrid(values[::-1, ::-1].copy() if turned else values)
        run(pushed(grid, material=Material(3.3, TINY)), [(MIDDLE, MIDDLE, z) for z in coming(42.0, 26.0, 0.5)])
        ends.append(grid.density[::-1, ::-1] if turned else grid.density)
    assert np.abs(ends[0] - ends[1]).max() < NO_ORDER * 10.0


TREMBLE = 55e-6
"""Metres of a count, to and fro in each millisecond."""
JND = 0.08


def test_against_the_motion_chatters_at_rest_and_does_not_spring_back():
    world = clay(block(1.0), band=float(RADIUS))
    for height in coming(1e-3, -2e-3, 2.5e-4):
        world.collide((0.0, 0.0, height), 0.0)
    seen = [(0.0, 0.0, -1.9e-3 + TREMBLE * (tick % 2)) for tick in range(40)]
    window = round(VELOCITY_WINDOW / PERIOD)
    naive, ours = [], []
    for tick in range(window, len(seen)):
        velocity = (np.array(seen[tick]) - seen[tick - window]) / VELOCITY_WINDOW
        model = world.feel(seen[tick], 0.0)
        naive.append(opposed_to_motion(min(model.stress, model.yield_stress), velocity))
        ours.append(felt_force(model, None, seen[tick], tuple(velocity), 0.0, LIMITS).force)
    steps = [np.linalg.norm(np.diff(forces, axis=0), axis=1).max() for forces in (naive, ours)]
    strength = np.linalg.norm(ours, axis=1).max()
    slope = LIMITS.max_stiffness * TREMBLE
    assert steps[0] > 0.5 * strength
    assert steps[1] < slope + JND * strength
    # Let go, it moves out: a force against that keeps it in, like friction; the material's pushes it out.
    out, model = (0.0, 0.0, 0.05), world.feel((0.0, 0.0, -1.9e-3), 0.0)
    assert opposed_to_motion(min(model.stress, model.yield_stress), out)[2] < 0.0
    assert felt_force(model, None, (0.0, 0.0, -1.9e-3), out, 0.0, LIMITS).force[2] > 0.0


class Still:
    """A world whose normal stands still until the next model."""

    def __init__(self, world):
        self._world, self.feel = world, world.feel

    def collide(self, place, now):
        return self._world.collide(place, now)._replace(turning_x=ZERO, turning_y=ZERO, turning_z=ZERO)


@pytest.mark.parametrize("name", ["pit", "hole"])
def test_a_normal_that_stands_still_throws_a_soft_hand_about(name):
    """16 ms from one model to the next, no friction: millijoules beyond what the hand had put in."""
    still, ours = (held(world, "soft", 16) for world in (Still(held_in(name)), held_in(name)))
    assert still.lowest_energy < 5.0 * LEAST_ENERGY < LEAST_ENERGY < ours.lowest_energy
    assert still.peak_to_peak(2.0) > 3.0 * ours.peak_to_peak(2.0)


def test_one_solve_a_pose_jumps_a_sheet():
    moved = []
    for kind in (OneSolve, Push):
        grid = block(0.0)
        grid.density[:, :, int(SURFACE)] = 1.0
        push = kind(grid, SphereTool(4), Material(3.3, 0.05), border="wall")
        push.move_to((MIDDLE, MIDDLE, SURFACE + 7.0))
        moved.append(push.move_to((MIDDLE, MIDDLE, SURFACE - 7.0), continuous=True).moved_mass)
    assert moved[0] == 0.0
    assert moved[1] > 0.9 * np.pi * 4.0**2  # a disc as wide as the ball


DRIFT = 1e-7
"""Of the total: DESIGN 7."""


def test_mass_summed_in_float32_drifts():
    grid = speckled(96)
    exact = float(grid.density.astype(np.longdouble).sum())
    assert abs(float32_mass(grid.density) / exact - 1.0) > 10.0 * DRIFT
    assert abs(grid.mass / exact - 1.0) < 1e-3 * DRIFT
