# SPDX-License-Identifier: GPL-3.0-or-later
"""The rim around tools of every shape, deep in, oblique, and of a tool that is not wholly emptied (facts/rim.md)."""

from functools import cache

import numpy as np
import pytest

from repousse.core import BoxTool, CapsuleTool, Material, Push, SphereTool

from .volumes import TINY, half_space, line, walk

SHAPE, FIRST = (80, 88, 88), 28
MIDDLE = (SHAPE[1] - 1) / 2
SURFACE = FIRST - 0.5
BAND = 8
TOOLS = {
    "ball": SphereTool(10),
    "punch": BoxTool((6, 10, 10), 5),
    "plate": BoxTool((5, 6, 14), 5),
    "finger": CapsuleTool((10.0, 0.0, 0.0), 8.0),
    "lying finger": CapsuleTool((0.0, 0.0, 10.0), 8.0),
}
ROUND = ("ball", "punch", "finger")
"""Tools that are the same along both axes across the push."""


class Pressed:
    """A tool that was pressed straight down into a half space, and what stands above where the surface was."""

    def __init__(self, tool, depth, yield_ratio=TINY, step=0.25):
        self.grid = half_space(SHAPE, first=FIRST)
        self.before = self.grid.density.copy()
        self.push = Push(self.grid, tool, Material(3.3, yield_ratio), border="wall", band=BAND)
        self.extent = tool.volume.extent
        top = SURFACE - self.extent[0]
        self.contacts = walk(self.push, line((top - step, MIDDLE, MIDDLE), (top + depth, MIDDLE, MIDDLE), step))

    @property
    def columns(self):
        """Mass above the former surface on each voxel of it: the height of what rose."""
        return self.grid.density[:FIRST].sum(axis=0, dtype=np.float64)

    @property
    def displaced(self):
        return float((self.before - self.grid.density)[FIRST:].sum(dtype=np.float64))

    @property
    def drift(self):
        return abs(self.grid.mass - self.before.sum(dtype=np.float64)) / self.grid.mass

    def shaft(self, inset=1.0):
        """Densities where the tool came through, ``inset`` voxels from where its sides went."""
        i, j, k = np.indices(SHAPE)
        x, y, z = self.push.position
        side = self.push._work.volume.distance(np.zeros(SHAPE), j - y, k - z)
        return self.grid.density[(side < -inset) & (i < x)]


@cache
def pressed(name, depth):
    return Pressed(TOOLS[name], depth)


@pytest.mark.parametrize("depth", [5.0, 9.0])
@pytest.mark.parametrize("name", TOOLS)
def test_rim_of_every_shape(name, depth):
    """It is as symmetric as the tool, stands around the contact, and is .25 to .65 of the depth high."""
    trial = pressed(name, depth)
    density, columns = trial.grid.density, trial.columns
    assert trial.drift <= 1e-9
    assert density.min() >= 0.0 and density.max() <= 1.0
    assert np.abs(density - density[:, ::-1]).max() <= 1e-5
    assert np.abs(density - density[:, :, ::-1]).max() <= 1e-5
    if name in ROUND:
        assert np.abs(density - density.transpose(0, 2, 1)).max() <= 1e-5
    assert 0.25 <= columns.max() / depth <= 0.65
    assert 0.12 <= columns.max() / trial.displaced ** (1 / 3) <= 0.40
    j, k = np.unravel_index(columns.argmax(), columns.shape)
    beside = trial.push._work.volume.distance(np.zeros(1), np.array([j - MIDDLE]), np.array([k - MIDDLE]))[0]
    assert -3.5 <= beside <= 2.5  # a ball's and a finger's contact is narrower than they are
    assert not any(contact.blocked for contact in trial.contacts)
    assert columns.sum() == pytest.approx(trial.displaced, rel=1e-6)


@pytest.mark.parametrize(("name", "depth"), [("ball", 25.0), ("punch", 25.0), ("finger", 24.0)])
def test_a_deep_hole_stays_open(name, depth):
    """2.5 radii deep the mouth does not close over the tool, and the rim around it has even walls."""
    trial = Pressed(TOOLS[name], depth)
    assert trial.shaft().mean() < 1e-3 and trial.shaft().max() < 0.1
    density, columns = trial.grid.density, trial.columns
    assert 0.2 <= columns.max() / depth <= 0.5
    assert columns.max() <= 0.5 * trial.displaced ** (1 / 3)
    assert trial.drift <= 1e-9
    assert np.abs(density - density[:, ::-1]).max() <= 1e-4
    # Each side of the mouth rises outward to one crest and falls from there: no second ring stands farther out.
    side = columns[int(MIDDLE + 0.5), int(MIDDLE + 0.5) :]
    crest = int(side.argmax())
    assert crest <= max(trial.extent[1:]) + 4
    assert (np.diff(side[crest:]) <= 0.05).all()


