# SPDX-License-Identifier: GPL-3.0-or-later
"""The brick map: always what a look at all voxels would find, and no result is another for it."""

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from repousse.core import BoxTool, CapsuleTool, DensityGrid, Material, Push, SphereTool
from repousse.core.bricks import BRICK, EMPTY, FULL, MIXED, BrickMap
from repousse.core.native.state import Probe
from repousse.core.plasticity import estimate
from repousse.core.symmetry import SymmetricPush

from .volumes import half_space, kernels_chosen, line, speckled, walk


def states_by_voxels(density):
    """What each brick is, brick by brick: the definition."""
    layout = [-(-n // BRICK) for n in density.shape]
    states = np.full(layout, MIXED, np.uint8)
    for place in np.ndindex(*layout):
        brick = density[tuple(slice(p * BRICK, (p + 1) * BRICK) for p in place)]
        if (brick == 0.0).all():
            states[place] = EMPTY
        elif (brick == 1.0).all():
            states[place] = FULL
    return states


def assert_right(grid):
    assert grid.bricks.density is grid.density
    assert np.array_equal(grid.bricks.states, states_by_voxels(grid.density))


def blocks(shape, seed):
    """Bricks of each kind beside each other, and near misses."""
    random = np.random.default_rng(seed)
    density = np.zeros(shape, np.float32)
    for place in np.ndindex(*(-(-n // BRICK) for n in shape)):
        brick = density[tuple(slice(p * BRICK, (p + 1) * BRICK) for p in place)]
        kind = random.integers(5)
        brick[...] = (0.0, 1.0, 0.0, 1.0, 0.5)[kind]
        if kind in (2, 3):  # all but one voxel, by as little as can be
            odd = tuple(random.integers(n) for n in brick.shape)
            brick[odd] = np.nextafter(brick[odd], np.float32(0.5))
    return density


@pytest.mark.parametrize("shape", [(16, 24, 32), (17, 9, 30), (1, 2, 3), (8, 8, 1)])
def test_what_bricks_are(kernels, shape):
    for seed in range(4):
        density = blocks(shape, seed)
        assert np.array_equal(BrickMap(density).states, states_by_voxels(density))


def test_a_box_is_looked_at_alone(kernels):
    """What is not marked is not read, and what lies beside the box not either."""
    density = np.ones((32, 32, 32), np.float32)
    bricks = BrickMap(density)
    assert bricks.looked_at == 4**3 and (bricks.states == FULL).all()
    bricks.settle(None)
    assert bricks.looked_at == 4**3
    bricks.mark((0, 9, 0), (32, 10, 8))
    assert (bricks.states == MIXED).sum() == 4
    density[0, 9, 0] = 0.5
    bricks.settle(((-5, 7, 0), (9, 9, 1)))  # two bricks along the first axis, of which both are marked in one row alone
    assert bricks.looked_at == 4**3 + 2
    assert (bricks.states == MIXED).sum() == 3
    bricks.settle(None)
    assert np.array_equal(bricks.states, states_by_voxels(density))


def test_who_writes_otherwise_says_so(kernels):
    grid = DensityGrid(np.ones((20, 20, 20), np.float32))
    assert_right(grid)
    grid.density[:8, :8, :8] = 0.0
    assert not np.array_equal(grid.bricks.states, states_by_voxels(grid.density))
    grid.bricks.changed(((0, 0, 0), (8, 8, 8)))
    assert_right(grid)
    grid.density = np.zeros((9, 9, 9), np.float32)  # another array is noticed
    assert_right(grid)
    assert grid.bricks.empty


def test_a_copy_has_its_own(kernels):
    grid = half_space(32, 1.0, 12)
    assert_right(grid)
    other = copy.deepcopy(grid)
    assert other.bricks.density is other.density and other.bricks.states is not grid.bricks.states
    Push(other, SphereTool(5), Material(3.3, 0.02)).move_to((12.0, 16.0, 16.0))
    assert_right(grid)


@pytest.mark.parametrize("shape", [(16, 16, 16), (17, 12, 30)])
@pytest.mark.parametrize("below, above", [((8, 0, 16), (0, 8, 3)), ((0, 0, 0), (5, 0, 8)), ((3, 0, 0), (0, 0, 0))])
def test_follows_growth(kernels, shape, below, above):
    """Also where the border cut bricks, and where a growth is not by whole ones."""
    grid = DensityGrid(blocks(shape, 1))
    assert_right(grid)
    looked_at = grid.bricks.looked_at
    grid.grow(below, above)
    assert_right(grid)
    assert looked_at


VERBS = {"push": {}, "rim": {"band": 3.0}, "pull": {"verb": "pull"}, "smooth": {"verb": "smooth"}}
STARTS = {
    "packed": lambda shape: np.ones(shape, np.float32),
    "blocks": lambda shape: blocks(shape, 3),
    "half": lambda shape: np.broadcast_to(np.arange(shape[2]) < shape[2] // 2, shape).astype(np.float32),
}


@settings(max_examples=25, deadline=None)
@given(
    shape=st.tuples(*[st.integers(9, 26)] * 3),
    start=st.sampled_from(list(STARTS)),
    border=st.sampled_from(["grow", "wall", "open"]),
    strokes=st.lists(
        st.tuples(
            st.sampled_from(list(VERBS)),
            st.lists(st.tuples(*[st.floats(-2, 26)] * 3), min_size=2, max_size=4),
            st.booleans(),
        ),
        min_size=1,
        max_size=4,
    ),
)
def test_right_after_any_strokes(shape, start, border, strokes):
    """Of any verb, one after the other, some of them taken back, and done again."""
    grid = DensityGrid(STARTS[start](shape))
    for verb, points, taken_back in strokes:
        if grid.bricks.empty:
            break
        push = Push(grid, SphereTool(3, 5), Material(3.3, 0.02), border=border, **VERBS[verb])
        history = push.remember()
        for point in points:
            push.move_to(point, continuous=True)
            assert_right(grid)
        if taken_back:
            push.restore(history)
            assert_right(grid)
            walk(push, points[:2], continuous=True)
            assert_right(grid)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("verb", VERBS)
def test_right_after_strokes_along_each_axis(kernels, verb, axis):
    grid = half_space((33, 34, 37), 1.0, 14, axis=axis)
    push = Push(grid, SphereTool(5), Material(3.3, 0.02), **VERBS[verb])
    start, end = np.full(3, 16.0), np.full(3, 17.0)
    start[axis], end[axis] = 6.0, 20.0
    for point in line(start, end, 0.9)[:: -1 if verb == "pull" else 1]:
        push.move_to(point)
        assert_right(grid)


def test_right_with_mirrored_tools_and_the_paper_s_recursion(kernels):
    grid = half_space(24, 0.5, 8)
    push = SymmetricPush(grid, SphereTool(3), Material(3.3, 0.02), axes="y", centre=(12.0, 12.0, 12.0))
    walk(push, line((2.0, 8.0, 12.0), (9.0, 9.0, 12.0), 0.9))
    assert_right(grid)
    push = Push(half_space(16, 0.3, 6), SphereTool(2), Material(3.3, 0.02), method="recursive")
    walk(push, line((3.0, 8.0, 8.0), (6.0, 8.0, 8.0), 0.5))
    assert_right(push.grid)


TOOLS = {"sphere": SphereTool(6), "box": BoxTool((4, 6, 5), 4), "capsule": CapsuleTool((1.0, 4.0, 2.0), 4.0, 7.0)}


@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.parametrize("volume", ["blocks", "half", "packed", "noise"])
def test_estimates_are_the_same_to_the_last_bit(kernels, volume, tool):
    density = speckled(36).density if volume == "noise" else STARTS[volume]((36, 35, 37))
    probes = [Probe(density), Probe(density, BrickMap(density))]
    for centre in [(17.3, 16.1, 18.9), (9.0, 17.5, 17.5), (-3.2, 30.4, 34.0), (60.0, 0.0, 0.0)]:
        for probe in probes:
            probe.take_up(TOOLS[tool])
            probe.tool.centre[:] = centre
            estimate(probe)
        without, by_map = (probe.estimate for probe in probes)
        assert (by_map.tool_mass, by_map.reach_mass) == (without.tool_mass, without.reach_mass)
        assert by_map.gradient[:] == without.gradient[:]
        assert by_map.read <= without.read


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("volume", ["half", "blocks"])
@pytest.mark.parametrize("verb", VERBS)
def test_pushes_are_the_same_to_the_last_bit(kernels, verb, volume, axis):
    """With the map and without one; also where only some of the bricks that a plane of flux meets are full."""
    found, way = [], np.roll([(16.0, 16.0, 6.0), (18.0, 17.0, 20.0)], axis - 2, axis=1)
    for known in (True, False):
        grid = half_space(36, 1.0, 13, axis=axis) if volume == "half" else DensityGrid(blocks((36, 36, 36), 3))
        push = Push(grid, SphereTool(5), Material(3.3, 0.02), border="wall", **VERBS[verb])
        if not known:
            push._work.attach(grid.density, None)
        contacts = walk(push, line(*way, 0.8))
        found.append((grid.density.tobytes(), [(c.stress, c.yield_stress, c.moved_mass) for c in contacts]))
    assert found[0] == found[1]


def test_twins(monkeypatch):
    density, maps = blocks((30, 17, 41), 7), []
    for name in ("compiled", "numpy"):
        with kernels_chosen(monkeypatch, name):
            bricks = BrickMap(density)
            bricks.mark((3, 3, 3), (20, 12, 40))
            bricks.settle(((0, 0, 0), (12, 17, 30)))
            maps.append(bricks)
    assert np.array_equal(maps[0].states, maps[1].states)
    assert maps[0].looked_at == maps[1].looked_at
