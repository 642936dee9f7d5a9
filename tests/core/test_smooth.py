# SPDX-License-Identifier: GPL-3.0-or-later
"""Smooth: density evens out inside the tool, none is made or lost, and nothing else changes."""

from itertools import pairwise

import numpy as np
import pytest

from repousse.core import BoxTool, CapsuleTool, DensityGrid, Material, Push, Regime, SphereTool, smooth

from .volumes import carried, carried_point, speckled, walk

N = 40
MIDDLE = (N - 1) / 2
CLAY = Material(3.3, 0.05)


def bumpy(seed=3):
    """A surface across z with bumps of one voxel's width and 1.5 voxels' height."""
    height = N / 2 + np.random.default_rng(seed).normal(0.0, 1.5, (N, N))
    return DensityGrid(np.clip(height[:, :, None] - np.arange(N) + 0.5, 0.0, 1.0).astype(np.float32))


def roughness(values):
    """Sum of the squared differences of neighbours, those of all three directions."""
    return sum(float((np.diff(values.astype(np.float64), axis=axis) ** 2).sum()) for axis in range(3))


def smoother(grid, radius=6, tool=None, **options):
    return Push(grid, tool or SphereTool(radius), CLAY, verb="smooth", **options)


def places(spacing=0.5, low=10.0, high=30.0):
    return [(x, MIDDLE, MIDDLE) for x in np.arange(low, high + 1e-9, spacing)]


@pytest.mark.parametrize("strength", [0.3, 1.0])
@pytest.mark.parametrize("tool", [SphereTool(6), BoxTool((4, 6, 5), 3), CapsuleTool((1, 4, 2), 4)])
def test_mass_bounds_and_roughness(kernels, tool, strength):
    """Every move leaves as much mass, within [0, 1], and no more roughness than there was."""
    grid = bumpy()
    mass, push = grid.mass, smoother(grid, tool=tool)
    rough = [roughness(grid.density)]
    for place in places():
        push.move_to(place, strength=strength)
        rough.append(roughness(grid.density))
    assert all(after <= before for before, after in pairwise(rough))
    assert rough[-1] < 0.97 * rough[0]
    assert grid.mass == pytest.approx(mass, rel=1e-7)
    assert grid.density.min() >= 0.0 and grid.density.max() <= 1.0


def test_the_surface_gets_flatter(kernels):
    """What is seen: the height of the surface varies far less where the tool went, and is as high as it was."""
    grid = bumpy()
    before = grid.density.sum(axis=2)[14:27, 18:23]
    walk(smoother(grid), places())
    after = grid.density.sum(axis=2)[14:27, 18:23]
    assert after.std() < 0.35 * before.std()
    assert after.mean() == pytest.approx(before.mean(), abs=0.3)


def test_stronger_is_smoother(kernels):
    rough = []
    for strength in (0.0, 0.2, 0.5, 1.0):
        grid = bumpy()
        walk(smoother(grid), places(), strength=strength)
        rough.append(roughness(grid.density))
    assert all(after < 0.99 * before for before, after in pairwise(rough))


def test_a_checkerboard_is_gone(kernels):
    """The finest of all patterns as well: none changes its sign and lives on."""
    values = (0.2 + 0.6 * (np.indices((N,) * 3).sum(axis=0) % 2)).astype(np.float32)
    grid = DensityGrid(values)
    smoother(grid).move_to((MIDDLE,) * 3)
    inside = grid.density[18:22, 18:22, 18:22]
    assert inside == pytest.approx(0.5, abs=1e-3)


def test_holding_still_does_nothing_more(kernels):
    """The first contact smooths once; then it takes a quarter radius of travel, however that is cut."""
    grid = bumpy()
    push, start = smoother(grid, 8), (15.0, MIDDLE, MIDDLE)
    contact = push.move_to(start)
    assert contact.moved_mass > 1.0 and contact.regime is Regime.PLASTIC
    once = grid.density.tobytes()
    for _ in range(3):
        assert push.move_to(start).moved_mass == 0.0
    moved = [push.move_to((15.0 + 0.19 * n, MIDDLE, MIDDLE)).moved_mass for n in range(1, 11)]
    assert not any(moved) and grid.density.tobytes() == once  # 1.9 voxels
    moved = [push.move_to((15.0 + 0.19 * n, MIDDLE, MIDDLE)).moved_mass for n in range(11, 43)]
    assert [n for n, mass in enumerate(moved, start=11) if mass > 0.0] == [11, 22, 32]  # past 2, 4 and 6 voxels
    push.lift()
    assert push.move_to((15.0 + 7.99, MIDDLE, MIDDLE)).moved_mass > 0.0


def test_spacing_does_not_matter(kernels):
    """The same way in longer moves is the same work."""
    ends = []
    for spacing in (0.5, 1.0, 2.5):
        grid = bumpy()
        walk(smoother(grid), places(spacing))
        ends.append(grid.density.tobytes())
    assert ends[0] == ends[1] == ends[2]


def test_only_the_tool_is_smoothed(kernels):
    """Nothing outside its skin changes, and the dirty box holds all that does."""
    grid = bumpy()
    before = grid.density.copy()
    centre = (17.2, 21.4, 19.9)
    contact = smoother(grid).move_to(centre)
    covered = SphereTool(6).volume.coverage(*np.ix_(*(np.arange(N) - c for c in centre)))
    changed = grid.density != before
    assert changed.any() and not changed[covered == 0.0].any()
    (i0, j0, k0), (i1, j1, k1) = contact.dirty
    assert changed[i0:i1, j0:j1, k0:k1].sum() == changed.sum()
    assert contact.moved_mass > 1.0


def test_no_traces_in_the_air(kernels):
    """Density does not creep away in ever smaller traces: the air a few voxels off stays empty, tool or not."""
    values = np.zeros((N,) * 3, np.float32)
    values[:, :, : N // 2] = 0.9
    grid = DensityGrid(values)
    walk(smoother(grid, 12), places(), strength=0.2)
    assert grid.density[20, 20, N // 2] > 0.1
    assert not grid.density[:, :, N // 2 + 7 :].any()


def test_uniform_material_stays_as_it_is(kernels):
    """At the grid's border too: nothing flows across it."""
    grid = DensityGrid(np.full((20, 20, 20), 0.37, np.float32))
    before = grid.density.tobytes()
    push = smoother(grid)
    contacts = walk(push, [(x, 2.0, 18.0) for x in np.arange(-3.0, 23.0, 0.5)])
    assert grid.density.tobytes() == before and grid.shape == (20, 20, 20)
    assert all(contact.dirty is None for contact in contacts)


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 1, 0)])
@pytest.mark.parametrize("turned", [(False, False, False), (True, False, True)])
def test_symmetry(kernels, order, turned):
    """Turned and mirrored to 1e-6; mirrored alone bit for bit."""
    values = speckled(N).density

    def smoothed(values, at):
        grid = DensityGrid(values)
        walk(smoother(grid, 5), [tuple(point) for point in at])
        return grid.density

    path = np.array([(14.0 + 0.5 * n, 17.0 + 0.25 * n, 24.0) for n in range(16)])
    there = smoothed(carried(values, order, turned), [carried_point(p, N, order, turned) for p in path])
    here = carried(smoothed(values, path), order, turned)
    assert np.abs(here - there).max() <= 1e-6
    if order == (0, 1, 2):
        assert here.tobytes() == there.tobytes()


def test_larger_tools_even_out_larger_bumps():
    assert smooth.passes_of(SphereTool(1.0)) == 1
    assert smooth.passes_of(SphereTool(32.0)) == 16