@cache
def half_emptied(yield_ratio):
    """A tool in a material that gives way only where it is much fuller than what surrounds it."""
    return Pressed(SphereTool(10), 10.0, yield_ratio)


@pytest.mark.parametrize("yield_ratio", [0.01, 0.02, 0.05, 0.1, 0.2])
def test_rim_of_a_tool_that_is_not_wholly_emptied(yield_ratio):
    """The rim goes by what was displaced, not by how large the tool is; nothing is laid inside the tool."""
    trial, whole = half_emptied(yield_ratio), half_emptied(TINY)
    size, wholly = (t.columns.max() / t.displaced ** (1 / 3) for t in (trial, whole))
    assert size == pytest.approx(wholly, rel=0.25)
    assert trial.drift <= 1e-9
    assert np.abs(trial.grid.density - trial.grid.density[:, ::-1]).max() <= 1e-5
    work = trial.push._work
    assert work.estimate.tool_mass > 0.5 * yield_ratio * work.estimate.reach_mass
    assert work.sources.contact_radius <= 1.05 * whole.push._work.sources.contact_radius


@pytest.mark.parametrize("yield_ratio", [0.01, 0.05, 0.2])
def test_nothing_is_laid_inside_the_tool(yield_ratio):
    """In no step does a voxel gain that the tool covers, or that is on the way it came."""
    trial = Pressed(SphereTool(10), 7.0, yield_ratio, step=0.5)
    x, y, z = trial.push.position
    at = np.indices(SHAPE) - np.reshape((0.0, y, z), (3, 1, 1, 1))
    for step in range(1, 9):
        before, centre = trial.grid.density.copy(), x + 0.5 * step
        moved = trial.push.move_to((centre, y, z)).moved_mass
        gained = trial.grid.density - before
        inside = trial.push._work.volume.distance(np.maximum(at[0] - centre, 0.0), at[1], at[2]) <= -0.5
        assert moved > 1.0 and inside.sum() > 3000
        assert gained[inside].max() <= 1e-6 and gained.max() > 1e-3


def test_less_rises_the_more_the_tool_holds():
    heights = [half_emptied(ratio).columns.max() for ratio in (0.01, 0.05, 0.1, 0.2)]
    assert (np.diff(heights) < 0.0).all()


DIRECTIONS = {"(.8,0,.6)": (0.8, 0.0, 0.6), "(1,1,0)": (0.5**0.5, 0.5**0.5, 0.0)}


@cache
def oblique(name, density):
    """A ball of 10 pushed .8 of its radius deep along an oblique direction: what stood, what stands."""
    u = np.array(DIRECTIONS[name])
    grid = half_space((64, 88, 88), density, first=FIRST)
    before = grid.density.copy()
    start = np.array([SURFACE - 10.0, MIDDLE, MIDDLE])
    push = Push(grid, SphereTool(10), Material(3.3, TINY), border="wall", band=10)
    walk(push, line(start - 0.5 * u, start + 8.0 / u[0] * u))
    return before, grid


@pytest.mark.parametrize("density", [1.0, 0.98, 0.9])
@pytest.mark.parametrize("name", DIRECTIONS)
def test_oblique_push(name, density):
    """The bow wave stands ahead of the tool, evenly on both sides of the plane in which it is pushed."""
    before, grid = oblique(name, density)
    after, u = grid.density, np.array(DIRECTIONS[name])
    assert abs(grid.mass - before.sum(dtype=np.float64)) <= 1e-9 * grid.mass
    assert after.min() >= 0.0 and after.max() <= 1.0
    mirrored = after[:, ::-1] if u[1] == 0.0 else after[:, :, ::-1]
    assert np.abs(after - mirrored).max() <= 1e-5
    columns = after[:FIRST].sum(axis=0, dtype=np.float64)
    j, k = np.indices(columns.shape) - MIDDLE
    ahead = float(((j * u[1] + k * u[2]) * columns).sum() / columns.sum() / np.hypot(u[1], u[2]))
    way = 8.0 / u[0] * np.hypot(u[1], u[2])
    assert way < ahead < way + 10.0
    assert 0.1 <= columns.max() / 8.0 <= 0.6


@pytest.mark.parametrize("name", DIRECTIONS)
def test_oblique_rim_falls_with_density(name):
    grids = [oblique(name, density)[1] for density in (1.0, 0.98, 0.95, 0.9)]
    columns = [grid.density[:FIRST].sum(axis=0, dtype=np.float64) for grid in grids]
    assert (np.diff([c.max() for c in columns]) < 0.0).all()
    shares = np.array([c.sum() for c in columns]) / columns[0].sum()
    assert (np.diff(shares) < -0.1).all() and shares[-1] < 0.25
