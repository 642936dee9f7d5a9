# SPDX-License-Identifier: GPL-3.0-or-later
"""Density that would leave the grid: the grid grows, a wall turns it back, or it goes and is counted."""

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.grid import BRICK

from .volumes import TINY, apart, half_space, in_frame, line, walk

N, R = 32, 5
MIDDLE = (N - 1) / 2
SIDES = [(axis, end) for axis in range(3) for end in (False, True)]


def towards(axis, end, depth):
    """A ball's centre, ``depth`` voxels from the far side of a full grid, that goes to side ``end`` of ``axis``."""
    position = np.full(3, MIDDLE)
    position[axis] = N - 0.5 - depth if end else depth - 0.5
    return position


def push_out(border, axis, end, transform=None):
    """Push from the middle of a full grid to one side of it; the push, its contacts and the grid before."""
    grid = DensityGrid(np.ones((N, N, N), np.float32), np.eye(4) if transform is None else transform)
    before = grid.density.copy()
    push = Push(grid, SphereTool(R), Material(3.3, 0.01), border=border)
    return push, walk(push, line(towards(axis, end, 14.0), towards(axis, end, 7.0), 0.4)), before


@pytest.mark.parametrize("side", SIDES)
def test_grow_pads_in_whole_bricks(kernels, side):
    """Only where density leaves, and every voxel stays where it was in the world."""
    axis, end = side
    transform = np.array([[0.0, 0.5, 0.0, 3.0], [-0.5, 0.0, 0.0, -2.0], [0.0, 0.0, 0.5, 7.0], [0.0, 0.0, 0.0, 1.0]])
    push, contacts, before = push_out("grow", axis, end, transform=transform)
    grid = push.grid
    grown = np.array(grid.shape) - N
    assert (grown % BRICK == 0).all() and grown[axis] > 0
    assert np.delete(grown, axis).max() == 0, "it left by one side only"
    below = -np.array(push.origin)
    assert below[axis] == (0 if end else grown[axis])
    assert (np.delete(below, axis) == 0).all()
    assert sum(contact.mass_out for contact in contacts) == 0.0
    assert grid.density.sum(dtype=np.float64) == pytest.approx(N**3, rel=1e-7)
    assert grid.density.flags.c_contiguous and grid.density.dtype == np.float32
    # The world position of what was the voxel (5, 6, 7) of the frame that the push was made in.
    index = np.array([5, 6, 7, 1.0])
    assert grid.transform @ (index + np.append(below, 0)) == pytest.approx(transform @ index)
    untouched = in_frame(grid, push.origin, (0, 0, 0), (N, N, N))
    far_corner = tuple(slice(0, 4) if a != axis else slice(24, None) if not end else slice(0, 8) for a in range(3))
    assert np.array_equal(untouched[far_corner], before[far_corner])


def changed_box(before, after):
    """The half-open box around all voxels that differ, or None."""
    where = np.nonzero(before != after)
    return None if not len(where[0]) else [(int(i.min()), int(i.max()) + 1) for i in where]


@pytest.mark.parametrize("border", ["grow", "wall", "open"])
@pytest.mark.parametrize("case", [(0.6, None), (1.0, None), (1.0, 5.0), (0.95, 3.0)])
def test_dirty_encloses_every_change(kernels, border, case):
    """In the frame that the push was made in, however often the grid has grown since."""
    density, band = case
    values = np.full((N, N, N), density, np.float32)
    values[:4] = 0.0  # air on one side, for the rim
    push = Push(DensityGrid(values), SphereTool(R), Material(3.3, TINY), border=border, band=band)
    low, shape = (-48, -48, -48), (N + 96,) * 3
    former = in_frame(push.grid, push.origin, low, shape)
    path = line((0.0, 14.0, 15.0), (7.0, 13.0, 15.0), 0.45) + line((7.0, 13.0, 15.0), (8.0, 4.0, 18.0), 1.7)
    grew = 0
    for position in path:
        size = push.grid.shape
        contact = push.move_to(position)
        grew += push.grid.shape != size
        now = in_frame(push.grid, push.origin, low, shape)
        changed = changed_box(former, now)
        if changed:
            assert contact.dirty is not None
            for axis in range(3):
                assert contact.dirty[0][axis] <= changed[axis][0] + low[axis]
                assert contact.dirty[1][axis] >= changed[axis][1] + low[axis]
        elif contact.dirty is not None:
            assert contact.sweeps > 0
        former = now
    assert grew or border != "grow" or density < 1.0
    assert all(a <= b for a, b in zip(low, push.origin))


def test_dirty_is_about_the_change(kernels):
    """Not the whole grid: no wider than the flow, of which the reach and a few planes of spreading are a bound."""
    push = Push(half_space(64, 0.4, 20), SphereTool(R), Material(3.3, 0.05))
    contacts = walk(push, line((14.0, 31.5, 31.5), (24.0, 31.5, 31.5), 0.5))
    boxes = [contact.dirty for contact in contacts if contact.dirty]
    assert boxes
    for low, high in boxes:
        assert max(b - a for a, b in zip(low, high)) <= 4 * R


