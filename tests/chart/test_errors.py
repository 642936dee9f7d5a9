# SPDX-License-Identifier: GPL-3.0-or-later
"""Each error of the chart on a case whose value is known beforehand."""

import numpy as np
import pytest

from tests.bench.chart import errors, scenes
from tests.bench.chart.pareto import dominates, front


def block(n=12, face=8, density=0.5):
    values = np.zeros((4, 4, n), np.float32)
    values[:, :, :face] = density
    return values


def moved(before, amount, *places):
    """``amount`` of every column taken from one plane and put into another, for each pair (from, to)."""
    after = before.astype(np.float64)
    for source, target in places:
        after[:, :, source] -= amount
        after[:, :, target] += amount
    return after


def test_mass_is_a_share_of_the_whole():
    before = block()
    lost = before.copy()
    lost[:, :, 7] = 0.0  # one of eight planes
    assert errors.mass(before, lost) == pytest.approx(1 / 8)
    assert errors.mass(before, moved(before, 0.25, (7, 3))) == pytest.approx(0.0, abs=1e-12)


def test_density_l1_of_what_never_moved_and_of_what_moved_elsewhere():
    before = block()
    truth = moved(before, 0.25, (7, 5))
    assert errors.density_l1(before, truth, truth) == 0.0
    assert errors.density_l1(before, truth, before) == pytest.approx(1.0)
    assert errors.density_l1(before, truth, moved(before, 0.25, (7, 4))) == pytest.approx(1.0)  # the pit is right
    assert errors.density_l1(before, truth, moved(before, 0.25, (2, 1))) == pytest.approx(2.0)


@pytest.mark.parametrize(("target", "away"), [(5, 0.0), (4, 1.0), (2, 3.0), (6, 1.0)])
def test_density_w1_is_the_way_along_the_push(target, away):
    before = block()
    truth, found = moved(before, 0.25, (7, 5)), moved(before, 0.25, (7, target))
    assert errors.density_w1(before, truth, found, 2, 8) == pytest.approx(away)
    lying = [np.moveaxis(values, 2, 0) for values in (before, truth, found)]
    assert errors.density_w1(*lying, 0, 8) == pytest.approx(away)


def test_density_w1_of_what_was_thrown_away_is_its_way_out():
    """Mass that should lie in plane 5 and is nowhere: three planes below the face."""
    before = block()
    truth, carved = moved(before, 0.25, (7, 5)), before.astype(np.float64)
    carved[:, :, 7] -= 0.25
    assert errors.density_w1(before, truth, carved, 2, 8) == pytest.approx(3.0)
    risen = moved(before, 0.25, (7, 9))  # and two above it where it should not be
    assert errors.density_w1(before, truth, risen, 2, 8) == pytest.approx(3.0 + 2.0)


def test_force_does_not_ask_for_the_unit():
    truth = np.linspace(0.0, 2.0, 9)
    assert errors.force(truth, 17.0 * truth) == pytest.approx(0.0, abs=1e-12)


def test_force_of_a_curve_at_right_angles_to_the_truth():
    """The best factor is 0, so what is left is the truth's own root mean square over its peak."""
    truth, found = np.array([1.0, 1.0, 2.0]), np.array([1.0, -1.0, 0.0])
    assert errors.force(truth, found) == pytest.approx(np.sqrt(2.0) / 2.0)
    assert errors.force(truth, np.zeros(3)) == errors.force(truth, np.full(3, np.nan)) == pytest.approx(np.sqrt(2) / 2)


def test_force_that_pulls_is_no_force():
    truth = np.array([1.0, 1.0, 2.0])
    assert errors.force(truth, -truth) == errors.force(truth, np.zeros(3))


def test_force_of_a_square_for_a_line():
    """min over c of the integral of (x - c x^2)^2 on 0..1 is 1/3 - 2/4 c + c^2/5 at c = 5/4: 1/48."""
    x = np.linspace(0.0, 1.0, 20001)
    assert errors.force(x, x**2) == pytest.approx(np.sqrt(1 / 48), rel=1e-3)


