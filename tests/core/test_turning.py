# SPDX-License-Identifier: GPL-3.0-or-later
"""How the normal of a local model turns with the tool: round a body, in a hole, over a plane, and with both kernels."""

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.local_model import NONE, Feeler

N, R = 40, 6.0
LATTICE = 0.06
"""Per voxel: what the lattice makes of a normal that does not turn, under a tool of six voxels."""
MIDDLE = (N - 1) / 2


def feeler_of(inside):
    """Feels a body given by its signed distance, positive inside; and its tool."""
    offsets = np.indices((N,) * 3) - MIDDLE
    push = Push(DensityGrid(np.clip(inside(*offsets) + 0.5, 0.0, 1.0).astype(np.float32)), SphereTool(R), Material())
    return Feeler(push, turning=True), push.tool


def at(*offset):
    return tuple(MIDDLE + o for o in offset)


def test_over_a_plane_it_does_not(kernels):
    feeler, tool = feeler_of(lambda x, y, z: -z)
    along_x, along_y, down = np.abs(feeler.feel(at(0.3, 0.2, 4.0), tool).turning)
    assert max(*along_x, *along_y) < 1e-6 and max(down) < LATTICE


@pytest.mark.parametrize("way", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.48, 0.6, 0.64)])
def test_round_a_ball_it_turns_with_the_way(kernels, way):
    """n = x/|x|, so dn/dx = (I - n n) / |x|: over the top of a body the tool slides off."""
    feeler, tool = feeler_of(lambda x, y, z: 8.0 - np.sqrt(x * x + y * y + z * z))
    far = 11.0
    turning = np.array(feeler.feel(at(*(far * np.array(way))), tool).turning)
    assert turning == pytest.approx((np.eye(3) - np.outer(way, way)) / far, abs=0.25 / far)


def test_in_a_hole_it_turns_back(kernels):
    """The walls hold the tool in the middle: aside, the normal points back."""
    feeler, tool = feeler_of(lambda x, y, z: np.minimum(-z, np.hypot(x, y) - 4.5))
    turning = np.array(feeler.feel(at(0.0, 0.0, 2.0), tool).turning)
    assert turning[0, 0] < -0.1 and turning[1, 1] < -0.1
    assert turning[0, 0] == pytest.approx(turning[1, 1], rel=1e-3)


def test_it_is_the_derivative_of_the_normal(kernels):
    """Where the normal is a voxel on, but for the lattice and what is of second order."""
    feeler, tool = feeler_of(lambda x, y, z: np.minimum(-z, -x))
    here = np.array(at(2.0, 0.0, 3.0))
    model = feeler.feel(tuple(here), tool)
    for way in np.array([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, -0.8)]):
        there = np.array(feeler.feel(tuple(here + way), tool).normal)
        told = np.array(model.normal) + way @ np.array(model.turning)
        assert np.linalg.norm(told - there) < 0.5 * np.linalg.norm(there - np.array(model.normal))


def test_where_the_normal_fades_nothing_turns(kernels):
    feeler, tool = feeler_of(lambda x, y, z: 0.0 * x + 1.0)
    assert feeler.feel(at(0.0, 0.0, 0.0), tool).turning == NONE


def test_without_a_hand_nothing_turns(kernels):
    """A mouse feels no force, so nobody pays for it."""
    push = Push(DensityGrid(np.ones((N, N, N), np.float32)), SphereTool(R), Material())
    assert Feeler(push).feel(at(0.0, 0.0, -MIDDLE), push.tool).turning == NONE
    assert Feeler(push, turning=True).feel(at(0.0, 0.0, -MIDDLE), push.tool).turning != NONE
