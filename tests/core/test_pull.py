# SPDX-License-Identifier: GPL-3.0-or-later
"""Pull: material comes out along the direction given, what is left is looser by the strength, and nothing is hollow."""

import numpy as np
import pytest

from repousse.core import BoxTool, CapsuleTool, DensityGrid, Material, Push, Regime, SphereTool

from .volumes import apart, carried, carried_point, half_space, speckled, walk

N, SURFACE = 56, 24
CLAY = Material(3.3, 0.05)
OUT = (0.0, 0.0, 1.0)
MIDDLE = (N - 1) / 2


def slab(density):
    """Material below the plane z = SURFACE - 1/2."""
    values = np.zeros((N,) * 3, np.float32)
    values[:, :, :SURFACE] = density
    return DensityGrid(values)


def puller(grid, radius=6, tool=None, **options):
    return Push(grid, tool or SphereTool(radius), CLAY, verb="pull", **options)


def depth_of(radius):
    """Where a tool's centre is that touches the surface from below."""
    return SURFACE - 0.5 - radius


def drag(grid, radius, strength, spacing=0.5, low=16.0, high=39.0, y=MIDDLE):
    push = puller(grid, radius)
    places = np.arange(low, high + 1e-9, spacing)
    return push, walk(push, [(x, y, depth_of(radius)) for x in places], direction=OUT, strength=strength)


