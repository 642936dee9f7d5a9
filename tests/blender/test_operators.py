# SPDX-License-Identifier: GPL-3.0-or-later
"""The verbs in Blender, judged by the voxels that Blender itself then has."""

import math
from pathlib import Path

import bpy
import numpy as np
import pytest

from repousse.core import PRESETS, DensityGrid, SphereTool, Stroke
from repousse.core.formats import read_volume, write_volume
from repousse.operators import volumes

bpy.utils.expose_bundled_modules()
import openvdb  # noqa: E402  Blender's own module is found from here on


def shown(volume):
    """(values, transform) of what Blender shows: it saves its own evaluated grid, and OpenVDB reads that."""
    path = Path(bpy.app.tempdir) / "shown.vdb"
    evaluated = volume.evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert evaluated.data.grids.load()
    assert evaluated.data.grids.save(str(path))
    [grid] = openvdb.readAllGridMetadata(str(path))
    grid = openvdb.read(str(path), grid.name)
    low, high = grid.evalActiveVoxelBoundingBox()
    values = np.zeros(np.array(high) - low + 1, np.float32)
    grid.copyToArray(values, ijk=low)
    rows = [grid.transform.indexToWorld(corner) for corner in (low, *(np.array(low) + np.eye(3)))]
    transform = np.eye(4)
    transform[:3, 3] = rows[0]
    transform[:3, :3] = (np.array(rows[1:]) - rows[0]).T
    return values, transform


def uneven():
    """A block whose every voxel is its own, so that no axis can be taken for another."""
    values = np.random.default_rng(7).uniform(0.1, 1.0, (5, 6, 7)).astype(np.float32)
    transform = np.diag([0.25, 0.25, 0.25, 1.0])
    transform[:3, 3] = (1.0, 2.0, 3.0)
    return DensityGrid(values, transform)


def file_of(volume):
    return Path(bpy.path.abspath(volume.data.filepath))


@pytest.fixture
def block():
    """A block of clay as the active object, with what core reads of it."""
    assert bpy.ops.repousse.new_clay_block(resolution=32, size=1.6) == {"FINISHED"}
    made = bpy.context.object
    return made, read_volume(file_of(made))


@pytest.fixture
def stroke(tmp_path):
    path = tmp_path / "stroke.jsonl"
    drawn = Stroke.line((16, 16, 38), (16, 16, 28), tool=SphereTool(5.0), material=PRESETS["clay"].material, band=5.0)
    drawn.save(path)
    return path


def test_imported_vdb_is_shown_bit_for_bit_and_in_its_place(tmp_path):
    grid = uneven()
    write_volume(grid, tmp_path / "in.vdb")
    assert bpy.ops.repousse.import_volume(filepath=str(tmp_path / "in.vdb")) == {"FINISHED"}
    made = bpy.context.object
    assert (made.type, made.name) == ("VOLUME", "in")
    values, transform = shown(made)
    assert values.tobytes() == grid.density.tobytes()
    assert transform == pytest.approx(grid.transform)
    told = made.data.repousse
    assert tuple(told.shape) == (5, 6, 7)
    assert (told.voxel_size, told.mass) == pytest.approx((0.25, grid.mass))


def test_import_makes_a_material_that_finds_the_grid(tmp_path):
    grid = uneven()
    grid.name = "smoke"
    write_volume(grid, tmp_path / "in.vdb")
    bpy.ops.repousse.import_volume(filepath=str(tmp_path / "in.vdb"))
    volume = bpy.context.object.data
    volume.grids.load()
    [material] = volume.materials
    [shader] = (node for node in material.node_tree.nodes if node.type == "PRINCIPLED_VOLUME")
    assert shader.outputs["Volume"].is_linked
    assert shader.inputs["Density Attribute"].default_value == volume.grids[0].name == "smoke"
    assert shader.inputs["Density"].default_value * 0.25 == pytest.approx(volumes.OPACITY)


def test_import_windows_a_pvm_and_chooses_a_grid(tmp_path):
    grid = DensityGrid(np.linspace(0.0, 1.0, 64).reshape(4, 4, 4))
    write_volume(grid, tmp_path / "in.pvm")
    window = {"use_window": True, "window_low": 127.5, "window_high": 255.0}
    bpy.ops.repousse.import_volume(filepath=str(tmp_path / "in.pvm"), **window)
    half = np.clip(2.0 * grid.density - 1.0, 0.0, 1.0)
    assert np.abs(read_volume(file_of(bpy.context.object)).density - half).max() < 0.01
    pair = []
    for name, value in ("heat", 0.25), ("fog", 0.75):
        made = openvdb.FloatGrid()
        made.name = name
        made.fill((0, 0, 0), (3, 3, 3), value)
        pair.append(made)
    openvdb.write(str(tmp_path / "two.vdb"), grids=pair)
    for name, value in ("heat", 0.25), ("fog", 0.75):
        bpy.ops.repousse.import_volume(filepath=str(tmp_path / "two.vdb"), grid=name)
        assert (read_volume(file_of(bpy.context.object)).density == value).all()


