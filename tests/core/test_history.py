# SPDX-License-Identifier: GPL-3.0-or-later
"""Before-images: a grid is made what it was, bit for bit, and only what was touched is kept."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.grid import BRICK

from .volumes import half_space, in_frame, line, speckled, walk

CASES = {
    "sweep": (lambda: half_space(40, 0.5, 14), {}),
    "sweep along 2": (lambda: half_space((37, 35, 41), 0.7, 14, axis=2), {"border": "open"}),
    "rim": (lambda: half_space(40, 1.0, 14), {"border": "wall", "band": 5.0}),
    "wall": (lambda: half_space(40, 1.0, 14), {"border": "wall"}),
    "open": (lambda: half_space(40, 1.0, 14), {"border": "open"}),
    "growth": (lambda: DensityGrid(np.ones((27, 26, 25), np.float32), 0.25 * np.eye(4) + np.diag([0, 0, 0, 0.75])), {}),
    "growth and rim": (lambda: DensityGrid(np.ones((27, 26, 25), np.float32)), {"band": 4.0}),
    "noise": (lambda: speckled((41, 33, 39)), {}),
}


def paths(shape):
    """In along axis 0, then along axis 2 and obliquely: each of the three orders of the sweep."""
    middle = (np.array(shape) - 1) / 2
    start, inside = middle - np.array([0.6 * shape[0], 0, 0]), middle - np.array([0.1 * shape[0], 1.0, -1.0])
    ends = [inside + np.array(way) for way in ((1.0, 1.0, 6.0), (1.5, 7.0, 1.0))]
    return line(start, inside, 0.8) + [point for end in ends for point in line(inside, end, 0.8)]


@pytest.mark.parametrize("case", CASES)
def test_restores_bit_for_bit(kernels, case):
    make, options = CASES[case]
    grid = make()
    push = Push(grid, SphereTool(5), Material(3.3, 0.02), **options)
    before, shape, transform = grid.density.tobytes(), grid.shape, grid.transform.copy()
    history = push.remember()
    walk(push, paths(shape))
    assert grid.density.tobytes() != before
    assert (grid.shape != shape) == case.startswith("growth")
    push.restore(history)
    assert grid.shape == shape and push.origin == (0, 0, 0)
    assert grid.density.tobytes() == before
    assert grid.transform.tobytes() == transform.tobytes()


@pytest.mark.parametrize("case", ["sweep", "growth and rim"])
def test_a_restored_push_goes_on(kernels, case):
    """After a restore the same path leads to the same voxels as the first time."""
    make, options = CASES[case]
    push = Push(make(), SphereTool(5), Material(3.3, 0.02), **options)
    history = push.remember()
    path = paths(push.grid.shape)
    walk(push, path)
    first, origin = push.grid.density.copy(), push.origin
    push.restore(history)
    walk(push, path)
    assert push.origin == origin
    assert push.grid.density.tobytes() == first.tobytes()


def test_stroke_after_stroke(kernels):
    """Each stroke has its own; they are undone last first, across growth."""
    push = Push(DensityGrid(np.ones((27, 26, 25), np.float32)), SphereTool(5), Material(3.3, 0.02))
    states, histories = [], []
    for turn in range(3):
        states.append((push.grid.density.tobytes(), push.grid.shape, push.origin, push.grid.transform.tobytes()))
        histories.append(push.remember())
        walk(push, line((9.0 + turn, 12.0, 12.0), (13.0 + turn, 12.0, 9.0 + 3 * turn), 0.8))
        push.lift()
    for state, history in zip(states[::-1], histories[::-1]):
        push.restore(history)
        assert (push.grid.density.tobytes(), push.grid.shape, push.origin, push.grid.transform.tobytes()) == state


def bricks_of(changed):
    """How many bricks hold a voxel that changed."""
    padded = np.pad(changed, [(0, -n % BRICK) for n in changed.shape])
    a, b, c = (n // BRICK for n in padded.shape)
    return int(padded.reshape(a, BRICK, b, BRICK, c, BRICK).any(axis=(1, 3, 5)).sum())


@pytest.mark.parametrize("case", ["sweep", "sweep along 2", "rim"])
def test_keeps_what_is_touched_alone(kernels, case):
    """Every brick that changed, and few that did not: rows are looked at a whole stretch at a time."""
    make, options = CASES[case]
    grid = make()
    before = grid.density.copy()
    push = Push(grid, SphereTool(5), Material(3.3, 0.02), **{"border": "wall"} | options)
    history = push.remember()
    assert history.bricks == history.nbytes == 0
    axis = 2 if case.endswith("2") else 0
    start, end = np.full(3, 18.0), np.full(3, 18.0)
    start[axis], end[axis] = 7.0, 13.0
    walk(push, line(start, end))
    changed = bricks_of(grid.density != before)
    assert changed <= history.bricks <= 3 * changed
    assert history.nbytes == history.bricks * BRICK**3 * 4


def test_elastic_moves_keep_nothing():
    push = Push(half_space(40, 0.5, 14), SphereTool(5), Material(3.3, 0.2))
    history = push.remember()
    walk(push, line((5.0, 19.0, 19.0), (9.8, 19.0, 19.0)))
    assert history.bricks == 0


def test_the_same_bricks_for_a_larger_grid(kernels):
    """What is kept depends on the stroke, not on the grid."""
    kept = []
    for n in (48, 96):
        push = Push(half_space(n, 0.5, 16), SphereTool(5), Material(3.3, 0.02))
        history = push.remember()
        walk(push, line((9.0, 20.0, 20.0), (15.0, 22.0, 20.0), 0.4))
        kept.append(history.bricks)
    assert kept[0] == kept[1] > 0


def test_growth_keeps_what_was_remembered():
    """A growth to below moves every brick: its image moves with it."""
    grid = DensityGrid(np.ones((27, 26, 25), np.float32))
    before = grid.density.copy()
    push = Push(grid, SphereTool(5), Material(3.3, 0.02))
    history = push.remember()
    walk(push, line((13.0, 12.0, 12.0), (9.0, 12.0, 12.0)))  # towards the low side
    assert push.origin[0] < 0
    assert (in_frame(grid, push.origin, (0, 0, 0), before.shape) != before).any()
    push.restore(history)
    assert np.array_equal(grid.density, before)


@settings(max_examples=15)
@given(
    shape=st.tuples(*[st.integers(6, 21)] * 3),
    border=st.sampled_from(["grow", "wall", "open"]),
    band=st.sampled_from([None, 2.0]),
    points=st.lists(st.tuples(*[st.floats(-2, 20)] * 3), min_size=2, max_size=5),
)
def test_any_stroke_is_undone(shape, border, band, points):
    values = np.random.default_rng(sum(shape)).random(shape, np.float32)
    grid = DensityGrid(values)
    push = Push(grid, SphereTool(3, 5), Material(3.3, 0.02), border=border, band=band)
    history = push.remember()
    walk(push, points, continuous=True)
    push.restore(history)
    assert grid.density.tobytes() == values.tobytes()
