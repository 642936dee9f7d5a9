# SPDX-License-Identifier: GPL-3.0-or-later
"""What is felt: the four regimes, the force, and a tool that is inside, at rest, reversing, or has no room at all."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from repousse.core import CapsuleTool, DensityGrid, Material, Push, Regime, SphereTool, plasticity

from .volumes import TINY, half_space, line, net_moved, speckled, walk

R, N, FIRST = 6, 40, 16
MIDDLE = (N - 1) / 2
SURFACE = FIRST - 0.5 - R
JND = 0.08
"""The least share of a force that a hand can tell apart."""


def at(depth, aside=0.0):
    """The centre of a ball that is ``depth`` voxels into the half-space."""
    return (SURFACE + depth, MIDDLE + aside, MIDDLE)


def press(density=0.6, kappa=0.1, band=None, full_force=3.3):
    grid = half_space(N, density, first=FIRST)
    return Push(grid, SphereTool(R), Material(full_force, kappa), border="wall", band=band)


def magnitude(contact):
    return float(np.linalg.norm(contact.force))


def check_force(contact):
    felt = min(contact.stress, contact.yield_stress)
    assert np.isfinite(contact.force).all()
    assert magnitude(contact) == pytest.approx(felt, rel=1e-9, abs=1e-12)


class Cautious:
    """A push whose every contact is checked, with the grid before each move."""

    def __init__(self, push):
        self.push, self.contacts = push, []

    def __call__(self, position):
        before = self.push.grid.density.copy()
        contact = self.push.move_to(position)
        check_force(contact)
        after = self.push.grid.density
        if contact.regime is not Regime.PLASTIC:
            assert before.shape == after.shape and before.tobytes() == after.tobytes(), contact.regime
            assert contact.moved_mass == contact.mass_out == 0.0
            assert contact.dirty is None and contact.sweeps == 0
        self.contacts.append(contact)
        return contact


@pytest.mark.parametrize("band", [None, 6.0])
def test_the_four_regimes_in_turn(kernels, band):
    go = Cautious(press(band=band))
    for depth in np.arange(-3.0, 10.0, 0.25):
        go(at(depth))
    for depth in np.arange(9.75, -3.0, -0.25):
        go(at(depth))
    seen = [go.contacts[0].regime]
    for contact in go.contacts:
        if contact.regime is not seen[-1]:
            seen.append(contact.regime)
    assert seen == [Regime.NONE, Regime.ELASTIC, Regime.PLASTIC, Regime.UNLOADING, Regime.NONE]
    assert magnitude(go.contacts[0]) == magnitude(go.contacts[-1]) == 0.0


def test_loading_again_is_elastic_up_to_where_it_was():
    go = Cautious(press())
    walk(go.push, [at(depth) for depth in np.arange(-1.0, 8.25, 0.25)])
    top = go(at(8.0))
    for _ in range(3):
        for depth in np.arange(7.75, 5.0, -0.25):
            assert go(at(depth)).regime in (Regime.UNLOADING, Regime.NONE)
        for depth in np.arange(5.5, 8.0, 0.25):
            assert go(at(depth)).regime in (Regime.ELASTIC, Regime.NONE)
        again = go(at(8.0))
        assert again.stress == pytest.approx(top.stress, rel=1e-6)  # no ratcheting


def test_loop_costs_work():
    """Work goes in on the way in and less comes back: the loop's area is not negative."""
    push = press()
    work, former = 0.0, -1.0
    for depth in [*np.arange(-1.0, 9.0, 0.1), *np.arange(9.0, -1.0, -0.1)]:
        work += -push.move_to(at(depth)).force[0] * (depth - former)
        former = depth
    assert work > 0.0
    total = -press().move_to(at(2.0)).force[0]
    assert total > 0.0


def test_stress_meets_yield_stress_while_plastic(kernels):
    push = press()
    for contact in walk(push, [at(depth) for depth in np.arange(-1.0, 10.0, 0.25)]):
        assert (
            contact.residual == max(0.0, contact.stress - contact.yield_stress) or contact.regime is not Regime.PLASTIC
        )
        assert contact.stress <= contact.yield_stress * (1.0 + plasticity.RELAXED)


def test_hardens():
    """sigma_f grows as material packs in the reach, until that is full."""
    push = press(0.4)
    plastic = [
        c.yield_stress for c in walk(push, [at(d) for d in np.arange(0, 10, 0.25)]) if c.regime is Regime.PLASTIC
    ]
    assert plastic[-1] > 1.5 * plastic[0]
    assert np.all(np.diff(plastic[:8]) > 0.0)