@pytest.mark.parametrize("content", [b"", b"noise" * 1000])
def test_import_of_a_bad_file_says_so_and_makes_nothing(tmp_path, content):
    path = tmp_path / "bad.vdb"
    path.write_bytes(content)
    with pytest.raises(RuntimeError, match=r"bad\.vdb: is "):
        bpy.ops.repousse.import_volume(filepath=str(path))
    assert not bpy.data.objects and not bpy.data.volumes and not bpy.data.materials


@pytest.mark.parametrize("material", PRESETS)
def test_clay_block_stands_around_the_cursor_with_its_materials_density(material):
    bpy.context.scene.cursor.location = (1.0, 2.0, 3.0)
    assert bpy.ops.repousse.new_clay_block(resolution=16, size=0.8, material=material) == {"FINISHED"}
    made = bpy.context.object
    values, transform = shown(made)
    assert values.shape == (16, 16, 16)
    assert (values == np.float32(PRESETS[material].density)).all()
    lowest = np.array(made.matrix_world) @ transform @ (-0.5, -0.5, -0.5, 1.0)
    highest = np.array(made.matrix_world) @ transform @ (15.5, 15.5, 15.5, 1.0)
    assert lowest[:3] == pytest.approx((0.6, 1.6, 2.6))
    assert highest[:3] == pytest.approx((1.4, 2.4, 3.4))


def test_sphere_becomes_clay_of_its_volume_where_it_stands():
    bpy.ops.mesh.primitive_uv_sphere_add(
        segments=128, ring_count=64, radius=1.5, location=(4, 5, 6), rotation=(0, 1, 0)
    )
    ball = bpy.context.object
    ball.rotation_euler = (0.0, 1.0, 0.0)
    ball.scale = (2.0, 1.0, 1.0)  # an ellipsoid: the scale goes into the voxels
    bpy.context.view_layer.update()
    assert bpy.ops.repousse.mesh_to_clay(resolution=96) == {"FINISHED"}
    made = bpy.context.object
    assert tuple(made.matrix_world.to_scale()) == pytest.approx((1, 1, 1))
    assert made.matrix_world.translation == ball.matrix_world.translation
    assert made.matrix_world.to_quaternion().rotation_difference(ball.matrix_world.to_quaternion()).angle < 1e-5
    values, transform = shown(made)
    voxel = np.linalg.norm(transform[:3, :3], axis=0)
    assert voxel == pytest.approx([6.0 / 92] * 3)
    assert values.sum(dtype=float) * voxel[0] ** 3 == pytest.approx(4 / 3 * math.pi * 3.0 * 1.5 * 1.5, rel=0.01)
    centre = np.argwhere(values > 0.5).mean(axis=0)
    assert transform @ (*centre, 1.0) == pytest.approx((0, 0, 0, 1), abs=0.01)
    assert ball.hide_get() and ball.hide_render


def test_mesh_to_clay_sees_modifiers_and_the_materials_density():
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    array = bpy.context.object.modifiers.new("Two", "ARRAY")
    array.relative_offset_displace = (2.0, 0.0, 0.0)
    bpy.ops.repousse.mesh_to_clay(resolution=64, material="foam")
    values, transform = shown(bpy.context.object)
    assert values.max() == np.float32(PRESETS["foam"].density)
    assert values.sum(dtype=float) * transform[0, 0] ** 3 == pytest.approx(16.0 * PRESETS["foam"].density, rel=0.01)


def test_mesh_that_encloses_nothing_is_refused():
    bpy.ops.mesh.primitive_plane_add()
    with pytest.raises(RuntimeError, match="Plane: the mesh encloses nothing as wide as a voxel"):
        bpy.ops.repousse.mesh_to_clay(resolution=32)
    assert not bpy.data.volumes


def test_replay_is_cores_push_bit_for_bit_in_a_file_of_its_own(block, stroke):
    made, grid = block
    first = file_of(made)
    recorded = Stroke.load(stroke)
    push = recorded.push(grid)
    push.follow(recorded)
    assert bpy.ops.repousse.replay_stroke(filepath=str(stroke)) == {"FINISHED"}
    second = file_of(made)
    assert second != first and first.exists()  # Blender never reads a path twice, and undo goes back to the first
    sculpted = read_volume(second)
    assert sculpted.density.tobytes() == push.grid.density.tobytes()
    assert np.array_equal(sculpted.transform, push.grid.transform)
    values, _ = shown(made)
    assert values.sum(dtype=float) == pytest.approx(grid.mass, rel=1e-7)
    assert made.data.repousse.mass == pytest.approx(32**3)
    assert tuple(made.data.repousse.shape) == push.grid.shape != (32, 32, 32)


