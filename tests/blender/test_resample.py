# SPDX-License-Identifier: GPL-3.0-or-later
"""Resample: the same clay on other voxels, told before it is made, and everything else of the volume as it was."""

import re
from pathlib import Path

import bpy
import numpy as np
import pytest

from repousse.core.formats import MAX_VOXELS, read_volume
from repousse.core.resample import resample
from repousse.operators import session as sessions

from .paper import draw


@pytest.fixture
def bar():
    """A bar of clay that is not a cube, as the active object; its grid."""
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(1.0, 2.0, 3.0))
    bpy.context.object.scale = (2.0, 1.0, 0.5)
    bpy.context.view_layer.update()
    bpy.ops.repousse.mesh_to_clay(resolution=44, material="wax")
    made = bpy.context.object
    return made, grid_of(made)


def grid_of(volume):
    return read_volume(bpy.path.abspath(volume.data.filepath))


def corners(grid):
    """The lowest and highest corner of a grid in its world."""
    ends = [(-0.5,) * 3, np.array(grid.shape) - 0.5]
    return np.array([(grid.transform @ (*end, 1.0))[:3] for end in ends])


@pytest.mark.parametrize("factor", [0.5, 2.0, 0.8])
def test_resampled_clay_is_what_core_makes_and_told_as_such(bar, factor):
    volume, grid = bar
    former = volume.data.filepath
    size = grid.voxel_size * factor
    assert bpy.ops.repousse.resample_volume(voxel_size=size) == {"FINISHED"}
    made = grid_of(volume)
    assert volume.data.filepath != former and Path(bpy.path.abspath(former)).exists()
    expected = resample(grid, np.float32(size).item())
    assert made.density.tobytes() == expected.density.tobytes()
    assert made.mass * made.voxel_size**3 == pytest.approx(grid.mass * grid.voxel_size**3, rel=1e-6)
    assert corners(made)[0] == pytest.approx(corners(grid)[0], abs=1e-6)
    told = volume.data.repousse
    assert (tuple(told.shape), told.mass) == (made.shape, pytest.approx(made.mass))
    assert told.voxel_size == pytest.approx(size)
    assert sum(told.histogram) == np.count_nonzero(made.density)


def test_all_but_the_voxels_stays(bar):
    volume, _ = bar
    volume.data.repousse.level = 0.3
    former = volume.name, volume.data.name, volume.matrix_world.copy(), list(volume.data.materials)
    bpy.ops.repousse.resample_volume(voxel_size=0.1)
    assert (volume.name, volume.data.name, volume.matrix_world, list(volume.data.materials)) == former
    assert volume.data.repousse.level == pytest.approx(0.3)


def test_the_dialog_tells_what_would_be_made(bar):
    volume, grid = bar
    size = grid.voxel_size / 2
    texts = draw(bpy.types.REPOUSSE_OT_resample_volume, voxel_size=size).texts
    before, after = (" x ".join(str(n * k) for n in grid.shape) for k in (1, 2))
    assert any(before in text for text in texts) and any(after in text for text in texts)
    [memory] = (text for text in texts if "MiB" in text)
    clay = float(re.findall(r"clay ([\d.]+)", memory)[0])
    assert clay == pytest.approx(8 * grid.density.size * 8 / 2**20, rel=0.01)
    bpy.ops.repousse.resample_volume(voxel_size=size)
    assert tuple(volume.data.repousse.shape) == tuple(2 * n for n in grid.shape)  # as was told


def test_too_many_voxels_are_told_before_and_refused(bar):
    volume, grid = bar
    size = grid.voxel_size * (grid.density.size / MAX_VOXELS) ** (1 / 3) / 1.1
    texts = draw(bpy.types.REPOUSSE_OT_resample_volume, voxel_size=size).texts
    assert "More than can be sculpted: choose larger voxels" in texts
    former = volume.data.filepath
    with pytest.raises(RuntimeError, match="take larger ones"):
        bpy.ops.repousse.resample_volume(voxel_size=size)
    assert volume.data.filepath == former


def test_the_same_size_makes_nothing(bar):
    volume, grid = bar
    former = volume.data.filepath
    with pytest.raises(RuntimeError, match="have this size already"):
        bpy.ops.repousse.resample_volume(voxel_size=grid.voxel_size)
    assert volume.data.filepath == former


def test_the_live_grid_does_not_stay_behind(bar):
    volume, grid = bar
    session = sessions.open_session(volume)
    try:
        bpy.ops.repousse.resample_volume(voxel_size=grid.voxel_size / 2)
        assert session.grid.shape == tuple(2 * n for n in grid.shape)
        assert sessions.open_session(volume) is session
    finally:
        sessions.close_session()


@pytest.mark.parametrize("kind", ["new_clay_block", "mesh_to_clay"])
def test_dialogs_that_make_clay_tell_its_memory(kind):
    bpy.ops.mesh.primitive_cube_add(size=1.0)
    bpy.context.object.dimensions = (2.0, 1.0, 0.5)
    bpy.context.view_layer.update()
    texts = draw(getattr(bpy.types, f"REPOUSSE_OT_{kind}"), resolution=44, size=2.0).texts
    getattr(bpy.ops.repousse, kind)(resolution=44, material="wax")
    shape = bpy.context.object.data.repousse.shape
    assert any(" x ".join(map(str, shape)) in text for text in texts)
    assert any("MiB" in text for text in texts)


def test_new_clay_has_the_density_that_was_asked_for():
    bpy.ops.repousse.new_clay_block(resolution=8, material="foam", density=0.6)
    assert np.unique(grid_of(bpy.context.object).density).tolist() == [np.float32(0.6)]
