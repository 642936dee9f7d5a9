# SPDX-License-Identifier: GPL-3.0-or-later
"""Leaps: far from the tool, through full material, the flux goes 16 planes at once (core/dispersion.py)."""

import importlib.util

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool, dispersion
from repousse.core.native.state import BORDERS, DONE, Workspace, no_box
from repousse.core.plasticity import estimate

from .volumes import TINY, apart, carried, carried_point, cube_motions, half_space, kernels_chosen, line, walk

OBLIQUE = [(1.0, 0.0, 0.0), (0.9, 0.3, -0.2), (0.8, 0.5, 0.33), (0.3, -0.9, 0.1), (0.2, 0.25, -0.95)]


def moments(kernel, hole):
    """Mean and covariance of what one voxel of flux becomes, in voxels."""
    weights = np.array(kernel.weights).reshape(3, 3)
    taps = np.arange(-1, 2) * hole
    place = np.stack(np.meshgrid(taps + kernel.shift[0], taps + kernel.shift[1], indexing="ij"))
    mean = (weights * place).sum(axis=(1, 2))
    off = place - mean[:, None, None]
    return mean, np.einsum("bc,ibc,jbc->ij", weights, off, off)


@pytest.mark.parametrize("direction", OBLIQUE)
def test_a_leap_spreads_as_the_planes_that_it_passes(direction):
    """Its kernel's mean is that of 16 planes, and its covariance D/|u_a| (I + s s^T) for each, as the fine kernel's."""
    u = np.array(direction) / np.linalg.norm(direction)
    axis = int(np.abs(u).argmax())
    shear = np.delete(u, axis) / abs(u[axis])
    mean, covariance = moments(dispersion.spreading(tuple(u), axis, dispersion.HOLE), dispersion.HOLE)
    wanted = dispersion.DISPERSION / abs(u[axis]) * (np.eye(2) + np.outer(shear, shear))
    assert mean == pytest.approx(dispersion.LEAP * shear, abs=1e-5)
    assert np.diag(covariance) == pytest.approx(dispersion.LEAP * np.diag(wanted), rel=1e-5)
    fine = moments(dispersion.spreading(tuple(u), axis), 1)
    assert np.array(dispersion.spreading(tuple(u), axis, dispersion.HOLE).weights).sum() == 1.0
    assert mean == pytest.approx(dispersion.LEAP * fine[0], abs=1e-5)


def swept(density, direction, leap, centre, radius=6.0, border="wall", band=None):
    """The workspace after one sweep of nearly all that was in the tool."""
    work = Workspace(density.copy())
    work.take_up(SphereTool(radius))
    work.tool.centre[:] = centre
    axis = dispersion.dominant_axis(direction)
    estimate(work)
    dispersion.empty(work, axis, 0.9 * work.estimate.tool_mass, False)
    work.sweep.dirty[:] = no_box()
    dispersion.aim(work, direction, axis, BORDERS.index(border), band, leap)
    dispersion.sweep_emptied(work)
    assert dispersion.sweep(work) == DONE
    return work


def slab(axis, shape=(110, 76, 76), first=8, last=96):
    """A full slab with air before and behind it along an axis; shape and planes as for axis 0."""
    values = np.zeros(shape, np.float32)
    values[first:last] = 1.0
    return np.moveaxis(values, 0, axis).copy()


def along(axis, sign=1.0, aside=(0.0, 0.0)):
    """A unit vector that goes mostly along an axis."""
    u = np.insert(np.array(aside), axis, sign)
    return tuple((u / np.linalg.norm(u)).tolist())


def there(axis, place=(10.0, 37.5, 37.5), sign=1.0):
    """Where the tool is: just inside the slab, on the side that ``sign`` comes from."""
    first = place[0] if sign > 0 else 103.0 - place[0]
    return np.insert(np.array(place[1:]), axis, first)


