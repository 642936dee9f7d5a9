# SPDX-License-Identifier: GPL-3.0-or-later
"""Recorded strokes: kept with their volume, saved as files, replayed to the voxels that core makes of them."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from repousse.core import PRESETS, DensityGrid, Sample, SphereTool, Stroke
from repousse.core.formats import read_volume
from repousse.operators import cli, strokes
from repousse.operators import session as sessions
from repousse.operators.replay_stroke import walk
from repousse.operators.volumes import add_volume

HEADER = {"tool": SphereTool(4.0), "material": PRESETS["clay"].material, "band": 4.0}


@pytest.fixture
def block():
    """A block of clay with room above it, as the active object."""
    density = np.zeros((32, 32, 40), np.float32)
    density[:, :, :32] = 1.0
    return add_volume(bpy.context, DensityGrid(density, np.diag([0.05, 0.05, 0.05, 1.0])), "Clay")


def grid_of(volume):
    return read_volume(bpy.path.abspath(volume.data.filepath))


def poses(*positions, **fields):
    return [Sample(0.01 * n, position, **fields) for n, position in enumerate(positions)]


def push_down():
    return Stroke.line((16, 16, 38), (16, 16, 28), **HEADER)


def mirrored():
    return replace(Stroke.line((6, 16, 38), (9, 16, 30), **HEADER), symmetry="x", mirror=(15.5, 15.5, 15.5))


def pulled():
    samples = poses((16, 16, 26), (18, 16, 26), (20, 16, 26), direction=(0.0, 0.0, 1.0), strength=0.5)
    return Stroke(samples, verb="pull", **HEADER | {"band": None})


def smoothed():
    samples = poses((16, 16, 31), (18, 16, 31), (22, 16, 31), strength=1.0)
    return Stroke(samples, verb="smooth", **HEADER | {"band": None})


def chosen():
    """As Auto leaves it: another quality pose by pose."""
    stroke = push_down()
    return replace(
        stroke, samples=[replace(s, quality=("draft", "exact")[n % 2]) for n, s in enumerate(stroke.samples)]
    )


KINDS = {"chosen": chosen, "push": push_down, "mirrored": mirrored, "pull": pulled, "smooth": smoothed}


@pytest.mark.parametrize("kind", KINDS)
def test_a_kept_stroke_replays_to_the_voxels_that_core_makes(block, kind):
    stroke, expected = KINDS[kind](), grid_of(block)
    before = expected.density.copy()
    push = stroke.push(expected)
    for sample in stroke.samples:
        push.walk(sample, stroke.continuous)
    assert expected.density.shape != before.shape or (expected.density != before).any()
    text = strokes.keep(stroke, block.data)
    assert bpy.ops.repousse.replay_kept_stroke(text=text.name) == {"FINISHED"}
    made = grid_of(block)
    assert made.density.tobytes() == expected.density.tobytes()
    assert block.data.repousse.mass == pytest.approx(expected.mass)
    assert tuple(block.data.repousse.shape) == expected.shape


def test_saved_strokes_replay_by_the_cli_to_the_same_voxels(block, tmp_path):
    """Two strokes, the second on what the first left: the files, in their order, make of the first file the last."""
    bpy.data.volumes[0].name = "Ein Block/1"
    start = tmp_path / "start.vdb"
    bpy.ops.repousse.export_vdb(filepath=str(start), use_world=False)
    for stroke in (push_down(), Stroke.line((10, 16, 36), (22, 16, 29), **HEADER)):
        kept = strokes.keep(stroke.began_on(grid_of(block)), block.data)
        bpy.ops.repousse.replay_kept_stroke(text=kept.name)
    (tmp_path / "out").mkdir()
    assert bpy.ops.repousse.save_strokes(directory=str(tmp_path / "out")) == {"FINISHED"}
    files = sorted((tmp_path / "out").iterdir())
    assert [path.name for path in files] == ["Ein_Block_1-001.jsonl", "Ein_Block_1-002.jsonl"]
    options = [word for path in files for word in ("--stroke", str(path))]
    assert cli.main(["push", str(start), *options, "--out", str(tmp_path / "end.vdb")]) == 0
    assert read_volume(tmp_path / "end.vdb").density.tobytes() == grid_of(block).density.tobytes()


def test_saving_again_is_fine_and_overwrites_nothing_else(block, tmp_path):
    strokes.keep(push_down(), block.data)
    strokes.keep(mirrored(), block.data)
    bpy.ops.repousse.save_strokes(directory=str(tmp_path))
    first, second = sorted(tmp_path.iterdir())
    assert bpy.ops.repousse.save_strokes(directory=str(tmp_path)) == {"FINISHED"}
    second.write_text("another's work")
    first.unlink()
    with pytest.raises(RuntimeError, match=r"-002\.jsonl: is there already"):
        bpy.ops.repousse.save_strokes(directory=str(tmp_path))
    assert second.read_text() == "another's work" and not first.exists()


def test_strokes_come_back_with_the_file_and_go_with_undo(block, tmp_path):
    stroke = push_down()
    bpy.ops.ed.undo_push(message="block")
    strokes.keep(stroke, block.data)
    bpy.ops.ed.undo_push(message="stroke")
    bpy.ops.ed.undo()
    volume = bpy.context.object.data
    assert not strokes.kept(volume) and not bpy.data.texts
    bpy.ops.ed.redo()
    [text] = strokes.kept(bpy.context.object.data)
    assert strokes.stroke_in(text) == stroke
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    [text] = strokes.kept(bpy.context.object.data)
    assert strokes.stroke_in(text) == stroke


def test_a_copy_has_the_strokes_of_its_own(block):
    first, second = strokes.keep(push_down(), block.data), strokes.keep(mirrored(), block.data)
    assert (first.name[:10], second.name[:10]) == ("Stroke 001", "Stroke 002")
    copy = block.data.copy()
    block.data.repousse_strokes.active = 0
    assert bpy.ops.repousse.forget_stroke() == {"FINISHED"}
    assert strokes.kept(block.data) == [second]
    assert strokes.kept(copy) == [first, second]  # and its text is still there
    bpy.data.volumes.remove(copy)  # which leaves its texts to the artist
    assert bpy.ops.repousse.forget_stroke() == {"FINISHED"}
    assert strokes.kept(block.data) == [] and list(bpy.data.texts) == [first]


def test_a_deleted_text_is_no_stroke_any_more(block):
    first, second = strokes.keep(push_down(), block.data), strokes.keep(mirrored(), block.data)
    bpy.data.texts.remove(first)
    assert strokes.kept(block.data) == [second]


@pytest.mark.parametrize(("line", "broken"), [(0, "hello"), (0, ""), (3, '{"position": [1, 2]}')])
def test_a_text_that_is_no_stroke_is_refused_by_name_and_line(block, line, broken):
    text = strokes.keep(Stroke.line((16, 16, 38), (16, 16, 33), **HEADER), block.data)
    lines = text.as_string().splitlines()
    lines[line] = broken
    text.from_string("\n".join(lines) if broken else "")
    former = block.data.filepath
    with pytest.raises(RuntimeError, match=f"{text.name}, line {line + 1}: "):
        bpy.ops.repousse.replay_kept_stroke(text=text.name)
    assert block.data.filepath == former


def test_a_text_that_is_not_there_is_refused(block):
    with pytest.raises(RuntimeError, match="There is no text 'none'"):
        bpy.ops.repousse.replay_kept_stroke(text="none")


@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_stroke_of_another_volume_is_told_as_such(block, capfd, elsewhere):
    stroke, former = push_down().began_on(grid_of(block)), block.data.filepath
    text = strokes.keep(replace(stroke, grid_hash="0" * 32) if elsewhere else stroke, block.data)
    bpy.ops.repousse.replay_kept_stroke(text=text.name)
    assert block.data.filepath != former
    assert ("recorded on another volume" in "".join(capfd.readouterr())) is elsewhere


def test_a_replay_that_fails_half_way_changes_nothing(block, monkeypatch):
    """Neither the file that is shown nor the grid that may be held live."""
    text, stroke = strokes.keep(push_down(), block.data), push_down()
    stroke.samples[-1] = replace(stroke.samples[-1], radius=0.1)
    monkeypatch.setattr(strokes, "stroke_in", lambda _: stroke)
    session, former = sessions.open_session(block), block.data.filepath
    density = session.grid.density.tobytes()
    try:
        with pytest.raises(RuntimeError, match="radius"):
            bpy.ops.repousse.replay_kept_stroke(text=text.name)
        assert block.data.filepath == former
        assert sessions.open_session(block).grid.density.tobytes() == density
    finally:
        sessions.close_session()


class Windows:
    """Writes down what is told of the progress."""

    def __init__(self):
        self.told = []

    def progress_begin(self, low, high):
        self.told.append(("begin", low, high))

    def progress_update(self, value):
        self.told.append(value)

    def progress_end(self):
        self.told.append("end")


def test_progress_is_told_pose_by_pose_and_ends_also_on_failure(block):
    stroke, windows = push_down(), Windows()
    walk(stroke, grid_of(block), windows)
    count = len(stroke.samples)
    assert windows.told == [("begin", 0, count), *range(count), "end"]
    stroke.samples[2] = replace(stroke.samples[2], radius=0.1)
    windows = Windows()
    with pytest.raises(ValueError, match="radius"):
        walk(stroke, grid_of(block), windows)
    assert windows.told == [("begin", 0, count), 0, 1, "end"]


def test_replay_while_the_volume_is_held_live_changes_what_is_held_and_seen(block):
    session = sessions.open_session(block)
    try:
        assert session.take_changes() == (True, []) and session.take_changes() == (False, [])
        text = strokes.keep(push_down(), block.data)
        former = block.data.filepath
        bpy.ops.repousse.replay_kept_stroke(text=text.name)
        assert sessions.live() is session and block.data.filepath != former
        assert session.take_changes() == (True, [])
        assert session.grid.density.tobytes() == grid_of(block).density.tobytes()
    finally:
        sessions.close_session()


def test_replay_holds_nothing_that_was_not_held_and_keeps_the_other_grids(block, tmp_path):
    bpy.utils.expose_bundled_modules()
    import openvdb

    heat = openvdb.FloatGrid()
    heat.name = "heat"
    heat.fill((0, 0, 0), (3, 4, 5), 300.0)
    grids, _ = openvdb.readAll(bpy.path.abspath(block.data.filepath))
    openvdb.write(str(tmp_path / "two.vdb"), grids=[*grids, heat])
    block.data.filepath = str(tmp_path / "two.vdb")
    text = strokes.keep(push_down(), block.data)
    assert bpy.ops.repousse.replay_kept_stroke(text=text.name) == {"FINISHED"}
    assert sessions.live() is None
    assert block.data.filepath != str(tmp_path / "two.vdb")
    kept = openvdb.read(bpy.path.abspath(block.data.filepath), "heat")
    assert kept.activeVoxelCount() == 4 * 5 * 6 and kept.evalMinMax() == (300.0, 300.0)
