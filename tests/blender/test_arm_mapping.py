# SPDX-License-Identifier: GPL-3.0-or-later
"""Between the arm and voxels: where places come to lie, and that force and work are the same on both sides."""

from dataclasses import replace
from math import hypot

import numpy as np
import pytest

from repousse.core.local_model import LocalModel
from repousse.operators.arm_mapping import ArmMapping, Workspace

CENTRE = (0.02, -0.01, 0.06)
"""Of an arm's workspace, m."""
REACH = 0.1
TOWARDS, RIGHT, UP = np.eye(3)


def turned(random):
    """A random rotation, (3, 3)."""
    q, r = np.linalg.qr(random.standard_normal((3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def mapping_by(axes, offset=(3.0, -4.0, 50.0)):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes, offset
    return ArmMapping(matrix)


def similar(seed=1, scale=700.0, mirrored=False):
    """A mapping that turns, scales and moves, as from an arm to the voxels of an object that is placed at will."""
    axes = scale * turned(np.random.default_rng(seed))
    return mapping_by(axes @ np.diag((1.0, 1.0, -1.0)) if mirrored else axes)


def felt(position=(12.0, 9.0, 30.0), gradient=(-0.03, 0.01, 0.2), normal=(0.1, -0.05, -0.9)):
    return LocalModel(4, 17.5, position, 0.8, 1.1, gradient, normal)


def test_towards_right_and_up_are_those_of_the_view():
    # Blender's view from the front: x is to the right, z up, and the viewer sits at -y.
    from_the_front = np.array([[1, 0, 0, 0], [0, 0, -1, -8], [0, 1, 0, 0], [0, 0, 0, 1]], float)
    matrix = Workspace.in_view(from_the_front, (1.0, 2.0, 3.0), 4.0, REACH).from_device(CENTRE)
    for hand, world in ((TOWARDS, (0, -1, 0)), (RIGHT, (1, 0, 0)), (UP, (0, 0, 1))):
        there = matrix @ (*(CENTRE + REACH * hand), 1.0)
        assert there[:3] == pytest.approx(np.array((1.0, 2.0, 3.0)) + 4.0 * np.array(world))


def test_who_sits_before_an_object_looks_along_its_y():
    quarter = np.array([[0, -1, 0, 5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], float)  # about z: its y is -x
    matrix = Workspace.on_object(quarter, (0.0, 0.0, 0.0), 1.0, REACH).from_device(CENTRE)
    for hand, world in ((TOWARDS, (1, 0, 0)), (RIGHT, (0, 1, 0)), (UP, (0, 0, 1))):
        assert (matrix @ (*(CENTRE + REACH * hand), 1.0))[:3] == pytest.approx(world)


@pytest.mark.parametrize("scale", [(2.0, 2.0, 2.0), (1.0, 3.0, 0.5), (1.0, 1.0, -1.0)])
def test_the_arm_never_moves_mirrored_or_stretched(scale):
    """Its axes are a rotation, however the object is scaled: the hand knows no other."""
    matrix = np.eye(4)
    matrix[:3, :3] = turned(np.random.default_rng(3)) @ np.diag(scale)
    axes = np.array(Workspace.on_object(matrix, (0.0, 0.0, 0.0), 1.0, REACH).axes)
    assert axes.T @ axes == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_going_back_with_the_clutch_leaves_the_tool_where_it_is():
    workspace = Workspace.in_view(np.eye(4), (0.3, 0.0, -1.0), 2.0, REACH)
    before, after = np.array((0.05, 0.02, 0.07)), np.array((-0.01, 0.03, 0.02))
    was = workspace.from_device(CENTRE) @ (*before, 1.0)
    assert workspace.from_device(CENTRE, tuple(before - after)) @ (*after, 1.0) == pytest.approx(was)


@pytest.mark.parametrize("mirrored", [False, True])
def test_there_and_back(mirrored):
    mapping = similar(mirrored=mirrored)
    for place in np.random.default_rng(5).uniform(-0.2, 0.2, (50, 3)):
        assert mapping.place(mapping.position(tuple(place))) == pytest.approx(tuple(place), abs=1e-12)
    one, other = (0.01, 0.02, 0.03), (0.04, 0.02, -0.01)
    way = np.subtract(mapping.position(other), mapping.position(one))
    assert np.linalg.norm(way) == pytest.approx(700.0 * np.linalg.norm(np.subtract(other, one)))
    assert mapping.voxels_per_metre == pytest.approx(700.0)


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_stress_anywhere_near_is_the_same_on_both_sides(mirrored):
    """Along a way of the hand the stress changes by what it changes along the same way through the voxels."""
    mapping, model = similar(mirrored=mirrored), felt()
    told = mapping.force_model(model, 7)
    assert (told.stress, told.yield_stress, told.time, told.scene) == (0.8, 1.1, 17.5, 7)
    assert told.exponent == 1.0 and mapping.force_model(replace(model, exponent=0.6), 7).exponent == 0.6
    for place in np.random.default_rng(6).uniform(-0.01, 0.01, (50, 3)) + told.position:
        inside = np.dot(model.gradient, np.subtract(mapping.position(tuple(place)), model.position))
        outside = np.dot(told.gradient, np.subtract(place, told.position))
        assert outside == pytest.approx(inside, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_work_of_the_hand_is_that_in_the_material(mirrored):
    """Newtons stay newtons, and a voxel is as long as the hand's way to it."""
    mapping, model = similar(mirrored=mirrored), felt()
    told = mapping.force_model(model, 7)
    for way in np.random.default_rng(7).uniform(-1e-3, 1e-3, (50, 3)):
        through_voxels = np.subtract(mapping.position(tuple(way)), mapping.position((0.0, 0.0, 0.0)))
        work = model.stress * np.dot(model.normal, through_voxels) / mapping.voxels_per_metre
        assert model.stress * np.dot(told.normal, way) == pytest.approx(work, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("length", [1.0, 0.4, 0.0])
def test_a_normal_that_fades_fades_for_the_hand(length):
    normal = tuple(length * np.array((0.6, 0.0, 0.8)))
    stretched = mapping_by(turned(np.random.default_rng(8)) @ np.diag((500.0, 900.0, 200.0)))
    for mapping in (similar(), stretched):
        assert hypot(*mapping.force_model(felt(normal=normal), 1).normal) == pytest.approx(length)


def test_in_a_stretched_volume_the_force_still_stands_on_the_surface():
    """Every way of the hand along the surface is without work."""
    mapping = mapping_by(turned(np.random.default_rng(9)) @ np.diag((500.0, 900.0, 200.0)))
    model = felt(gradient=(0.2, 0.1, -0.3), normal=tuple(np.array((-0.2, -0.1, 0.3)) / hypot(0.2, 0.1, 0.3)))
    told = mapping.force_model(model, 1)
    start = mapping.place(model.position)
    for along in np.cross(model.normal, np.eye(3)):
        way = np.subtract(mapping.place(tuple(model.position + along)), start)
        assert np.dot(told.normal, way) == pytest.approx(0.0, abs=1e-15)
    assert np.dot(told.normal, told.gradient) < 0.0


def test_towards_the_user_is_one_voxel_long():
    mapping = similar()
    step = np.subtract(mapping.position((0.001, 0.0, 0.0)), mapping.position((0.0, 0.0, 0.0)))
    assert mapping.towards_user == pytest.approx(step / np.linalg.norm(step))


@pytest.mark.parametrize("flat", [np.diag((1.0, 1.0, 0.0)), np.zeros((3, 3)), np.full((3, 3), np.nan)])
def test_what_is_flat_or_nowhere_is_refused(flat):
    with pytest.raises(ValueError, match=r"flat|finite"):
        mapping_by(flat)
    matrix = np.eye(4)
    matrix[:3, :3] = flat
    with pytest.raises(ValueError, match=r"flat|finite"):
        Workspace.on_object(matrix, (0.0, 0.0, 0.0), 1.0, REACH)


@pytest.mark.parametrize(("span", "reach"), [(0.0, 0.1), (np.inf, 0.1), (1.0, 0.0), (np.nan, 0.1), (1.0, -0.1)])
def test_a_workspace_without_size_is_refused(span, reach):
    with pytest.raises(ValueError, match="positive length"):
        Workspace.in_view(np.eye(4), (0.0, 0.0, 0.0), span, reach)


def test_a_workspace_nowhere_is_refused():
    with pytest.raises(ValueError, match="finite"):
        Workspace.in_view(np.eye(4), (0.0, np.inf, 0.0), 1.0, REACH)


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_normal_turns_with_the_arm_as_it_does_in_the_grid(mirrored):
    """Told at a place, and told anew where the arm has gone: the same normal."""
    mapping, turning = similar(4, mirrored=mirrored), tuple(map(tuple, np.random.default_rng(5).normal(0, 0.1, (3, 3))))
    model = replace(felt(), turning=turning)
    told = mapping.force_model(model, 1)
    way = np.array((0.002, -0.001, 0.003))
    there = mapping.position(tuple(np.array(told.position) + way))
    gone = np.array(there) - model.position
    anew = mapping.force_model(replace(model, normal=tuple(np.array(model.normal) + gone @ np.array(turning))), 1)
    moved = np.array(told.normal) + way @ np.array((told.turning_x, told.turning_y, told.turning_z))
    assert moved == pytest.approx(np.array(anew.normal), abs=1e-12)
