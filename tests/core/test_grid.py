# SPDX-License-Identifier: GPL-3.0-or-later
"""DensityGrid: what is taken, what is refused, and where voxels lie when it grows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from repousse.core import DensityGrid
from repousse.core.grid import union

boxes = st.tuples(st.tuples(*[st.integers(-5, 5)] * 3), st.tuples(*[st.integers(6, 12)] * 3))


def rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    turn = np.eye(4)
    turn[:2, :2] = [[c, -s], [s, c]]
    return turn


@pytest.mark.parametrize("dtype", [np.uint8, np.int64, np.float16, np.float32, np.float64, bool])
def test_any_real_numbers(dtype):
    grid = DensityGrid(np.ones((3, 4, 5), dtype))
    assert grid.density.dtype == np.float32 and grid.density.flags.c_contiguous
    assert grid.shape == (3, 4, 5) and grid.mass == 60.0


def test_a_copy_unless_told():
    values = np.zeros((3, 4, 5), np.float32)
    assert not np.shares_memory(DensityGrid(values).density, values)
    assert np.shares_memory(DensityGrid(values, copy=False).density, values)
    assert DensityGrid(values.T, copy=False).density.flags.c_contiguous


@given(arrays.arrays(np.float32, (4, 5, 6), elements=st.floats(0.0, 1.0, width=32)))
def test_mass_is_a_float64_sum(values):
    assert DensityGrid(values).mass == pytest.approx(float(values.astype(np.float64).sum()), rel=1e-12)


def test_mass_of_many_small_voxels():
    """A float32 sum of ten million tenths is off by more than 1e-7."""
    values = np.full((100, 100, 200), 0.1, np.float32)
    assert DensityGrid(values).mass == pytest.approx(values.size * float(np.float32(0.1)), rel=1e-12)


@pytest.mark.parametrize(
    "values",
    [
        np.zeros((0, 3, 3)),
        np.zeros((3, 3)),
        np.zeros(3),
        np.zeros((2, 2, 2, 2)),
        np.full((2, 2, 2), 1.001),
        np.full((2, 2, 2), -1e-6),
        np.full((2, 2, 2), np.nan),
        np.array([[[0.0, np.nan], [1.0, 0.5]]]),
        np.full((2, 2, 2), np.inf),
    ],
)
def test_bad_values(values):
    with pytest.raises(ValueError) as error:
        DensityGrid(values)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "transform",
    [
        np.eye(3),
        np.zeros((4, 4)),
        np.full((4, 4), np.nan),
        np.diag([1.0, 1.0, 1.02, 1.0]),
        np.array([[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]),
    ],
)
def test_bad_transforms(transform):
    with pytest.raises(ValueError) as error:
        DensityGrid(np.ones((2, 2, 2)), transform)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("transform", [np.eye(4), 0.25 * np.diag([1, 1, -1, 4]), np.diag([2, 2, 2, 1]) @ rotation(0.7)])
def test_good_transforms(transform):
    grid = DensityGrid(np.ones((2, 2, 2)), transform)
    assert grid.voxel_size == pytest.approx(np.cbrt(abs(np.linalg.det(transform[:3, :3]))))
    assert not np.shares_memory(grid.transform, transform)


@given(
    below=st.tuples(*[st.integers(0, 9)] * 3),
    above=st.tuples(*[st.integers(0, 9)] * 3),
    angle=st.floats(0.0, 6.0),
)
def test_growing_moves_nothing_in_the_world(below, above, angle):
    values = np.random.default_rng(0).random((3, 4, 5), np.float32)
    transform = rotation(angle) @ np.diag([0.5, 0.5, 0.5, 1.0])
    transform[:3, 3] = [7.0, -2.0, 11.0]
    grid = DensityGrid(values, transform)
    grid.grow(below, above)
    assert grid.shape == tuple(n + a + b for n, a, b in zip(values.shape, below, above))
    assert np.array_equal(grid.density[tuple(slice(b, b + n) for b, n in zip(below, values.shape))], values)
    assert grid.mass == pytest.approx(float(values.sum(dtype=np.float64)))
    index = np.array([1.0, 2.0, 3.0])
    assert grid.transform @ [*(index + below), 1.0] == pytest.approx(transform @ [*index, 1.0])
    assert grid.density.flags.c_contiguous and grid.density.dtype == np.float32


@given(boxes, boxes)
def test_union_of_boxes(first, second):
    both = union(first, second)
    assert both == union(second, first)
    for low, high in (first, second):
        assert all(a <= b for a, b in zip(both[0], low)) and all(a >= b for a, b in zip(both[1], high))
    assert union(first, None) == union(None, first) == first
    assert union(None, None) is None
