# SPDX-License-Identifier: GPL-3.0-or-later
"""What comes in the middle of a stroke: no thread outlives it, no voxel is left half pushed, and work can go on."""

import addon_utils
import bpy

from ..clay import assert_same, file_of, in_file, new_block
from ..scenario import Steps, scenario
from ..sculpting import (
    assert_at_rest,
    half_a_stroke,
    live_grid,
    over,
    ready,
    running,
    sessions,
    stroke,
    stroke_threads,
    take_tool,
    threads,
)
from ..window import Window

ADDON = "bl_ext.user_default.repousse"
LINE = ((-0.5, 0.0, 1.0), (0.5, 0.0, 1.0))


def interrupted(window: Window) -> Steps:
    """A new block in the middle of a stroke."""
    new_block(window)
    yield from ready(window)
    yield from half_a_stroke(window, *LINE)
    assert stroke_threads()


@scenario()
def another_tool_is_taken(window: Window) -> Steps:
    yield from interrupted(window)
    volume = bpy.context.object
    start = in_file(volume)
    yield from take_tool(window, "builtin.select_box")
    yield from window.release()
    yield from window.until(lambda: not running(), "the stroke to end")
    yield from window.drawn()
    yield from window.until(lambda: sessions.live() is None, "the volume to be let go")
    assert_at_rest(volume)
    assert volume.display_type == "TEXTURED", volume.display_type
    former, found = start, in_file(volume)
    assert found.mass > 0.99 * former.mass
    yield from take_tool(window)
    assert_same(live_grid(), in_file(volume))


@scenario()
def another_file_is_loaded(window: Window) -> Steps:
    yield from interrupted(window)
    bpy.ops.wm.read_homefile(app_template="")
    assert not running() and not threads()
    yield from window.release()
    yield from window.drawn()
    assert sessions.live() is None
    assert not bpy.data.volumes


@scenario()
def its_own_file_is_loaded_again(window: Window) -> Steps:
    new_block(window)
    yield from ready(window)
    blend = window.folder / "reloaded.blend"
    with window.context():
        bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    start = in_file(bpy.context.object)
    yield from half_a_stroke(window, *LINE)
    with window.context():
        bpy.ops.wm.revert_mainfile()
    assert not running() and not threads()
    yield from window.release()
    yield from window.drawn()
    assert_same(in_file(bpy.context.view_layer.objects.active), start)
    yield from take_tool(window)
    assert_same(live_grid(), start)
    yield from stroke(window, *LINE)
    assert_at_rest(bpy.context.object)


@scenario()
def undo_is_called(window: Window) -> Steps:
    """By a menu or another add-on: the keys do not reach it while a stroke runs."""
    new_block(window)
    yield from ready(window)
    start, former = in_file(bpy.context.object), file_of(bpy.context.object)
    yield from stroke(window, (-0.5, 0.4, 1.0), (0.5, 0.4, 1.0))
    yield from half_a_stroke(window, *LINE)
    with window.context():
        bpy.ops.ed.undo()
    assert not running() and not stroke_threads()
    yield from window.release()
    yield from window.drawn()
    assert file_of(bpy.context.object) == former
    assert_same(in_file(bpy.context.object), start)
    assert_same(live_grid(), start)
    yield from stroke(window, *LINE)
    assert_at_rest(bpy.context.object)


@scenario()
def undo_keys_are_pressed(window: Window) -> Steps:
    yield from interrupted(window)
    former = file_of(bpy.context.object)
    yield from window.tap("Z", "LEFT_CTRL")
    yield from window.drawn()
    assert running(), "the keys have ended the stroke"
    yield from window.release()
    yield from over(window)
    assert file_of(bpy.context.object) != former
    assert_at_rest(bpy.context.object)


@scenario()
def the_volume_is_deleted(window: Window) -> Steps:
    yield from interrupted(window)
    bpy.data.objects.remove(bpy.context.object)
    yield from window.drag_to(window.pixel((0.0, 0.3, 1.0)))
    yield from window.release()
    yield from over(window)
    yield from window.drawn()
    assert not stroke_threads()
    yield from window.until(lambda: sessions.live() is None, "the volume to be let go")


@scenario()
def the_add_on_is_disabled(window: Window) -> Steps:
    yield from interrupted(window)
    start, name = in_file(bpy.context.object), bpy.context.object.name
    addon_utils.disable(ADDON)
    assert not threads()
    yield from window.release()
    yield from window.drawn()
    assert not hasattr(bpy.types.Scene, "repousse")
    assert_same(in_file(bpy.data.objects[name]), start)
    assert bpy.data.objects[name].display_type == "TEXTURED"
    assert addon_utils.enable(ADDON) is not None
    yield from window.drawn()
    yield from ready(window)
    assert_same(live_grid(), start)
    yield from stroke(window, *LINE)
    assert_at_rest(bpy.context.object)


@scenario(alone=True)
def blender_is_quit(window: Window) -> Steps:
    yield from interrupted(window)
    bpy.ops.wm.quit_blender()
    yield 60.0
