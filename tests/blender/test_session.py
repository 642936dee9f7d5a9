# SPDX-License-Identifier: GPL-3.0-or-later
"""The live grid and Blender: commits, undo, displays, what is refused, and what ends a stroke. Voxels to the bit."""

import shutil
import threading
from pathlib import Path

import bpy
import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.engine import Engine
from repousse.core.formats import read_volume, write_volume
from repousse.core.stroke import Sample, hash_of
from repousse.operators import revisions, session

from .sculpting import file_of, in_file, new_clay, same, stroke, the

bpy.utils.expose_bundled_modules()
import openvdb  # noqa: E402  Blender's own module is found from here on


@pytest.fixture(autouse=True)
def closed():
    yield
    session.close_session()


@pytest.fixture
def clay():
    return new_clay(name="Clay")


def shown(obj):
    """The voxels that Blender itself has evaluated for an object."""
    path = Path(bpy.app.tempdir) / "shown.vdb"
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert evaluated.data.grids.load() and evaluated.data.grids.save(str(path))
    grid = openvdb.read(str(path), "density")
    values = np.zeros(read_volume(file_of(obj)).shape, np.float32)
    grid.copyToArray(values)
    return values


def pushing(live, **options):
    return Push(live.grid, SphereTool(4.0), Material(), **options)


def test_a_commit_is_what_blender_then_shows(clay):
    first = file_of(clay)
    density = stroke(clay, 1)
    assert file_of(clay) not in (first, None) and first.exists()
    assert same(in_file(clay), density) and same(shown(clay), density)
    assert session.live().path == file_of(clay)
    assert session.open_session(clay) is session.live()


def test_undo_and_redo_thrice_give_path_and_voxels(clay):
    states = [(clay.data.filepath, in_file(clay))]
    for seed in range(3):
        density = stroke(the("Clay"), seed)
        states.append((the("Clay").data.filepath, density))
    for way, order in ((bpy.ops.ed.undo, (2, 1, 0)), (bpy.ops.ed.redo, (1, 2, 3))):
        for number in order:
            way()
            path, density = states[number]
            assert the("Clay").data.filepath == path
            live = session.live()
            assert live.path == Path(path)
            assert same(live.grid.density, density) and same(shown(the("Clay")), density)
            assert live.take_changes() == (True, [])


def test_a_stroke_on_top_of_what_was_undone_goes_on_from_there(clay):
    kept = stroke(clay, 1)
    stroke(the("Clay"), 2)
    bpy.ops.ed.undo()
    live = session.live()
    assert same(live.grid.density, kept)
    density = stroke(the("Clay"), 3)
    assert same(in_file(the("Clay")), density)
    bpy.ops.ed.undo()
    assert same(session.live().grid.density, kept)


def test_undo_of_the_volume_itself_closes_its_session():
    bpy.ops.ed.undo_push(message="before")
    stroke(new_clay(name="Clay"), 1)
    for _ in range(2):
        bpy.ops.ed.undo()
    assert "Clay" not in bpy.data.objects
    assert session.live() is None
    for _ in range(2):
        bpy.ops.ed.redo()
    density = in_file(the("Clay"))
    assert same(session.open_session(the("Clay")).grid.density, density)


def test_a_grid_that_grew_and_came_back(clay):
    before = in_file(clay)
    live = session.open_session(clay)
    push = pushing(live)
    push.move_to((12.0, 12.0, 3.0))
    push.move_to((12.0, 12.0, 1.0), continuous=True)
    assert live.grid.shape != before.shape
    live.commit(clay, [((0, 0, 0), live.grid.shape)])
    bpy.ops.ed.undo_push(message="Sculpt")
    grown, transform = live.grid.density.copy(), live.grid.transform.copy()
    back = read_volume(file_of(clay))
    assert same(back.density, grown) and np.array_equal(back.transform, transform)
    assert tuple(clay.data.repousse.shape) == grown.shape
    bpy.ops.ed.undo()
    assert same(session.live().grid.density, before)
    assert tuple(the("Clay").data.repousse.shape) == before.shape
    bpy.ops.ed.redo()
    assert same(session.live().grid.density, grown)
    assert np.array_equal(session.live().grid.transform, transform)


