# SPDX-License-Identifier: GPL-3.0-or-later
"""What makes no sense is refused with one clear line, and the grid is as it was."""

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool, Stroke

from .volumes import half_space, line, walk

NAN, INF = float("nan"), float("inf")


def refused(action, match=None):
    with pytest.raises(ValueError, match=match) as error:
        action()
    assert "\n" not in str(error.value) and len(str(error.value)) < 200


@pytest.mark.parametrize(
    "position",
    [(NAN, 0, 0), (0, INF, 0), (0, 0, -INF), (1, 2), (1, 2, 3, 4), (), "abc", ("a", "b", "c"), None, 5.0, [[1, 2, 3]]],
)
@pytest.mark.parametrize("begun", [False, True])
def test_positions(kernels, position, begun):
    push = Push(half_space(32, 0.6, 12), SphereTool(5), Material(3.3, 0.05))
    if begun:
        walk(push, line((5.0, 15.5, 15.5), (10.0, 15.5, 15.5), 0.5))
    before = push.grid.density.tobytes()
    refused(lambda: push.move_to(position), match="position")
    assert push.grid.density.tobytes() == before
    # And it goes on as if nothing had been asked.
    contact = push.move_to((10.5, 15.5, 15.5))
    assert np.isfinite(contact.force).all() and push.grid.density.max() <= 1.0


@pytest.mark.parametrize("radius", [0.0, 0.99, -3.0, NAN, INF])
def test_radii(kernels, radius):
    push = Push(half_space(32, 0.6, 12), SphereTool(5), Material(3.3, 0.05))
    walk(push, line((5.0, 15.5, 15.5), (10.0, 15.5, 15.5), 0.5))
    before, position = push.grid.density.tobytes(), push._position
    refused(lambda: push.move_to((11.0, 15.5, 15.5), radius=radius), match="radius")
    assert push.grid.density.tobytes() == before
    assert push.tool.radius == 5 and push._position == position
    contact = push.move_to((10.5, 15.5, 15.5))
    assert np.isfinite(contact.stress)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"method": "magic"}, "magic"),
        ({"method": None}, "method"),
        ({"border": "mirror"}, "mirror"),
        ({"border": None}, "border"),
        ({"band": -1.0}, "band"),
        ({"band": NAN}, "band"),
        ({"band": INF}, "band"),
        ({"rim": -0.1}, "rim"),
        ({"rim": NAN}, "rim"),
        ({"wake": NAN}, "wake"),
        ({"wake": -2}, "wake"),
    ],
)
def test_options(options, match):
    grid = half_space(16, 0.6, 8)
    refused(lambda: Push(grid, SphereTool(3), Material(), **options), match)


def test_an_empty_grid():
    refused(lambda: Push(DensityGrid(np.zeros((8, 8, 8))), SphereTool(3), Material()), "empty")


def test_huge_positions_are_harmless(kernels):
    push = Push(half_space(24, 0.6, 10), SphereTool(4), Material(3.3, 0.05))
    before = push.grid.density.tobytes()
    for position in ((1e9, 0, 0), (-1e12, 1e12, 0), (1e18, 1e18, 1e18), (0.0, -1e300, 0.0)):
        contact = push.move_to(position)
        assert contact.stress == 0.0 and not contact.force.any()
    assert push.grid.density.tobytes() == before


@pytest.mark.parametrize("step", [0.0, -1.0, NAN, INF])
def test_steps(step):
    refused(lambda: Stroke.line((0, 0, 0), (5, 0, 0), step=step), "step")
    refused(lambda: Stroke.line((0, 0, 0), (5, 0, 0)).resample(step), "step")


@pytest.mark.parametrize("ends", [((NAN, 0, 0), (1, 1, 1)), ((0, 0, 0), (INF, 0, 0)), ((0, 0), (1, 1)), ("ab", "cd")])
def test_ends_of_a_line(ends):
    refused(lambda: Stroke.line(*ends))


def test_too_many_samples():
    refused(lambda: Stroke.line((0, 0, 0), (1e9, 0, 0), step=1e-6), "step")


def test_a_verb_that_a_push_cannot_do():
    grid = half_space(16, 0.6, 8)
    refused(lambda: Stroke(verb="melt").push(grid), "melt")
    refused(lambda: Stroke(symmetry="x").push(grid), "mirror")
    refused(lambda: Stroke(symmetry="w", mirror=(8, 8, 8)).push(grid), "symmetry")
    refused(lambda: Stroke(symmetry="x", mirror=(8, float("nan"), 8)).push(grid), "finite")