@pytest.mark.parametrize("normal", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (1.0, 1.0, 1.0), (-0.3, 0.5, 0.8)])
def test_force_is_along_the_outward_normal(kernels, normal):
    """In elastic contact with a plane the hand is pushed straight back out, wherever the tool moved."""
    out = np.array(normal) / np.linalg.norm(normal)
    offsets = np.indices((N, N, N)) - MIDDLE
    inside = np.clip(0.5 - np.tensordot(out, offsets, 1), 0.0, 1.0).astype(np.float32)
    push = Push(DensityGrid(inside), SphereTool(R), Material(3.3, 0.1))
    aside = np.cross(out, (0.31, 0.2, -0.4))
    push.move_to(MIDDLE + (R + 1) * out)
    contact = push.move_to(MIDDLE + (R - 0.6) * out + aside)
    assert contact.regime is Regime.ELASTIC
    angle = np.degrees(np.arccos(np.clip(contact.force @ out / magnitude(contact), -1.0, 1.0)))
    assert angle < 3.0  # of a ball with 1500 voxels


@pytest.mark.parametrize("band", [None, 6.0])
@pytest.mark.parametrize("density", [0.5, 1.0])
def test_force_does_not_step(density, band):
    """Moves of a hundredth of a voxel, in, to and fro and out: no step over what a hand can feel, or 0.05 N."""
    push = press(density, 0.05, band, full_force=33.0)
    depths = [*np.arange(-0.6, 4.0, 0.01), *np.arange(4.0, 3.7, -0.01), *np.arange(3.7, 4.3, 0.01)]
    forces = np.array([push.move_to(at(depth)).force for depth in [*depths, *np.arange(4.3, 2.0, -0.01)]])
    assert np.linalg.norm(forces, axis=1).max() > 0.8
    steps = np.linalg.norm(np.diff(forces, axis=0), axis=1)
    allowed = np.maximum(JND * np.linalg.norm(forces[:-1], axis=1), 0.05)
    assert (steps <= allowed).all()
    # Nor any larger than what the ball's section at this depth meets of full material in a hundredth of a voxel.
    section = np.pi * (R**2 - (R - 4.3) ** 2)
    assert steps.max() < 1.2 * push.k_t * section * 0.01


@pytest.mark.parametrize(
    "make", [lambda: half_space(N, 0.6, FIRST), lambda: half_space(N, 1.0, FIRST), lambda: speckled(N)]
)
@pytest.mark.parametrize("band", [None, 6.0])
def test_at_rest_nothing_creeps(kernels, make, band):
    """The same pose again and again, in each regime and after an overload: bit for bit the same grid and force."""
    push = Push(make(), SphereTool(R), Material(3.3, 0.05), border="wall", band=band)
    for depth in (0.4, 3.0, 7.0, 6.8, 4.0, 7.0):
        contact = push.move_to(at(depth))
        before, force = push.grid.density.tobytes(), contact.force.tobytes()
        for _ in range(20):
            contact = push.move_to(at(depth))
            assert push.grid.density.tobytes() == before
            assert contact.force.tobytes() == force
            assert contact.moved_mass == 0.0 and contact.dirty is None


def test_at_rest_after_trembling():
    """A hand is never quite still: a tremble of a thousandth of a voxel moves next to nothing, however long."""
    push = press(0.8, 0.05)
    walk(push, line(at(-1.0), at(6.0)))
    before = push.grid.density.copy()
    random = np.random.default_rng(1)
    for _ in range(300):
        push.move_to(np.array(at(6.0)) + random.normal(0.0, 1e-3, 3))
    assert net_moved(before, push.grid.density) < 0.002 * net_moved(half_space(N, 0.8, FIRST).density, before)


@pytest.mark.parametrize("density", [0.5, 1.0])
@pytest.mark.parametrize("band", [None, 6.0])
def test_wholly_inside(kernels, density, band):
    """It ends, it moves what it must, it is felt, and mass stays."""
    grid = DensityGrid(np.full((N, N, N), density, np.float32))
    push = Push(grid, SphereTool(R), Material(3.3, TINY), border="wall", band=band)
    before = grid.mass
    push.move_to((MIDDLE,) * 3)
    first = push.move_to((MIDDLE + 0.5, MIDDLE, MIDDLE))
    assert first.regime is Regime.PLASTIC
    assert first.sweeps <= 4
    assert abs(grid.mass - before) <= 1e-7 * before
    assert grid.density.min() >= 0.0 and grid.density.max() <= 1.0
    if density < 1.0:
        x, y, z = np.ogrid[:N, :N, :N]
        inside = push.tool.volume.coverage(x - MIDDLE - 0.5, y - MIDDLE, z - MIDDLE)
        inside = np.where(
            (inside < 1.0) & (band is not None), 0.0, inside
        )  # packed material fills the rest of the skin's voxels
        assert (inside * grid.density).sum() < 0.02 * (inside * density).sum()
        assert not first.blocked