def test_yield_depth_is_where_the_curve_bends():
    depth = np.linspace(0.0, 10.0, 41)
    assert errors.yield_depth(depth, np.minimum(3.0 * depth, 9.3 + 0.2 * (depth - 3.1))) == pytest.approx(3.1, abs=1e-6)
    assert np.isnan(errors.yield_depth(depth, depth**2))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_surface_of_a_plane_between_voxels(axis, sign):
    """Material up to x = 7.25 in index space: voxel 7 is three quarters full."""
    along = np.clip(7.25 + 0.5 - np.arange(16.0), 0.0, 1.0)[:: sign if sign > 0 else -1]
    shape = [1, 1, 1]
    shape[axis] = 16
    values = np.broadcast_to(along.reshape(shape), [16 if a == axis else 5 for a in range(3)])
    height = errors.surface(values, axis, sign)
    expected = 7.25 if sign > 0 else -(15 - 7.25)
    assert height.shape == (5, 5)
    np.testing.assert_allclose(height, expected, atol=0.26)  # linear between centres, by at most a quarter off
    full = np.where(values > 0.5, 1.0, 0.0)
    np.testing.assert_allclose(errors.surface(full, axis, sign), 7.5 if sign > 0 else -7.5)


def test_occupancy_of_a_surface_that_is_too_high():
    truth = np.full((6, 6), -2.0)
    truth[:3] = 1.0  # a pit of 36 voxels beside
    found = truth + 0.5
    assert errors.occupancy(truth, found) == pytest.approx(36 * 0.5 / 2.0 / 36.0)
    assert errors.occupancy(truth, np.zeros((6, 6))) == pytest.approx((36 + 18) / 72)


def test_pile_up_has_no_sign():
    assert errors.pile_up(0.33, 0.30) == errors.pile_up(0.30, 0.33) == pytest.approx(0.03)


def test_direction_is_the_worst_of_all():
    straight = np.array([[1.0, -1.0], [2.0, 0.0]])
    assert errors.direction(straight, [straight, 1.25 * straight, 0.9 * straight]) == pytest.approx(0.25)


def test_symmetry():
    before = np.ones((5, 5, 6), np.float32)
    found = before.copy()
    found[2, 2, 5] = 0.0
    found[2, 2, 0] = 2.0
    assert errors.symmetry(before, found, 2) == 0.0
    found[2, 2, 0] = 1.0
    found[1, 2, 0] = 2.0  # all that was moved, to one side
    assert errors.symmetry(before, found, 2) == pytest.approx(1.0)
    found[1, 2, 0] = found[3, 2, 0] = 1.5  # what no mirror tells, a quarter turn does
    assert errors.symmetry(before, found, 2) == pytest.approx(1.0)


def test_rings_hold_the_mass_that_moved():
    """A ball taken out of the middle, and the same volume put into rings ahead of it: gains and losses are exact sums
    wherever a ring is filled evenly, however the push lies in the lattice."""
    for direction in ((0.0, 0.0, -1.0), (1.0, 1.0, 1.0), (0.8, 0.5, 0.33)):
        scene = scenes.aslant(48, 8.0, 4.0, 0.5, 0.1, direction)
        u = np.array(scene.direction)
        offsets = np.indices(scene.density.shape) - 23.5
        along = np.tensordot(u, offsets, 1)
        radius = np.sqrt(np.maximum((offsets**2).sum(axis=0) - along**2, 0.0))
        plug = np.clip(8.5 - radius, 0.0, 1.0) * np.clip(4.5 - np.abs(along - 8.0), 0.0, 1.0)
        ring = scenes.rings(scene, scene.density + 0.25 * plug)
        assert ring.sum() == pytest.approx(0.25 * np.pi * 8.0**2 * 8.0, rel=0.02)
        middle = (ring.sum(axis=1) * np.arange(len(ring)) * 2.0).sum() / ring.sum() - 0.4 * 48
        assert middle == pytest.approx(8.0, abs=0.1)


def test_the_front_has_what_nothing_beats():
    points = [(1.0, 5.0), (2.0, 3.0), (2.0, 4.0), (3.0, 3.0), (0.5, 9.0), (4.0, 1.0), (float("nan"), 0.0)]
    assert front(points) == [4, 0, 1, 5]
    assert dominates((1.0, 1.0), (1.0, 2.0)) and not dominates((1.0, 1.0), (1.0, 1.0))
    for i, point in enumerate(points[:-1]):
        assert any(dominates(points[j], point) for j in front(points)) == (i not in front(points))
