# SPDX-License-Identifier: GPL-3.0-or-later
"""A .blend takes its volumes along wherever it is saved, and each backup still finds its own."""

import json
import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest

from repousse.core import DensityGrid
from repousse.core.formats import write_volume
from repousse.operators import revisions, saving, session

from .sculpting import file_of, in_file, new_clay, same, stroke, the


@pytest.fixture(autouse=True)
def closed():
    yield
    session.close_session()


@pytest.fixture
def clay():
    return new_clay(name="Clay")


def save(path, **options):
    path.parent.mkdir(exist_ok=True)
    assert bpy.ops.wm.save_as_mainfile(filepath=str(path), **options) == {"FINISHED"}


def reopened(path):
    """The density that the saved file shows, read in a fresh session."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return in_file(the("Clay"))


def copies(blend):
    folder = blend.with_name(f"{blend.stem} volumes")
    return {path.name for path in folder.glob("*.vdb")}


def test_save_and_reopen(clay, tmp_path):
    density = stroke(clay, 1)
    blend, grid = tmp_path / "a.blend", session.live().grid
    save(blend)
    bpy.context.view_layer.update()
    assert session.live().grid is grid  # it need not be read again
    assert the("Clay").data.filepath == f"//a volumes/{file_of(the('Clay')).name}"
    assert file_of(the("Clay")).parent == tmp_path / "a volumes"
    live = session.live()
    assert live.path == file_of(the("Clay")) and session.open_session(the("Clay")) is live
    shutil.rmtree(revisions.folder())
    assert same(reopened(blend), density)
    changed = stroke(the("Clay"), 2)
    bpy.ops.wm.save_mainfile()
    assert the("Clay").data.filepath.startswith("//a volumes/")
    assert same(reopened(blend), changed)


def test_a_saved_folder_can_be_moved(clay, tmp_path):
    density = stroke(clay, 1)
    save(tmp_path / "one" / "a.blend")
    shutil.rmtree(revisions.folder())
    (tmp_path / "one").rename(tmp_path / "two")
    assert same(reopened(tmp_path / "two" / "a.blend"), density)


def test_save_as_into_other_folders(clay, tmp_path):
    """Each .blend has its own copies, whatever becomes of the others."""
    blends = [tmp_path / name for name in ("one/a.blend", "two/b.blend", "two/c.blend", "one/a.blend")]
    densities = {}
    for seed, blend in enumerate(blends):
        densities[blend] = stroke(the("Clay"), seed) if seed != 2 else densities[blends[1]]
        save(blend)
        assert file_of(the("Clay")).parent == blend.with_name(f"{blend.stem} volumes")
        assert the("Clay").data.filepath.startswith(f"//{blend.stem} volumes/")
    shutil.rmtree(revisions.folder())
    for blend, density in densities.items():
        assert same(reopened(blend), density)
        assert file_of(the("Clay")).parent == blend.with_name(f"{blend.stem} volumes")


def test_save_copy_leaves_the_session_where_it_is(clay, tmp_path):
    for first in (False, True):
        density = stroke(the("Clay"), 1 + first)
        before = the("Clay").data.filepath
        grid = session.live().grid
        save(tmp_path / "copies" / "c.blend", copy=True)
        bpy.context.view_layer.update()
        assert session.live().grid is grid
        assert the("Clay").data.filepath == before
        assert session.live().path == Path(before) and file_of(the("Clay")).parent == revisions.folder()
        assert same(session.open_session(the("Clay")).grid.density, density)
        if not first:
            save(tmp_path / "a.blend")
    assert same(reopened(tmp_path / "copies" / "c.blend"), density)


def test_save_copy_of_what_is_saved_keeps_its_relative_path(clay, tmp_path):
    density = stroke(clay, 1)
    save(tmp_path / "a.blend")
    before = the("Clay").data.filepath
    save(tmp_path / "copies" / "c.blend", copy=True)
    assert the("Clay").data.filepath == before
    shutil.rmtree(tmp_path / "a volumes")
    shutil.rmtree(revisions.folder())
    assert same(reopened(tmp_path / "copies" / "c.blend"), density)


def test_a_save_that_fails_changes_nothing(clay, tmp_path):
    density = stroke(clay, 1)
    before = clay.data.filepath
    (tmp_path / "full.blend@").mkdir()  # Blender writes under this name first
    with pytest.raises(RuntimeError):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "full.blend"))
    assert the("Clay").data.filepath == before
    assert same(in_file(the("Clay")), density)


def test_without_relative_remap_it_is_found_again(clay, tmp_path):
    save(tmp_path / "one" / "a.blend")
    density = stroke(the("Clay"), 1)
    (tmp_path / "two").mkdir()
    live = session.live()
    save(tmp_path / "two" / "deep" / "b.blend", relative_remap=False)
    assert same(in_file(the("Clay")), density)
    assert session.open_session(the("Clay")) is live
    shutil.rmtree(tmp_path / "one")
    shutil.rmtree(revisions.folder())
    assert same(reopened(tmp_path / "two" / "deep" / "b.blend"), density)


def test_where_no_copy_can_be_made_the_path_stays(clay, tmp_path, capfd):
    density = stroke(clay, 1)
    before = file_of(clay)
    (tmp_path / "a volumes").write_text("a file of this name is in the way")
    save(tmp_path / "a.blend")
    said = capfd.readouterr().err.splitlines()
    assert len(said) == 1 and said[0].startswith("Repoussé: Clay is not saved beside")
    assert file_of(the("Clay")) == before
    live = session.live()
    assert session.open_session(the("Clay")) is live
    bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    new_clay(name="Other")
    stroke(the("Other"), 1)
    assert same(reopened(tmp_path / "a.blend"), density)  # it stays although another file was loaded


def test_undo_after_save_as_into_another_folder(clay, tmp_path):
    save(tmp_path / "one" / "a.blend")
    save(tmp_path / "one" / "a.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "one" / "a.blend"))
    bpy.ops.ed.undo_push(message="opened")
    first = in_file(the("Clay"))
    stroke(the("Clay"), 1)
    save(tmp_path / "two" / "b.blend")
    bpy.ops.ed.undo()
    assert same(in_file(the("Clay")), first)
    assert same(session.live().grid.density, first)


def test_undo_reaches_what_was_saved_long_ago(clay, tmp_path):
    """Copies that no backup shows any more stay while undo may come back to them, and go after that."""
    blend = tmp_path / "a.blend"
    save(blend)
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    bpy.ops.ed.undo_push(message="opened")
    states = [in_file(the("Clay"))]
    for seed in range(4):
        states.append(stroke(the("Clay"), seed))
        bpy.ops.wm.save_mainfile()
    for density in reversed(states[:-1]):
        bpy.ops.ed.undo()
        assert same(in_file(the("Clay")), density)
        assert same(session.live().grid.density, density)
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    assert same(in_file(the("Clay")), states[-1])
    for seed in range(2):
        stroke(the("Clay"), seed)
        bpy.ops.wm.save_mainfile()
        bpy.ops.wm.open_mainfile(filepath=str(blend))
    assert len(copies(blend)) <= 3


@pytest.mark.parametrize("backups", [0, 1, 2])
def test_each_backup_finds_its_volume(clay, tmp_path, backups):
    preferences = bpy.context.preferences
    former, preferences.filepaths.save_version = preferences.filepaths.save_version, backups
    steps, preferences.edit.undo_steps = preferences.edit.undo_steps, 0  # so that undo keeps nothing
    blend = tmp_path / "a.blend"
    try:
        states = []
        for seed in range(7):
            states.append(stroke(the("Clay"), seed))
            save(blend)
        bpy.ops.wm.read_homefile(app_template="", use_empty=True)
        assert len(copies(blend)) == 1 + backups
    finally:
        preferences.filepaths.save_version, preferences.edit.undo_steps = former, steps
    shutil.rmtree(revisions.folder(), ignore_errors=True)
    for age in range(backups + 1):
        old = blend.with_name(f"a.blend{age or ''}")
        (tmp_path / "look.blend").unlink(missing_ok=True)
        shutil.copy(old, tmp_path / "look.blend")
        assert same(reopened(tmp_path / "look.blend"), states[-1 - age])


@pytest.mark.parametrize("broken", ["", "7", '["x.vdb", 7]', "{"])
def test_only_listed_files_are_removed(clay, tmp_path, broken):
    blend = tmp_path / "a.blend"
    save(blend)
    own = tmp_path / "a volumes" / "mine.vdb"
    own.write_text("the artist's own")
    outside = tmp_path / "outside.vdb"
    outside.write_text("no business of ours")
    listed = tmp_path / "a volumes" / saving.LIST
    text = json.dumps([["x.vdb"], ["../outside.vdb"], [str(outside)]])
    listed.write_text(f"{text[:-1]}, {broken}]" if broken else text)
    for seed in range(4):
        stroke(the("Clay"), seed)
        save(blend)
    assert own.exists() and outside.exists()
    assert same(reopened(blend), in_file(the("Clay")))


def test_append_into_a_new_file(clay, tmp_path):
    density = stroke(clay, 1)
    save(tmp_path / "one" / "a.blend")
    bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "one" / "a.blend")) as (_, into):
        into.objects = ["Clay"]
    bpy.context.collection.objects.link(into.objects[0])
    bpy.ops.ed.undo_push(message="Append")
    assert same(session.open_session(the("Clay")).grid.density, density)
    changed = stroke(the("Clay"), 2)
    save(tmp_path / "two" / "b.blend")
    assert same(in_file(the("Clay")), changed)
    shutil.rmtree(revisions.folder())
    assert same(reopened(tmp_path / "one" / "a.blend"), density)
    shutil.rmtree(tmp_path / "one")
    assert same(reopened(tmp_path / "two" / "b.blend"), changed)


def test_what_was_appended_is_taken_along_unsculpted(clay, tmp_path):
    density = stroke(clay, 1)
    save(tmp_path / "one" / "a.blend")
    bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "one" / "a.blend")) as (_, into):
        into.objects = ["Clay"]
    bpy.context.collection.objects.link(into.objects[0])
    save(tmp_path / "two" / "b.blend")
    shutil.rmtree(tmp_path / "one")
    assert same(reopened(tmp_path / "two" / "b.blend"), density)


def test_the_artists_own_files_are_not_copied(tmp_path):
    write_volume(DensityGrid(np.ones((4, 4, 4))), tmp_path / "smoke.vdb")
    volume = bpy.data.volumes.new("Smoke")
    volume.filepath = str(tmp_path / "smoke.vdb")
    save(tmp_path / "one" / "a.blend")
    assert [path.name for path in (tmp_path / "one").iterdir()] == ["a.blend"]
    assert revisions.path_of(bpy.data.volumes["Smoke"]) == tmp_path / "smoke.vdb"