def test_first_pose_inside_material():
    """No displacement yet: the contact normal gives the way, and where the surroundings are uniform nothing moves."""
    buried = Push(DensityGrid(np.full((N, N, N), 0.5, np.float32)), SphereTool(R), Material(3.3, 0.05))
    contact = buried.move_to((MIDDLE,) * 3)
    assert contact.regime is Regime.ELASTIC and contact.moved_mass == 0.0
    assert contact.stress > contact.yield_stress
    half_in = press(0.6, 0.05)
    contact = half_in.move_to(at(4.0))
    assert contact.regime is Regime.PLASTIC and contact.moved_mass > 0.0
    assert contact.force[0] < 0.0 and abs(contact.force[1:]).max() < 1e-6 * magnitude(contact)


@pytest.mark.parametrize("band", [None, 6.0])
@pytest.mark.parametrize("density", [0.6, 1.0])
def test_reversing_every_few_steps(density, band):
    push = press(density, 0.05, band)
    before = push.grid.mass
    position = np.array(at(2.0))
    for turn in range(60):
        way = np.array([0.3, 0.35, 0.0]) if turn % 2 else np.array([-0.25, -0.35, 0.02])
        for _ in range(3):
            position = position + way
            contact = push.move_to(position)
            check_force(contact)
            assert contact.sweeps <= 4
    assert abs(push.grid.mass - before) <= 1e-7 * before
    assert push.grid.density.min() >= 0.0 and push.grid.density.max() <= 1.0


@pytest.mark.parametrize("border", ["grow", "wall", "open"])
@pytest.mark.parametrize("corner", [(0, 0, 0), (0, N - 1, 0), (N - 1, N - 1, N - 1), (N / 2, 0, N / 2)])
def test_half_outside_the_grid(kernels, border, corner):
    """Along the border and over its corners, tool and reach partly where there is no array."""
    push = Push(DensityGrid(np.full((N, N, N), 0.7, np.float32)), SphereTool(R), Material(3.3, 0.05), border=border)
    before, out = push.grid.mass, 0.0
    start = np.array(corner, float)
    inward = (MIDDLE - start) / np.linalg.norm(MIDDLE - start)
    aside = start + np.array([0.1, 3.0, -4.0])
    stresses = []
    for position in line(start - 4.0 * inward, start + 4.0 * inward, 0.4) + line(start, aside, 0.4):
        contact = push.move_to(position)
        check_force(contact)
        stresses.append(contact.stress)
        out += contact.mass_out
    assert max(stresses) > 0.1
    assert abs(push.grid.mass + out - before) <= 1e-7 * before
    assert push.grid.density.min() >= 0.0 and push.grid.density.max() <= 1.0


@pytest.mark.parametrize("band", [None, 6.0])
def test_no_room_anywhere(kernels, band):
    """A saturated block between walls: mass stays, the contact is blocked, the force is sigma_f, and it ends."""
    grid = DensityGrid(np.ones((N, N, N), np.float32))
    push = Push(grid, SphereTool(R), Material(3.3, 0.01), border="wall", band=band)
    for i, position in enumerate(line((MIDDLE,) * 3, (MIDDLE + 2.0, MIDDLE + 2.0, MIDDLE), 0.5)):
        contact = push.move_to(position)
        assert contact.sweeps <= 4
        if i:  # before that there is neither a move nor a normal to say which way
            check_force(contact)
            assert contact.blocked
            assert contact.residual > 0.0
    assert magnitude(contact) == pytest.approx(contact.yield_stress)
    assert abs(grid.mass - N**3) <= 1e-7 * N**3
    assert grid.density.max() <= 1.0
    assert np.abs(grid.density - 1.0).max() < 1e-3


def test_a_long_jump_lifts_the_tool():
    """More than a diameter in one move is a new contact, unless the stroke says it is continuous."""
    before = half_space((24, 64, N), 0.6, first=10).density.copy()
    left, right = (9.0, 12.0, MIDDLE), (9.0, 52.0, MIDDLE)
    middle = (slice(None), slice(26, 38))
    for continuous in (False, True):
        push = Push(half_space((24, 64, N), 0.6, first=10), SphereTool(R), Material(3.3, 0.05), border="wall")
        push.move_to((2.0, 12.0, MIDDLE))
        push.move_to(left)
        push.move_to(right, continuous=continuous)
        assert (push.grid.density[middle] != before[middle]).any() == continuous
        assert (push.grid.density[:, 46:58] != before[:, 46:58]).any()  # it arrived all the same


