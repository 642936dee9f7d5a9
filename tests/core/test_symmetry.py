# SPDX-License-Identifier: GPL-3.0-or-later
"""The cube's symmetries: a push that is turned or mirrored gives the turned or mirrored outcome."""

from itertools import permutations

import numpy as np
import pytest

from repousse.core import BoxTool, CapsuleTool, DensityGrid, Material, Push, SphereTool

from .volumes import TINY, apart, carried, carried_point, cube_motions, half_space, line, speckled, walk

CLEAR, TIE = 1e-5, 0.03
N = 40
DIRECTIONS = {"axis": (1.0, 0.0, 0.0), "clear": (0.8, 0.5, 0.33), "steep": (0.1, 0.05, -0.9)}
TIES = {"face": (1.0, 1.0, 0.0), "body": (1.0, 1.0, 1.0)}
HARDNESS = {"compacts": (0.5, 0.05, None), "rises": (1.0, TINY, 6.0), "does both": (0.97, 0.01, 4.0)}


def outcome(values, start, end, kappa, band, tool):
    grid = DensityGrid(values)
    # A border that treats all sides alike: with "grow" the arrays could differ in shape.
    push = Push(grid, tool, Material(3.3, kappa), border="wall", band=band)
    contacts = walk(push, line(start, end, 0.4))
    return grid.density, np.array([c.stress for c in contacts]), contacts[-1].force


def block(density, n=N):
    """A cube of material in the middle, so that every motion of the cube carries it onto itself."""
    values = np.zeros((n, n, n), np.float32)
    values[n // 5 : -(n // 5), n // 5 : -(n // 5), n // 5 : -(n // 5)] = density
    return values


def ball(radius):
    return lambda order: SphereTool(radius)


def worst_motion(values, direction, kappa, band, tools=None, motions=None, depth=9.0):
    """The largest distance between the outcome of a carried push and the carried outcome of a push."""
    tools = tools or ball(6)
    n, u = len(values), np.array(direction) / np.linalg.norm(direction)
    middle = (n - 1) / 2 + np.array([0.31, -0.17, 0.08])  # off the lattice: no tie where none is meant
    radius = tools((0, 1, 2)).radius
    start, end = middle - 2 * radius * u, middle - (2 * radius - depth) * u
    first, stresses, force = outcome(values, start, end, kappa, band, tools((0, 1, 2)))
    worst = 0.0
    for order, turned in motions or cube_motions():
        ends = [carried_point(p, n, order, turned) for p in (start, end)]
        other, others, heading = outcome(carried(values, order, turned), *ends, kappa, band, tools(order))
        distance = apart(carried(first, order, turned), other, carried(values, order, turned))
        worst = max(worst, distance)
        within = 10 * max(distance, CLEAR) * stresses.max()
        assert np.abs(others - stresses).max() <= within
        assert np.abs(heading - np.where(turned, -1.0, 1.0) * force[list(order)]).max() <= within
    return worst


@pytest.mark.parametrize("hardness", HARDNESS)
@pytest.mark.parametrize("between", [False, True], ids=["on a voxel", "between voxels"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_axis_push_is_fourfold(kernels, axis, between, hardness):
    """A quarter turn about the axis of the push, and a mirror, change no voxel by more than 1e-5."""
    density, kappa, band = HARDNESS[hardness]
    across = 33 + between
    shape = [across] * 3
    shape[axis] = 48
    grid = half_space(shape, density, first=16, axis=axis)
    before = grid.density.copy()
    start, end = np.full(3, (across - 1) / 2), np.full(3, (across - 1) / 2)
    start[axis], end[axis] = 9.0, 20.0
    push = Push(grid, SphereTool(6), Material(3.3, kappa), border="wall", band=band)
    walk(push, line(start, end))
    planes, _ = np.moveaxis(grid.density, axis, 0), np.moveaxis(before, axis, 0)
    assert np.abs(grid.density - before).max() > 0.4
    for other in (np.rot90(planes, 1, (1, 2)), planes[:, ::-1], planes.transpose(0, 2, 1)):
        assert np.abs(planes - other).max() <= 1e-5


@pytest.mark.parametrize("hardness", HARDNESS)
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_all_motions_of_the_cube(direction, hardness):
    density, kappa, band = HARDNESS[hardness]
    assert worst_motion(block(density), DIRECTIONS[direction], kappa, band) <= CLEAR


@pytest.mark.parametrize("hardness", ["compacts", "rises"])
@pytest.mark.parametrize("direction", TIES)
def test_all_motions_at_a_tie(direction, hardness):
    """Where two axes are equally large one of them is swept along: the outcome may differ a little, not much. (With a
    tool of 32 voxels: the smaller the tool, the more a lattice shows.)"""
    density, kappa, band = HARDNESS[hardness]
    motions = [(order, (order[0] == 1, False, order[2] == 0)) for order in permutations(range(3))]
    assert worst_motion(block(density, 96), TIES[direction], kappa, band and 16, ball(16), motions, 16.0) <= TIE


def test_noise_of_a_scan():
    assert worst_motion(speckled(N).density, DIRECTIONS["clear"], 0.05, None, motions=cube_motions()[::5]) <= CLEAR


@pytest.mark.parametrize("band", [None, 5.0])
@pytest.mark.parametrize(
    "tools",
    [
        lambda order: BoxTool(tuple((4.0, 6.0, 5.0)[a] for a in order), 4.0),
        lambda order: CapsuleTool(tuple((1.0, 4.0, 2.0)[a] for a in order), 4.0, 7.0),
    ],
    ids=["box", "capsule"],
)
def test_tools_that_are_turned_along(tools, band):
    """The tool is carried too; a capsule is its own mirror image through its middle only."""
    through = [motion for motion in cube_motions() if len(set(motion[1])) == 1]
    density = 0.6 if band is None else 1.0
    assert worst_motion(block(density), DIRECTIONS["clear"], 0.02, band, tools, through) <= CLEAR


@pytest.mark.parametrize("hardness", ["compacts", "rises"])
def test_numpy_agrees_with_itself(hardness, monkeypatch):
    monkeypatch.setenv("REPOUSSE_KERNELS", "numpy")
    density, kappa, band = HARDNESS[hardness]
    motions = cube_motions()[3::15]
    assert worst_motion(block(density, 32), DIRECTIONS["clear"], kappa, band, ball(5), motions, 6.0) <= CLEAR