@pytest.mark.parametrize("aside", [(0.0, 0.0), (0.12, -0.05)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_what_arrives_is_the_same(kernels, axis, sign, aside):
    """Mean, spread and mass of what comes out at the far side, though less than half of the planes were looked at."""
    u = along(axis, sign, aside)
    works = [swept(slab(axis), u, leap, there(axis, sign=sign)) for leap in (False, True)]
    fine, leaping = works
    assert leaping.sweep.visited < 0.5 * fine.sweep.visited and leaping.sweep.planes < 0.5 * fine.sweep.planes
    ends = []
    for work in works:
        out = np.moveaxis(work.density, axis, 0)
        beyond = (out[96:] if sign > 0 else out[:8]).sum(axis=0, dtype=np.float64)
        b, c = np.indices(beyond.shape)
        mean = [(beyond * i).sum() / beyond.sum() for i in (b, c)]
        ends.append((beyond, beyond.sum(), *mean, (beyond * (b - mean[0]) ** 2).sum() / beyond.sum()))
    assert ends[0][1] > 100.0
    assert ends[1][1] == pytest.approx(ends[0][1], rel=1e-6)
    assert ends[1][2:4] == pytest.approx(ends[0][2:4], abs=0.02)
    assert ends[1][4] == pytest.approx(ends[0][4], rel=0.005)
    assert np.abs(ends[1][0] - ends[0][0]).sum() / 2.0 < 0.01 * ends[0][1]
    total = leaping.sweep.laid + leaping.sweep.mass_out + leaping.sweep.surplus
    assert total == pytest.approx(leaping.emptied.mass, rel=1e-6)


@pytest.mark.skipif(not importlib.util.find_spec("repousse_kernels"), reason="the compiled kernels are not installed")
@pytest.mark.parametrize("aside", [(0.0, 0.0), (0.35, -0.2), (-0.35, 0.38)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_twins(monkeypatch, axis, sign, aside):
    """The compiled leap and its numpy twin: the same planes, voxels and flux."""
    works = []
    for name in ("compiled", "numpy"):
        with kernels_chosen(monkeypatch, name):
            works.append(swept(slab(axis), along(axis, sign, aside), True, there(axis, sign=sign)))
    compiled, numpy = works
    assert apart(numpy.density, compiled.density, slab(axis)) <= 1e-5
    assert (compiled.sweep.planes, compiled.sweep.visited) == (numpy.sweep.planes, numpy.sweep.visited)
    for name in ("laid", "reach_gain", "mass_out", "surplus"):
        expected = getattr(numpy.sweep, name)
        assert getattr(compiled.sweep, name) == pytest.approx(expected, abs=1e-5 * numpy.emptied.mass)


@pytest.mark.parametrize("axis", [0, 2])
def test_room_is_never_leapt_over(kernels, axis):
    """One voxel with room, anywhere in the way of the flux, takes what a sweep plane by plane gives it."""
    u = along(axis)
    for depth in (19, 30, 34, 35, 50, 60, 95):  # the first leap is from 19 to 34
        values = slab(axis)
        pocket = tuple(np.insert([37, 37], axis, depth))
        values[pocket] = 0.2
        fine, leaping = (swept(values, u, leap, there(axis)) for leap in (False, True))
        assert fine.density[pocket] == 1.0
        assert leaping.density[pocket] == pytest.approx(1.0, abs=1e-6)
        assert leaping.sweep.visited < 0.75 * fine.sweep.visited


@pytest.mark.parametrize("band", [30.0, 47.0, 60.0])
@pytest.mark.parametrize("aside", [(0.0, 0.0), (0.3, -0.2)])
def test_nothing_is_laid_beyond_a_band(kernels, aside, band):
    """What reaches the band is surplus, also where it lies within a leap of planes."""
    u = along(0, 1.0, aside)
    fine, leaping = (swept(slab(0), u, leap, there(0), band=band) for leap in (False, True))
    assert leaping.sweep.planes < fine.sweep.planes
    assert leaping.sweep.surplus == pytest.approx(fine.sweep.surplus, rel=1e-6) and fine.sweep.surplus > 300.0
    assert leaping.sweep.surplus == pytest.approx(fine.emptied.mass - fine.sweep.laid, rel=1e-6)
    assert leaping.density[96:].sum() == 0.0


@pytest.mark.parametrize("border", BORDERS)
def test_mass_and_bounds_at_every_border(kernels, border):
    """Material up to the grid's sides and end: mass before = mass after + mass out, every voxel in [0, 1]."""
    values = np.zeros((64, 30, 30), np.float32)
    values[10:] = 1.0
    push = Push(DensityGrid(values), SphereTool(6), Material(3.3, 0.02), border=border, quality="balanced")
    before, history = push.grid.mass, push.remember()
    contacts = walk(push, line((4.0, 14.5, 14.5), (14.0, 14.9, 14.5), 0.5))
    out = sum(contact.mass_out for contact in contacts)
    assert sum(contact.moved_mass for contact in contacts) > 100.0 or border == "wall"
    assert abs(push.grid.mass + out - before) <= 1e-7 * before
    assert push.grid.density.min() >= 0.0 and push.grid.density.max() <= 1.0
    assert (out > 100.0) == (border == "open")
    push.restore(history)
    assert push.grid.density.tobytes() == values.tobytes()


@pytest.mark.parametrize("middle", [15.0, 15.5])
def test_fourfold_symmetry(kernels, middle):
    """A leap has no lattice of its own: with the axis on a voxel or between two, what comes out is symmetric."""
    n = int(2 * middle) + 1
    values = np.zeros((72, n, n), np.float32)
    values[8:64, 2:-2, 2:-2] = 1.0
    push = Push(DensityGrid(values), SphereTool(5), Material(3.3, TINY), quality="draft", border="open")
    walk(push, line((2.0, middle, middle), (9.0, middle, middle), 1.0))
    out = push.grid.density
    assert out[64:].sum() > 50.0
    for image in (out[:, ::-1], out[:, :, ::-1], out.transpose(0, 2, 1)):
        assert apart(out, image, values) <= 1e-5


def test_the_cubes_symmetries(kernels):
    """The 48 motions of the cube, with the axis of the push off the lattice."""
    n, values = 56, half_space(56, 1.0, 8).density
    values[48:] = values[:, :3] = values[:, -3:] = values[:, :, :3] = values[:, :, -3:] = 0.0
    path = [np.array(p) for p in line((2.0, 27.2, 26.6), (6.0, 28.0, 26.9), 1.0)]
    outcomes = []
    motions = cube_motions() if kernels == "compiled" else cube_motions()[::7]
    for order, turned in motions:
        push = Push(
            DensityGrid(carried(values, order, turned).copy()),
            SphereTool(5),
            Material(3.3, TINY),
            border="open",
            quality="balanced",
        )
        walk(push, [carried_point(point, n, order, turned) for point in path])
        outcomes.append((push.grid.density, carried(values, order, turned), order, turned))
    first = outcomes[0][0]
    for density, before, order, turned in outcomes[1:]:
        assert apart(carried(first, order, turned), density, before) <= 1e-5


def test_cost_of_the_far_sweep(kernels):
    """Counted: through 160 planes of full material a quarter of the exact sweep's voxels are looked at."""
    visited = {}
    for quality in ("exact", "balanced", "draft"):
        push = Push(half_space((160, 64, 64), 1.0, 10), SphereTool(8), Material(3.3, 0.05), border="open")
        walk(push, line((2.0, 31.5, 31.5), (8.0, 31.5, 31.5), 1.0), quality=quality)
        visited[quality] = push.voxels_visited
    assert visited["balanced"] < 0.25 * visited["exact"]
    assert visited["draft"] < 0.8 * visited["balanced"]
