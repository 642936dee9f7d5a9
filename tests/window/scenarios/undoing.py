# SPDX-License-Identifier: GPL-3.0-or-later
"""Taking strokes back, by cancelling, undo and redo; and finding them again in a saved file."""

import bpy

from ..clay import assert_same, file_of, in_file, new_block
from ..scenario import Steps, scenario
from ..sculpting import (
    assert_at_rest,
    copy_of,
    half_a_stroke,
    live_grid,
    over,
    ready,
    recorded,
    replayed,
    running,
    stroke,
)
from ..window import Window

LINES = [((-0.5, y, 1.0), (0.5, y, 1.0)) for y in (-0.4, 0.0, 0.4)]
"""Three strokes across the top of a block, in world coordinates."""


def taken_back_by(window: Window, key: str) -> Steps:
    volume = new_block(window)
    yield from ready(window)
    start, former = in_file(volume), file_of(volume)
    yield from half_a_stroke(window, *LINES[1])
    yield from window.tap(key)
    yield from over(window)
    yield from window.release()
    yield from window.drawn()
    assert not running(), "letting the button go has begun another stroke"
    assert_same(live_grid(), start)
    assert file_of(volume) == former
    assert_at_rest(volume)
    yield from stroke(window, *LINES[0])
    assert file_of(volume) != former, "no stroke can follow"


@scenario()
def esc_takes_the_stroke_back(window: Window) -> Steps:
    yield from taken_back_by(window, "ESC")


@scenario()
def the_right_button_takes_the_stroke_back(window: Window) -> Steps:
    yield from taken_back_by(window, "RIGHTMOUSE")


def one_step(window: Window, state, *modifiers: str) -> Steps:
    """Ctrl Z, with more keys held, leads to a state: (file, voxels)."""
    file, voxels = state
    yield from window.tap("Z", "LEFT_CTRL", *modifiers)
    yield from window.until(lambda: file_of(bpy.context.object) == file, f"the volume to show {file.name} again")
    yield from window.drawn()
    assert_same(in_file(bpy.context.object), voxels)
    assert_same(live_grid(), voxels)
    assert_at_rest(bpy.context.object)


@scenario(limit=120.0)
def three_strokes_are_undone_and_redone(window: Window) -> Steps:
    volume = new_block(window)
    yield from ready(window)
    states = [(file_of(volume), in_file(volume))]
    for line in LINES:
        yield from stroke(window, *line)
        states.append((file_of(volume), copy_of(live_grid())))
    assert len({file for file, _ in states}) == 4
    yield from window.picture("-before")
    for state in reversed(states[:-1]):
        yield from one_step(window, state)
    yield from window.picture("-undone")
    for state in states[1:]:
        yield from one_step(window, state, "LEFT_SHIFT")
    yield from window.picture("-redone")


@scenario()
def a_stroke_after_an_undo_begins_on_what_is_seen(window: Window) -> Steps:
    volume = new_block(window)
    yield from ready(window)
    start = file_of(volume), in_file(volume)
    yield from stroke(window, *LINES[0])
    yield from one_step(window, start)
    yield from stroke(window, *LINES[2])
    wanted = replayed(recorded(bpy.context.object), start[1])
    assert_same(live_grid(), wanted)
    assert_same(in_file(bpy.context.object), wanted)


@scenario()
def a_saved_file_is_opened_with_its_sculpture(window: Window) -> Steps:
    volume = new_block(window)
    yield from ready(window)
    yield from stroke(window, *LINES[1])
    wanted, blend = copy_of(live_grid()), window.folder / "saved" / "clay.blend"
    blend.parent.mkdir()
    with window.context():
        bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    assert_at_rest(volume)
    yield from stroke(window, *LINES[0])  # not saved
    with window.context():
        bpy.ops.wm.open_mainfile(filepath=str(blend))
    yield from window.drawn()
    opened = bpy.context.view_layer.objects.active
    assert opened.data.filepath.startswith("//"), opened.data.filepath
    assert blend.parent in file_of(opened).parents
    assert_same(in_file(opened), wanted)
    yield from ready(window)
    assert_same(live_grid(), wanted)
    yield from stroke(window, *LINES[2])
    assert_at_rest(bpy.context.view_layer.objects.active)