def test_a_jump_within_a_diameter_is_a_move():
    push = press(0.6, 0.05)
    push.move_to(at(4.0, -5.5))
    before = push.grid.density.copy()
    push.move_to(at(4.0, 6.0))
    assert (push.grid.density[:, N // 2] != before[:, N // 2]).any()


@pytest.mark.parametrize("thickness", [1, 2, 3])
def test_a_sheet_is_not_jumped(kernels, thickness):
    """One move of 10 voxels right through a sheet finds it: solves are at most half a voxel apart."""
    values = np.zeros((N, 24, 24), np.float32)
    values[FIRST : FIRST + thickness] = 0.9
    push = Push(DensityGrid(values), SphereTool(2), Material(3.3, 0.05), border="wall")
    push.move_to((FIRST - 5.0, 11.5, 11.5))
    contact = push.move_to((FIRST + 5.0, 11.5, 11.5), continuous=True)
    assert contact.moved_mass > 5.0 * thickness
    assert push.grid.density[FIRST : FIRST + thickness, 11:13, 11:13].max() < 0.1


def test_steps_make_little_difference():
    """One long move and the same way in quarter voxels lead to nearly the same grid."""
    before = half_space(N, 0.6, FIRST).density
    ends = []
    for step in (0.25, 0.5, 5.0):
        push = press(0.6, 0.05)
        walk(push, line(at(-1.0), at(9.0), step))
        ends.append(push.grid.density.astype(np.float64))
    moved = net_moved(before, ends[0])
    assert np.abs(ends[1] - ends[2]).sum() / 2 < 1e-6 * moved
    assert np.abs(ends[0] - ends[1]).sum() / 2 < 0.05 * moved


def test_half_a_voxel_is_one_solve(monkeypatch):
    """Also off the axes, where rounding makes a move of half a voxel a hair longer."""
    from repousse.core import push as module

    solves = []
    monkeypatch.setattr(module, "estimate", lambda work: (solves.append(1), plasticity.estimate(work)))
    for direction in ((1, 0, 0), (1, 1, 0), (1, 1, 1), (0.8, 0.5, 0.33)):
        u = np.array(direction) / np.linalg.norm(direction)
        push = press()
        path = [np.full(3, MIDDLE) - 12 * u + 0.5 * i * u for i in range(9)]
        walk(push, path[:1])
        solves.clear()
        walk(push, path[1:])
        assert len(solves) == 8


def test_empty_space_is_free(monkeypatch):
    """A jump of thousands of voxels to the grid solves only where the tool may touch it."""
    from repousse.core import push as module

    solves = []
    monkeypatch.setattr(module, "estimate", lambda work: (solves.append(1), plasticity.estimate(work)))
    push = press()
    push.move_to((-1e6, MIDDLE, MIDDLE))
    contact = push.move_to(at(3.0), continuous=True)
    assert contact.moved_mass > 0.0
    assert len(solves) < 100


def test_radius_changes_on_the_way():
    push = press(0.6, 0.05)
    push.move_to(at(-1.0))
    first = push.move_to(at(2.0))
    second = push.move_to(at(2.0), radius=9.0)
    assert push.tool.radius == 9.0 and push.tool.reach == 13.5
    assert second.moved_mass > first.moved_mass


@settings(max_examples=30)
@given(
    st.lists(st.tuples(st.floats(0.0, 12.0), st.floats(-3.0, 3.0)), min_size=1, max_size=8),
    st.sampled_from([0.3, 0.7, 1.0]),
    st.sampled_from([None, 3.0]),
    st.booleans(),
)
def test_any_path_is_felt_truly(path, density, band, capsule):
    """|force| = min(stress, yield stress), and the grid changes in plastic loading alone, whatever the hand does."""
    tool = CapsuleTool((0.0, 3.0, 1.0), 4.0) if capsule else SphereTool(5)
    go = Cautious(Push(half_space(32, density, 14), tool, Material(2.0, 0.05), border="wall", band=band))
    places = [(8.0 + depth, 15.5 + aside, 15.5) for depth, aside in path]
    go(places[0])
    for start, end in pairwise(places):
        for place in line(start, end, 0.5)[1:]:  # a solve each: what several do together has the regime of the last
            go(place)