@pytest.mark.parametrize("strength", [0.05, 0.15, 0.3])
@pytest.mark.parametrize("density", [1.0, 0.35])
@pytest.mark.parametrize("radius", [6, 9])
def test_a_touch_raises_what_the_strength_says(kernels, radius, density, strength):
    """The column through the middle gives the strength's share of a diameter; a tenth of it spreads to the sides."""
    grid = slab(density)
    before, mass = grid.density.copy(), grid.mass
    contact = puller(grid, radius).move_to((MIDDLE, MIDDLE, depth_of(radius)), direction=OUT, strength=strength)
    raised = grid.density[N // 2, N // 2, SURFACE:].sum()
    assert 0.89 <= raised / (2 * radius * strength * density) <= 1.0
    assert contact.regime is Regime.PLASTIC
    assert contact.moved_mass == pytest.approx(SphereTool(radius).volume.covered_volume * strength * density, rel=0.02)
    assert np.abs(grid.density - before).sum() / 2 == pytest.approx(contact.moved_mass, rel=1e-4)
    assert grid.mass == pytest.approx(mass, rel=1e-7)


@pytest.mark.parametrize("density", [1.0, 0.35])
def test_nothing_is_hollowed_out(kernels, density):
    """Inside the tool density is the strength's share below what it was, everywhere alike; around it nothing less."""
    grid, strength, radius = slab(density), 0.3, 7
    centre = (MIDDLE, MIDDLE + 0.2, depth_of(radius))
    puller(grid, radius).move_to(centre, direction=OUT, strength=strength)
    offsets = np.ix_(*(np.arange(N) - c for c in centre))
    covered = SphereTool(radius).volume.coverage(*offsets)
    level = density * (1.0 - strength)
    assert grid.density[covered == 1.0] == pytest.approx(level, abs=2e-5)
    assert grid.density[:, :, :SURFACE].min() >= level - 2e-5
    skin = (covered > 0.0) & (covered < 1.0)
    assert grid.density[skin] == pytest.approx(density * (1.0 - strength * covered[skin]), abs=2e-5)


@pytest.mark.parametrize("density", [1.0, 0.35])
def test_a_drag_raises_an_even_ridge_whatever_the_spacing(kernels, density):
    """Its height is what the strength says, along all of it; and a second way over it raises next to nothing more."""
    radius, strength = 6, 0.15
    heights = []
    for spacing in (0.2, 0.5, 1.5):
        grid = slab(density)
        push, _ = drag(grid, radius, strength, spacing)
        ridge = grid.density[23:34, N // 2 - 1 : N // 2 + 1, SURFACE:].sum(axis=2)
        heights.append(ridge.mean())
        assert np.ptp(ridge) <= 0.01 * ridge.mean()
        assert grid.density[23:34, :, :SURFACE].min() >= 0.99 * density * (1.0 - strength)
    assert heights == pytest.approx([2 * radius * strength * density] * 3, rel=0.05)
    assert np.ptp(heights) <= 0.003 * heights[0]
    backwards = [(x, MIDDLE, depth_of(radius)) for x in np.arange(39.0, 16.0, -0.5)]
    walk(push, backwards, direction=OUT, strength=strength)
    ridge = grid.density[23:34, N // 2 - 1 : N // 2 + 1, SURFACE:].sum(axis=2)
    assert ridge.mean() == pytest.approx(heights[-1], rel=0.03)


@pytest.mark.parametrize("tool", [SphereTool(6), BoxTool((5, 6, 4), 3), CapsuleTool((4, 0, 0), 5)])
def test_mass_and_bounds(kernels, tool):
    grid = speckled(48)
    mass, push = grid.mass, puller(grid, tool=tool)
    for step in range(40):
        contact = push.move_to((14.0 + 0.4 * step, 24.0, 30.0), direction=(0.6, 0.0, 0.8), strength=0.4)
        assert contact.residual == 0.0 and contact.stress <= contact.yield_stress
    assert contact.moved_mass > 1.0
    assert grid.mass == pytest.approx(mass, rel=1e-7)
    assert grid.density.min() >= 0.0 and grid.density.max() <= 1.0


@pytest.mark.parametrize("border", ["grow", "wall", "open"])
def test_borders(kernels, border):
    """Pulled out of a full block: the grid grows, or the wall keeps it all in, or what leaves is counted."""
    grid = DensityGrid(np.ones((24, 24, 24), np.float32))
    mass, push = grid.mass, puller(grid, 5, border=border)
    contacts = [push.move_to((9.0 + 0.5 * n, 11.0, 17.0), direction=OUT, strength=0.3) for n in range(10)]
    out = sum(contact.mass_out for contact in contacts)
    assert grid.mass + out == pytest.approx(mass, rel=1e-7)
    if border == "grow":
        assert grid.shape[2] > 24 and push.origin[2] == 0 and out == 0.0
        assert grid.density[:, :, 24:].sum() > 100.0
    elif border == "wall":
        assert out == 0.0 and all(contact.blocked for contact in contacts)
        assert grid.density == pytest.approx(1.0, abs=1e-5)
    else:
        assert out > 100.0 and grid.shape == (24, 24, 24)


def test_what_gives_nothing(kernels):
    """No strength, no material around the tool, or nothing in it: not a voxel changes."""
    blob = np.zeros((40,) * 3, np.float32)
    blob[18:22, 18:22, 18:22] = 1.0
    for grid, place, strength in (
        (slab(1.0), (MIDDLE, MIDDLE, depth_of(6)), 0.0),
        (DensityGrid(blob), (19.5, 19.5, 19.5), 0.5),
        (slab(1.0), (MIDDLE, MIDDLE, SURFACE + 12.0), 0.5),
    ):
        before = grid.density.tobytes()
        contact = puller(grid).move_to(place, direction=OUT, strength=strength)
        assert grid.density.tobytes() == before
        assert contact.moved_mass == 0.0 and contact.dirty is None and contact.regime is not Regime.PLASTIC


def test_more_strength_at_rest(kernels):
    """A tool at rest moves nothing more, until its strength rises."""
    grid, place = slab(1.0), (MIDDLE, MIDDLE, depth_of(6))
    push = puller(grid)
    push.move_to(place, direction=OUT, strength=0.1)
    assert push.move_to(place, direction=OUT, strength=0.1).moved_mass == 0.0
    assert push.move_to(place, direction=OUT, strength=0.2).moved_mass > 50.0


def test_trembling_does_not_creep(kernels):
    """What a tool has loosened itself is not what it goes by: little moves to and fro raise nothing more."""
    place, push = np.array((MIDDLE, MIDDLE, depth_of(6))), puller(slab(1.0))
    first = push.move_to(place, direction=OUT, strength=0.4).moved_mass
    tremor = [np.add(place, (0.05 * (n % 2), 0.05 * (n // 2 % 2), 0.0)) for n in range(1, 40)]
    moved = [contact.moved_mass for contact in walk(push, tremor, direction=OUT, strength=0.4)]
    assert sum(moved) < 0.02 * first  # the skin that it reaches over
    assert sum(moved[8:]) < 1e-3 * first


def test_a_thin_wall_is_pulled_as_well(kernels):
    """Where nothing lies behind the tool it goes by what lies beside it."""
    values = np.zeros((48,) * 3, np.float32)
    values[:, :, 20:23] = 0.9
    grid = DensityGrid(values)
    contact = puller(grid).move_to((23.5, 23.5, 16.5), direction=OUT, strength=0.3)
    assert contact.moved_mass > 30.0
    assert grid.density[23, 23, 20:22] == pytest.approx(0.63, abs=1e-4)


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 1, 0)])
@pytest.mark.parametrize("turned", [(False, False, True), (True, True, False)])
def test_symmetry(kernels, order, turned):
    """The same pull of a grid that was turned and mirrored leads to the turned and mirrored outcome."""
    values = speckled(40).density
    start, step, flow = np.array((17.0, 18.0, 24.0)), np.array((0.5, 0.2, 0.1)), np.array((0.36, 0.48, 0.8))

    def pulled(values, place, way, along):
        grid = DensityGrid(values)
        push = puller(grid, 5, border="wall")
        walk(push, [tuple(place + n * way) for n in range(12)], direction=tuple(along), strength=0.4)
        return grid.density

    signs = np.where(turned, -1.0, 1.0)
    way, along = (vector[list(order)] * signs for vector in (step, flow))
    there = pulled(carried(values, order, turned), carried_point(start, 40, order, turned), way, along)
    here = carried(pulled(values, start, step, flow), order, turned)
    assert apart(here, there, carried(values, order, turned)) <= 1e-5


def test_pulling_undoes_what_pushing_packed(kernels):
    """The mirror image of compaction: where a push packed foam, a pull back out loosens it again."""
    grid = half_space(N, 0.4, 20)
    push = Push(grid, SphereTool(6), CLAY)
    walk(push, [(x, MIDDLE, MIDDLE) for x in np.arange(12.0, 24.0, 0.5)])
    packed = grid.density[30:34, 26:30, 26:30].mean()
    assert packed > 0.8
    pull = puller(grid)
    pull.move_to((34.0, MIDDLE, MIDDLE), direction=(-1.0, 0.0, 0.0), strength=0.5)
    assert grid.density[30:34, 26:30, 26:30].mean() < 0.8 * packed


def test_method_and_band_are_those_of_pushes(kernels):
    """A pull sweeps whatever the method, and nothing turns it back."""
    ends = []
    for options in ({}, {"method": "recursive"}, {"band": 1.0}):
        grid = slab(0.9)
        puller(grid, **options).move_to((MIDDLE, MIDDLE, depth_of(6)), direction=OUT, strength=0.2)
        ends.append(grid.density.tobytes())
    assert ends[0] == ends[1] == ends[2]