def test_undo_takes_a_replay_back_in_one_step(block, stroke):
    name, first = block[0].name, block[0].data.filepath
    bpy.ops.ed.undo_push(message="before")  # operators called by a script push no step of their own
    bpy.ops.repousse.replay_stroke(filepath=str(stroke))
    second = bpy.data.objects[name].data.filepath
    bpy.ops.ed.undo_push(message="Replay Stroke")
    bpy.ops.ed.undo()
    assert bpy.data.objects[name].data.filepath == first != second
    assert tuple(bpy.data.objects[name].data.repousse.shape) == (32, 32, 32)
    assert (shown(bpy.data.objects[name])[0] == 1.0).all()
    bpy.ops.ed.redo()
    assert bpy.data.objects[name].data.filepath == second


def test_replay_of_a_bad_stroke_leaves_the_volume_as_it_was(block, tmp_path):
    made, _ = block
    first = made.data.filepath
    (tmp_path / "bad.jsonl").write_text("{}\n")
    with pytest.raises(RuntimeError, match=r"bad\.jsonl, line 1: "):
        bpy.ops.repousse.replay_stroke(filepath=str(tmp_path / "bad.jsonl"))
    assert made.data.filepath == first


def test_volumes_that_a_new_file_would_break_are_refused(block, stroke, tmp_path):
    made, _ = block
    made.data.is_sequence = True
    with pytest.raises(RuntimeError, match="is a sequence of files"):
        bpy.ops.repousse.replay_stroke(filepath=str(stroke))
    made.data.is_sequence = False
    made.data.filepath = ""
    with pytest.raises(RuntimeError, match="has no file"):
        bpy.ops.repousse.replay_stroke(filepath=str(stroke))


def test_replay_writes_the_files_other_grids_through(block, stroke, tmp_path):
    made, _ = block
    pair = []
    for name, value in ("heat", 300.0), ("density", 1.0):
        pair.append(openvdb.FloatGrid())
        pair[-1].name = name
        pair[-1].fill((0, 0, 0), (31, 31, 31), value)
    openvdb.write(str(tmp_path / "two.vdb"), grids=pair, metadata={"scene": "kiln"})
    made.data.filepath = str(tmp_path / "two.vdb")
    assert bpy.ops.repousse.replay_stroke(filepath=str(stroke)) == {"FINISHED"}
    after, about = openvdb.readAll(str(file_of(made)))
    assert about == {"scene": "kiln"}
    named = {grid.name: grid for grid in after}
    assert set(named) == {"heat", "density"}
    assert named["heat"].activeVoxelCount() == 32**3 and named["heat"].evalMinMax() == (300.0, 300.0)
    assert read_volume(file_of(made)).density.min() < 1.0


def test_export_writes_what_is_shown_where_it_is_shown(block, stroke, tmp_path):
    made, _ = block
    bpy.ops.repousse.replay_stroke(filepath=str(stroke))
    made.matrix_world = (
        volumes.Matrix.Translation((1, 2, 3)) @ volumes.Matrix.Rotation(0.5, 4, "X") @ (volumes.Matrix.Scale(2.0, 4))
    )
    bpy.context.view_layer.update()
    own = read_volume(file_of(made))
    for placed, matrix in (True, np.array(made.matrix_world)), (False, np.eye(4)):
        path = tmp_path / f"{placed}.vdb"
        assert bpy.ops.repousse.export_vdb(filepath=str(path), use_world=placed) == {"FINISHED"}
        written = read_volume(path)
        assert written.density.tobytes() == own.density.tobytes()
        assert written.transform == pytest.approx(matrix @ own.transform)
    made.scale = (1, 2, 1)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="scale is not the same along its axes"):
        bpy.ops.repousse.export_vdb(filepath=str(tmp_path / "c.vdb"))
    assert not (tmp_path / "c.vdb").exists()


def test_verbs_ask_for_what_they_need():
    assert not bpy.ops.repousse.export_vdb.poll()
    assert not bpy.ops.repousse.replay_stroke.poll()
    assert not bpy.ops.repousse.mesh_to_clay.poll()
    bpy.ops.mesh.primitive_cube_add()
    assert bpy.ops.repousse.mesh_to_clay.poll()
    assert not bpy.ops.repousse.export_vdb.poll()


def test_volumes_are_kept_in_the_extensions_own_folder(block, addon):
    folder = bpy.utils.extension_path_user(addon.__package__, path="volumes")
    assert file_of(block[0]).is_relative_to(folder)