def test_mass_is_carried_along(clay):
    live = session.open_session(clay)
    live.grid.density[0] = 0.0
    live.commit(clay, [((0, 0, 0), (1, 24, 24))], mass_out=24.0 * 24.0)
    assert clay.data.repousse.mass == pytest.approx(23 * 24 * 24)
    assert clay.data.repousse.mass == pytest.approx(in_file(clay).sum(dtype=float))


def test_modifier_sees_the_new_voxels(clay):
    """Volume to Mesh: half of the block is gone, and so is half of the mesh."""
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    cube.name = "Mesh"
    modifier = cube.modifiers.new("Clay", "VOLUME_TO_MESH")
    modifier.object = clay

    def reach():
        mesh = the("Mesh").evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
        points = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", points)
        return np.ptp(points.reshape(-1, 3), axis=0)

    assert reach() == pytest.approx((1.2, 1.2, 1.2), abs=0.11)
    live = session.open_session(the("Clay"))
    live.grid.density[12:] = 0.0
    live.commit(the("Clay"), [((12, 0, 0), (24, 24, 24))])
    assert reach() == pytest.approx((0.6, 1.2, 1.2), abs=0.11)


@pytest.mark.skipif(not bpy.app.module, reason="a distribution's Cycles may draw no volumes")
def test_a_render_shows_the_new_voxels(clay, tmp_path):
    """F12, from above: where half of the block is gone, its half of the picture is empty."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.volume_biased = 4, False, True
    scene.world = bpy.data.worlds.new("Light")  # without any Cycles leaves volumes out
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.render.film_transparent = True
    scene.render.filepath, scene.render.image_settings.file_format = str(tmp_path / "render.png"), "PNG"
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 1.2, (0.0, 0.0, 5.0)
    bpy.context.collection.objects.link(camera)
    scene.camera = camera

    def alpha():
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath, check_existing=False)
        pixels = np.array(image.pixels[:]).reshape(16, 16, 4)
        bpy.data.images.remove(image)
        return pixels[:, :7, 3].mean(), pixels[:, 9:, 3].mean()  # but for the edge between them

    assert min(alpha()) > 0.9
    live = session.open_session(the("Clay"))
    live.grid.density[12:] = 0.0
    live.commit(the("Clay"), [((12, 0, 0), (24, 24, 24))])
    left, right = alpha()
    assert left > 0.9 and right < 0.05


def test_two_objects_in_turn(clay):
    other = new_clay(name="Other")
    states = {}
    for seed in range(4):
        name = ("Clay", "Other")[seed % 2]
        states[name] = stroke(the(name), seed)
        assert session.live().volume_uid == the(name).data.session_uid
    assert other.data.session_uid == the("Other").data.session_uid
    for name, density in states.items():
        assert same(in_file(the(name)), density)
        assert same(session.open_session(the(name)).grid.density, density)


@pytest.mark.parametrize("with_data", [True, False])
def test_a_duplicate(clay, with_data):
    density = stroke(clay, 1)
    twin = clay.copy()
    twin.name = "Twin"
    if with_data:
        twin.data = clay.data.copy()
    bpy.context.collection.objects.link(twin)
    bpy.ops.ed.undo_push(message="Duplicate")
    changed = stroke(the("Twin"), 2)
    assert same(in_file(the("Twin")), changed)
    assert same(in_file(the("Clay")), density if with_data else changed)
    stroke(the("Clay"), 3)
    assert same(in_file(the("Twin")), changed) == with_data


def test_what_is_deleted_is_not_committed_to(clay):
    live = session.open_session(clay)
    path = clay.data.filepath
    other = new_clay(name="Other")
    with pytest.raises(ValueError, match="Other: does not show the volume that was sculpted"):
        live.commit(other, None)
    bpy.data.objects.remove(the("Clay"))
    assert session.live() is live and live.volume.filepath == path
    bpy.data.volumes.remove(live.volume)
    assert live.volume is None
    bpy.context.view_layer.update()
    assert session.live() is None


def test_another_operators_file_is_followed(clay, tmp_path):
    live = session.open_session(clay)
    live.take_changes()
    grid = DensityGrid(np.full((5, 6, 7), 0.25, np.float32))
    write_volume(grid, tmp_path / "other.vdb")
    clay.data.filepath = str(tmp_path / "other.vdb")
    bpy.context.view_layer.update()
    assert session.live() is live
    assert same(live.grid.density, grid.density) and live.path == tmp_path / "other.vdb"
    assert live.take_changes() == (True, [])
    (tmp_path / "other.vdb").rename(tmp_path / "third.vdb")
    clay.data.filepath = str(tmp_path / "fourth.vdb")
    bpy.context.view_layer.update()
    assert session.live() is None


def test_refusals_say_why_in_one_line(clay, tmp_path):
    with_reason = pytest.raises(ValueError, match=r"^Clay: is a sequence of files: import the one of a single frame$")
    clay.data.is_sequence = True
    with with_reason:
        session.open_session(clay)
    clay.data.is_sequence = False
    clay.data.filepath = str(tmp_path / "none.vdb")
    with pytest.raises(ValueError, match=r"none\.vdb: cannot be read: No such file or directory"):
        session.open_session(clay)
    clay.data.filepath = ""
    with pytest.raises(ValueError, match="Clay: has no file"):
        session.open_session(clay)
    assert session.live() is None


def test_linked_and_overridden_volumes_are_refused(clay, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, into):
        into.objects = ["Clay"]
    linked = bpy.data.objects["Clay"]
    bpy.context.collection.objects.link(linked)
    with pytest.raises(ValueError, match="Clay: is linked from another file: make it local first"):
        session.open_session(linked)
    overridden = linked.override_create(remap_local_usages=True)
    overridden.data.override_create(remap_local_usages=True)
    assert overridden.data.override_library is not None
    with pytest.raises(ValueError, match="Clay: is linked from another file: make it local first"):
        session.open_session(overridden)


def test_a_failed_commit_leaves_everything_as_it_was(clay, monkeypatch):
    density = stroke(clay, 1)
    before, files = clay.data.filepath, set(revisions.folder().iterdir())
    live = session.open_session(clay)
    live.grid.density[3:9] = 0.125
    changed = live.grid.density.copy()
    write = openvdb.write

    def cut(name, **content):
        write(name, **content)
        Path(name).write_bytes(Path(name).read_bytes()[:-9])

    with monkeypatch.context() as full:
        full.setattr(openvdb, "write", cut)  # as OpenVDB does on a full disk, without a word
        with pytest.raises(ValueError, match=r"^[^\n]*cannot be written whole: the disk is full[^\n]*$"):
            live.commit(clay, [((3, 0, 0), (9, 24, 24))])
    assert clay.data.filepath == before and live.path == Path(before)
    assert set(revisions.folder().iterdir()) == files
    assert same(in_file(clay), density) and same(live.grid.density, changed)
    with monkeypatch.context() as gone:
        gone.setattr(revisions, "folder", lambda: Path("/nowhere"))
        with pytest.raises(ValueError, match=r"^[^\n]*cannot be written: No such file or directory$"):
            live.commit(clay, [((3, 0, 0), (9, 24, 24))])
    live.commit(clay, [])  # what failed is not forgotten
    assert same(in_file(clay), changed)


def test_a_folder_that_somebody_removed_is_made_again(clay):
    stroke(clay, 1)
    live = session.open_session(clay)
    shutil.rmtree(revisions.folder())
    live.grid.density[3:9] = 0.125
    live.commit(clay, None)
    assert same(in_file(clay), live.grid.density)


def test_boxes_that_changed_are_told_once(clay):
    live = session.open_session(clay)
    assert live.take_changes() == (True, [])
    assert live.take_changes() == (False, [])
    boxes = [((0, 0, 0), (1, 2, 3)), ((4, 4, 4), (5, 6, 7))]
    for box in boxes:
        live.changed(box)
    assert live.take_changes() == (False, boxes)
    assert live.take_changes() == (False, [])
    live.changed(None)
    live.changed(boxes[0])
    assert live.take_changes() == (True, [])
    assert live.take_changes() == (False, [])


def begin(live, border="wall"):
    """A stroke that has already moved something."""
    engine = Engine(pushing(live, border=border))
    engine.start()
    live.engine = engine
    for depth in (2.0, 1.5, 1.0):
        engine.feed(Sample(0.0, (12.0, 12.0, 21.0 - 6.0 / depth)))
    assert engine.settle(30.0)
    return engine


def test_a_strokes_boxes_are_indices_of_the_array(clay):
    live = session.open_session(clay)
    live.take_changes()
    before = live.grid.density.copy()
    engine = begin(live)
    entire, boxes = live.take_changes()
    assert not entire
    covered = np.zeros(before.shape, bool)
    for low, high in boxes:
        covered[tuple(slice(a, b) for a, b in zip(low, high))] = True
    differs = live.grid.density != before
    assert differs.any() and not (differs & ~covered).any()
    assert not covered.all()
    engine.cancel()
    live.engine = None


def test_a_stroke_that_grows_the_grid_changes_all_of_it(clay):
    live = session.open_session(clay)
    live.take_changes()
    shape = live.grid.shape
    engine = begin(live, border="grow")
    engine.feed(Sample(0.0, (12.0, 12.0, 8.0)))
    engine.feed(Sample(0.0, (12.0, 12.0, 2.0)))
    assert engine.settle(30.0)
    assert live.grid.shape != shape
    assert live.take_changes() == (True, [])
    before = live.grid.density.copy()
    engine.feed(Sample(0.0, (12.0, 12.0, 1.5)))
    assert engine.settle(30.0)
    entire, [(low, high)] = live.take_changes()  # from now on in boxes, though the frame of the poses lies elsewhere
    outside = live.grid.density != before
    assert not entire and outside.any()
    outside[tuple(slice(a, b) for a, b in zip(low, high))] = False
    assert not outside.any()
    engine.cancel()
    live.engine = None
    assert live.grid.shape == shape
    assert live.take_changes() == (True, [])


@pytest.mark.parametrize("event", ["undo", "redo", "load", "unregister", "close", "another"])
def test_what_ends_a_stroke(clay, addon, event):
    before = stroke(clay, 1)
    other = new_clay(name="Other")
    if event == "redo":
        bpy.ops.ed.undo()
    live = session.open_session(the("Clay"))
    before = live.grid.density.copy()
    threads = threading.active_count()
    engine = begin(live)
    assert engine.running and not same(live.grid.density, before)
    grid = live.grid
    if event == "undo":
        bpy.ops.ed.undo()
    elif event == "redo":
        bpy.ops.ed.redo()
    elif event == "load":
        bpy.ops.wm.read_homefile(app_template="", use_empty=True)
        assert session.live() is None
    elif event == "unregister":
        addon.unregister()
        try:
            assert session.live() is None
        finally:
            addon.register()
    elif event == "close":
        session.close_session()
        assert session.live() is None
    else:
        session.open_session(other)
        assert session.live() is not live
    assert not engine.running and engine.failure is None
    assert threading.active_count() == threads
    assert same(grid.density, before)
    assert live.engine is None


def test_the_hash_is_that_of_the_grid_as_it_is(clay):
    bpy.context.scene.repousse.record = True
    live = session.open_session(clay)
    assert live.grid_hash() == hash_of(live.grid)
    stroke(clay, 1)
    assert live.grid_hash() == hash_of(live.grid)
    stroke(clay, 2)
    bpy.ops.ed.undo()
    assert session.live().grid_hash() == hash_of(session.live().grid)
    live = session.live()
    live.engine = engine = Engine(pushing(live, border="wall"))
    with engine:
        engine.feed(Sample(0.0, (12.0, 12.0, 18.0)))
        engine.finish()
    live.engine = None
    assert live.grid_hash() == hash_of(live.grid)
    assert not [thread for thread in threading.enumerate() if thread.name == "repousse hash"]


def test_the_next_stroke_need_not_wait_for_the_hash(clay, monkeypatch):
    asked = []
    monkeypatch.setattr(session, "hash_of", lambda grid: asked.append(None) or hash_of(grid))
    bpy.context.scene.repousse.record = True
    stroke(clay, 1)
    live = session.live()
    live.engine = None  # as a stroke ends
    assert live.grid_hash() == hash_of(live.grid)
    assert len(asked) == 2  # when the file was read, and at the stroke's end


def test_automatic_level_is_that_of_the_clay_and_stays_through_undo(clay):
    assert session.open_session(clay).auto_level == pytest.approx(0.5, abs=0.01)
    stroke(clay, 1)
    bpy.ops.ed.undo()
    assert session.live().auto_level == pytest.approx(0.5, abs=0.01)


def display(name):
    return the(name).display_type, the(name).repousse_display


def test_display_is_taken_and_given_back(clay):
    clay.display_type = "WIRE"
    live = session.open_session(clay)
    live.take_display(clay)
    live.take_display(clay)
    assert display("Clay") == ("BOUNDS", "WIRE")
    live.give_back_display(clay)
    assert display("Clay") == ("WIRE", "")
    live.take_display(clay)
    clay.display_type = "SOLID"  # the artist's own choice
    session.close_session()
    assert display("Clay") == ("SOLID", "")


def test_only_one_object_is_taken(clay):
    other = new_clay(name="Other")
    session.open_session(clay).take_display(clay)
    session.open_session(other).take_display(other)
    assert display("Clay") == ("TEXTURED", "")
    assert display("Other") == ("BOUNDS", "TEXTURED")


def test_display_through_undo(clay):
    session.open_session(clay).take_display(clay)
    stroke(clay, 1)
    bpy.ops.ed.undo()  # to before it was taken
    assert display("Clay") == ("BOUNDS", "TEXTURED")
    session.live().give_back_display(the("Clay"))
    bpy.ops.ed.redo()  # to while it was
    assert display("Clay") == ("TEXTURED", "")


def test_display_is_saved_as_it_was(clay, tmp_path):
    session.open_session(clay).take_display(clay)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    assert display("Clay") == ("BOUNDS", "TEXTURED")
    shutil.copy(tmp_path / "a.blend", tmp_path / "b.blend")
    with bpy.data.libraries.load(str(tmp_path / "b.blend")) as (_, into):
        into.objects = ["Clay"]
    assert (into.objects[0].display_type, into.objects[0].repousse_display) == ("TEXTURED", "")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert display("Clay") == ("TEXTURED", "")


def test_display_that_a_crash_left_is_given_back(clay, tmp_path):
    clay.repousse_display, clay.display_type = "SOLID", "BOUNDS"
    handlers = list(bpy.app.handlers.save_pre)
    bpy.app.handlers.save_pre.clear()  # quit.blend and autosaves call none
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"), copy=True)
    finally:
        bpy.app.handlers.save_pre.extend(handlers)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert display("Clay") == ("SOLID", "")


def test_display_is_given_back_when_the_add_on_goes(clay, addon):
    session.open_session(clay).take_display(clay)
    addon.unregister()
    try:
        assert the("Clay").display_type == "TEXTURED"
    finally:
        addon.register()
