# SPDX-License-Identifier: GPL-3.0-or-later
"""Before-images: a grid is made what it was, bit for bit, and only what was touched is kept."""

import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.bricks import BRICK, MIXED
from repousse.core.history import _Bricks

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
    assert history.images <= history.bricks
    assert history.nbytes == history.images * BRICK**3 * 4 + history.bricks * 16


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("band", [None, 5.0])
def test_what_was_empty_or_full_needs_no_image(kernels, band, axis):
    """A stroke through full clay keeps images of its surface alone, and one through foam of all."""
    kept = {}
    for density in (1.0, 0.5):
        grid = half_space(48, density, 20, axis=axis)
        states = grid.bricks.states.copy()
        push = Push(grid, SphereTool(5), Material(3.3, 0.02), border="open", band=band)
        history = push.remember()
        start, end = np.full(3, 24.0), np.full(3, 24.0)
        start[axis], end[axis] = 13.0, 32.0
        before = grid.density.copy()
        walk(push, line(start, end, 0.8))
        mixed = states.reshape(-1)[history._now.bricks[: history.bricks]] == MIXED
        assert history.images == mixed.sum() > 0
        assert np.array_equal(history.original(everywhere(grid.shape)), np.pad(before, 2).ravel())
        kept[density] = history.images / history.bricks
        push.restore(history)
        assert np.array_equal(grid.density, before) and np.array_equal(grid.bricks.states, states)
    assert kept[1.0] <= 0.85 and kept[0.5] == 1.0


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


def everywhere(shape, margin=2):
    """All voxels of a grid, and ``margin`` around it."""
    return np.stack(np.indices(np.array(shape) + 2 * margin).reshape(3, -1), axis=1) - margin


@pytest.mark.parametrize("case", CASES)
def test_tells_what_was_there(kernels, case):
    """At every voxel, after growth too; around the grid as it was there was nothing."""
    make, options = CASES[case]
    push = Push(make(), SphereTool(5), Material(3.3, 0.02), **options)
    before, shape = push.grid.density.copy(), push.grid.shape
    asked, expected = everywhere(shape), np.pad(before, 2).ravel()
    remembered = push.remember()
    assert np.array_equal(remembered.original(asked), expected)
    for position in paths(shape)[::4]:
        push.move_to(position, continuous=True)
        some = np.random.default_rng(0).choice(len(asked), 500)
        assert np.array_equal(remembered.original(asked[some]), expected[some])
    told = remembered.original(asked)
    assert told.dtype == np.float32 and np.array_equal(told, expected)
    assert remembered.original(np.empty((0, 3), np.int64)).shape == (0,)


@pytest.mark.parametrize("case", ["sweep", "growth and rim"])
def test_tells_what_was_there_when_pushed_between_its_looks(kernels, case, monkeypatch):
    """It looks at the voxels, asks what has been kept, and takes that: a push before or after asking is no matter."""
    make, options = CASES[case]
    push = Push(make(), SphereTool(5), Material(3.3, 0.02), **options)
    asked, expected = everywhere(push.grid.shape), np.pad(push.grid.density, 2).ravel()
    remembered = push.remember()
    way, numbers = iter(paths(push.grid.shape)), _Bricks.numbers

    def keep_another_brick():
        count = remembered.bricks
        while remembered.bricks == count:
            push.move_to(next(way), continuous=True)

    def between_two_pushes(bricks, wanted):
        keep_another_brick()
        found = numbers(bricks, wanted)
        keep_another_brick()
        return found

    monkeypatch.setattr(_Bricks, "numbers", between_two_pushes)
    for _ in range(2):
        assert np.array_equal(remembered.original(asked), expected)


@pytest.mark.parametrize("case", ["rim", "growth and rim"])
def test_tells_what_was_there_while_another_thread_pushes(case):
    make, options = CASES[case]
    push = Push(make(), SphereTool(5), Material(3.3, 0.02), **options)
    asked, expected = everywhere(push.grid.shape), np.pad(push.grid.density, 2).ravel()
    remembered = push.remember()
    pushing = threading.Thread(target=walk, args=(push, paths(push.grid.shape) * 5), kwargs={"continuous": True})
    pushing.start()
    random, answers = np.random.default_rng(0), 0
    while pushing.is_alive():
        some = random.integers(0, len(asked), 3000)
        assert np.array_equal(remembered.original(asked[some]), expected[some])
        answers += 1
    pushing.join()
    assert answers > 10 and remembered.bricks > 0


@pytest.mark.parametrize("case", CASES)
def test_what_was_touched(kernels, case):
    """The box holds every voxel that a restore changes back, and lies within the grid as it was."""
    make, options = CASES[case]
    push = Push(make(), SphereTool(5), Material(3.3, 0.02), **options)
    before, shape = push.grid.density.copy(), push.grid.shape
    remembered = push.remember()
    assert remembered.touched is None
    walk(push, paths(shape))
    changed = np.argwhere(in_frame(push.grid, push.origin, (0, 0, 0), shape) != before)
    low, high = np.array(remembered.touched)
    assert (low >= 0).all() and (high <= shape).all()
    assert (low <= changed.min(axis=0)).all() and (changed.max(axis=0) < high).all()


def test_several_pushes_keep_in_one_history():
    """Each tells of a growth when it notices; it counts once."""
    grid = DensityGrid(np.ones((27, 26, 25), np.float32))
    before, transform = grid.density.copy(), grid.transform.copy()
    first, second = (Push(grid, SphereTool(5), Material(3.3, 0.02)) for _ in range(2))
    remembered = first.remember()
    second.join(remembered)
    for step in range(12):
        first.move_to((9.0 - 0.5 * step, 12.0, 12.0))
        second.move_to((12.0, 12.0, 9.0 - 0.5 * step))
    assert min(grid.grown) >= 0 and sum(g > 0 for g in grid.grown) >= 2
    assert np.array_equal(remembered.original(everywhere(before.shape)), np.pad(before, 2).ravel())
    first.restore(remembered)
    second.forget(remembered, 0.0)
    assert np.array_equal(grid.density, before) and np.array_equal(grid.transform, transform)