@pytest.mark.parametrize("band", [None, 5.0])
def test_growth_changes_nothing_but_the_array(kernels, band):
    """A grid that grows holds the same as one that was large enough from the start."""
    values = np.zeros((80, 80, 80), np.float32)
    values[24:56, 24:56, 24:56] = 1.0
    roomy = Push(DensityGrid(values), SphereTool(R), Material(3.3, 0.01), band=band)
    tight = Push(DensityGrid(values[24:56, 24:56, 24:56]), SphereTool(R), Material(3.3, 0.01), band=band)
    path = line((-4.0, 15.0, 14.0), (9.0, 13.0, 16.0), 0.4)
    for position in path:
        first = roomy.move_to(np.array(position) + 24)
        second = tight.move_to(position)
        assert second.stress == pytest.approx(first.stress, rel=1e-6 if band is None else 1e-3, abs=1e-6)
    assert tight.grid.shape != (32, 32, 32)
    grown = in_frame(tight.grid, tight.origin, (-24, -24, -24), (80, 80, 80))
    if band is None:
        assert np.abs(grown - roomy.grid.density).max() <= 1e-6
    else:  # the rim asks voxels whether they are full, and other indices round otherwise
        assert apart(roomy.grid.density, grown, values) <= 5e-4


@pytest.mark.parametrize("side", SIDES)
def test_wall_puts_back(kernels, side):
    """Nothing leaves and nothing appears outside: what finds no room goes back, alike on both sides, and it says so."""
    axis, end = side
    push, contacts, before = push_out("wall", axis, end)
    assert push.grid.shape == (N, N, N) and push.origin == (0, 0, 0)
    assert any(contact.blocked for contact in contacts)
    assert sum(contact.mass_out for contact in contacts) == 0.0
    assert push.grid.mass == pytest.approx(N**3, rel=1e-7)
    assert np.abs(push.grid.density - before).max() < 1e-3
    for other in (a for a in range(3) if a != axis):
        assert np.abs(push.grid.density - np.flip(push.grid.density, other)).max() < 1e-5


def test_wall_gives_way_while_there_is_room(kernels):
    push = Push(DensityGrid(np.full((N, N, N), 0.2, np.float32)), SphereTool(R), Material(3.3, 0.01), border="wall")
    contacts = walk(push, line((14.0, MIDDLE, MIDDLE), (18.0, MIDDLE, MIDDLE), 0.4))
    assert not any(contact.blocked for contact in contacts)
    assert sum(contact.moved_mass for contact in contacts) > 100.0
    assert push.grid.mass == pytest.approx(0.2 * N**3, rel=1e-6)


def test_put_back_goes_to_the_outermost():
    """A part of what was taken finds no room: it is the tool's skin that has it again, not its middle."""
    values = np.ones((N, N, N), np.float32)
    values[28:] = 0.9
    push = Push(DensityGrid(values), SphereTool(R), Material(3.3, TINY), border="wall")
    push.move_to((14.0, MIDDLE, MIDDLE))
    contact = push.move_to((14.5, MIDDLE, MIDDLE))
    assert contact.blocked and contact.moved_mass > 10.0
    x, y, z = np.ogrid[:N, :N, :N]
    depth = -push.tool.volume.distance(x - 14.5, y - MIDDLE, z - MIDDLE)
    inner, outer = push.grid.density[depth > 3.0], push.grid.density[(depth > 0.5) & (depth < 1.5)]
    assert inner.mean() < outer.mean()


@pytest.mark.parametrize("side", SIDES)
def test_open_counts(kernels, side):
    """What left is what is missing, and it left on the way of the push."""
    axis, end = side
    push, contacts, _ = push_out("open", axis, end)
    out = sum(contact.mass_out for contact in contacts)
    assert push.grid.shape == (N, N, N)
    assert out > 20.0
    assert push.grid.mass + out == pytest.approx(N**3, rel=1e-7)
    assert not any(contact.blocked for contact in contacts)


def test_the_borders_agree_far_from_the_border():
    ends = []
    for border in ("grow", "wall", "open"):
        push = Push(half_space(48, 0.5, 16), SphereTool(R), Material(3.3, 0.05), border=border)
        walk(push, line((9.0, 23.5, 23.5), (18.0, 23.5, 23.5)))
        ends.append(push.grid.density)
    assert ends[0].tobytes() == ends[1].tobytes() == ends[2].tobytes()


def test_rim_at_a_border_grows(kernels):
    """Material that reaches the top of its array rises over it all the same."""
    grid = DensityGrid(np.ones((N, N, N), np.float32))
    push = Push(grid, SphereTool(R), Material(3.3, TINY), band=4.0)
    contacts = walk(push, line((-R - 1.0, MIDDLE, MIDDLE), (-2.0, MIDDLE, MIDDLE)))
    assert push.origin[0] < 0
    above = in_frame(grid, push.origin, (-8, 0, 0), (8, N, N)).sum(dtype=np.float64)
    assert above > 0.5 * sum(contact.moved_mass for contact in contacts)
    assert not any(contact.blocked for contact in contacts)
