# SPDX-License-Identifier: GPL-3.0-or-later
"""The visible level is found between what is empty and what is full."""

import numpy as np
import pytest

from repousse.core.level import automatic_level


def half(low, high, noise=0.0):
    """Half of a cube of each density, with noise."""
    values = np.full((40, 40, 40), low)
    values[20:] = high
    values += noise * np.random.default_rng(1).standard_normal(values.shape)
    return np.clip(values, 0.0, 1.0).astype(np.float32)


@pytest.mark.parametrize("full", [0.2, 0.6, 1.0])
def test_clay_in_air_is_seen_at_half_its_density(full):
    assert automatic_level(half(0.0, full)) == pytest.approx(0.5 * full, abs=0.005)
    assert automatic_level(half(0.0, full, 0.02)) == pytest.approx(0.5 * full, abs=0.06)


def test_air_may_have_a_density_as_in_a_scan():
    assert automatic_level(half(0.3, 0.9, 0.02)) == pytest.approx(0.6, abs=0.06)


def test_a_small_part_counts_as_well():
    values = np.zeros((50, 50, 50), np.float32)
    values[20:25, 20:25, 20:25] = 0.8
    assert automatic_level(values) == pytest.approx(0.4, abs=0.005)


@pytest.mark.parametrize("density", [0.1, 0.6, 1.0])
def test_where_nothing_is_empty_it_is_half_of_what_is_there(density):
    """A block that fills its grid: the border of the grid is its surface, not the noise within it."""
    assert automatic_level(np.full((20, 20, 20), density, np.float32)) == pytest.approx(0.5 * density, abs=0.005)
    noisy = half(density, density, 0.03)
    assert automatic_level(noisy) == pytest.approx(0.5 * noisy.mean(), abs=0.02)


def test_it_is_always_within_the_densities():
    assert automatic_level(np.zeros((4, 4, 4), np.float32)) == 0.5
    random = np.random.default_rng(2)
    for _ in range(30):
        values = random.random((12, 12, 12), dtype=np.float32) ** random.uniform(0.2, 5.0)
        assert 0.0 < automatic_level(values) < 1.0


def test_a_large_grid_is_judged_by_a_part_of_it():
    values = np.zeros((300, 200, 200), np.float32)
    values[:, :, 77:] = 0.5
    assert automatic_level(values) == pytest.approx(0.25, abs=0.005)
