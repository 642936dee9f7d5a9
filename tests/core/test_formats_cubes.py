# SPDX-License-Identifier: GPL-3.0-or-later
"""Unequal voxels made into cubes, against the overlap of intervals worked out one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.core.formats import FormatError, normalise

ratios = st.one_of(st.just(1.0), st.floats(1.02, 6.0), st.sampled_from([1.4, 1.5, 2.0, 2.0000000342, 2.5, 3.0]))


def overlaps(count, finer, ratio):
    """Share of each old voxel [i, i + 1) that each new one [j, j + 1) / ratio covers, in new voxels."""
    return np.array(
        [
            [max(0.0, min(i + 1, (j + 1) / ratio) - max(i, j / ratio)) * ratio for i in range(count)]
            for j in range(finer)
        ]
    )


@given(st.tuples(*[st.integers(1, 7)] * 3), st.tuples(ratios, ratios, ratios), st.floats(0.01, 90.0))
def test_cubes_hold_what_overlaps_them(shape, edges, scale):
    density = np.random.default_rng(sum(shape)).random(shape, np.float32)
    transform = np.diag([*(scale * np.array(edges)), 1.0])
    transform[:3, 3] = 5.0, -6.0, 7.0
    cubes, placed, note = normalise.cubed(density, transform, "x")
    smallest = min(edges)
    expected = density.astype(float)
    for axis in range(3):
        if max(edges) > 1.01 * smallest:
            ratio = edges[axis] / smallest
            expected = np.moveaxis(
                np.tensordot(overlaps(shape[axis], cubes.shape[axis], ratio), np.moveaxis(expected, axis, 0), 1),
                0,
                axis,
            )
    assert np.abs(cubes - expected).max() < 3e-6
    assert cubes.min() >= 0.0 and cubes.max() <= 1.0
    volume = abs(np.linalg.det(placed[:3, :3]))
    before = density.sum(dtype=float) * abs(np.linalg.det(transform[:3, :3]))
    assert cubes.sum(dtype=float) * volume == pytest.approx(before, rel=1e-6)
    corner = np.array([-0.5, -0.5, -0.5, 1.0])
    assert placed @ corner == pytest.approx(transform @ corner)  # the grid begins where it began
    assert (note is None) == (max(edges) <= 1.01 * smallest)


def test_float32_noise_in_a_transform_adds_no_layer():
    edges = np.array([0.009999999605339876, 0.019999999552965164, 0.009999999605339876])
    cubes, _, _ = normalise.cubed(np.ones((3, 95, 3), np.float32), np.diag([*edges, 1.0]), "x")
    assert cubes.shape == (3, 190, 3)
    assert np.abs(cubes - 1.0).max() < 1e-5


def test_rotation_is_kept_and_shear_is_refused():
    turn = np.eye(4)
    turn[:2, :2] = [[0.6, -0.8], [0.8, 0.6]]
    density = np.ones((2, 3, 4), np.float32)
    cubes, placed, _ = normalise.cubed(density, turn @ np.diag([1.0, 1.0, 2.0, 1.0]), "x")
    assert cubes.shape == (2, 3, 8)
    assert placed[:3, :3] == pytest.approx(turn[:3, :3])
    sheared = np.eye(4)
    sheared[0, 1] = 0.1
    with pytest.raises(FormatError, match=r"x: its transform shears"):
        normalise.cubed(density, sheared, "x")
    with pytest.raises(FormatError, match="without volume"):
        normalise.cubed(density, np.diag([1.0, 0.0, 1.0, 1.0]), "x")
    with pytest.raises(FormatError, match=r"as cubes its voxels would be 2 x 3 x 4000000000000"):
        normalise.cubed(density, np.diag([1.0, 1.0, 1e12, 1.0]), "x")
