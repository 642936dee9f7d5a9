# SPDX-License-Identifier: GPL-3.0-or-later
"""Strokes of the arm: the same as those of the mouse, felt before and after, and ended by whatever ends the arm."""

import os
import signal

import addon_utils
import bpy
import numpy as np
from bl_ext.user_default.repousse.core.stroke import hash_of
from bl_ext.user_default.repousse.device.fault import State
from bl_ext.user_default.repousse.operators import arm_session

from .. import arm
from ..clay import assert_same, file_of, heights, in_file, new_slab
from ..scenario import Steps, scenario
from ..sculpting import (
    assert_at_rest,
    end,
    half_a_stroke,
    live_grid,
    over,
    ready,
    recorded,
    replayed,
    running,
    stroke,
    threads,
)
from ..window import Window
from .interrupted import ADDON

ABOVE, IN, ALONG = (-0.4, 0.0, 0.3), (-0.4, 0.0, 0.0), (0.4, 0.0, 0.0)
"""World: the slab's top is at z = 0, so the tool goes in by half."""
GROOVE = [
    (0.5, ABOVE, False),
    (4.0, ABOVE, True),
    (5.5, IN, True),
    (15.0, ALONG, True),  # slowly: the first stroke in a Blender compiles shaders for seconds
    (16.0, (0.4, 0.0, 0.3), False),
    (30.0, ABOVE, False),
]
PRESS = [(0.5, ABOVE, False), (4.0, ABOVE, True), (5.5, IN, True), (25.0, ALONG, True), (26.0, ABOVE, False)]
"""The same, but the stylus is not released for long."""


def pressing(window: Window) -> Steps:
    """A slab into which the hand of an arm pushes."""
    volume = new_slab(window)
    yield from ready(window)
    yield from arm.connect(window, arm.hand(window.folder, PRESS, loop=True))
    yield from arm.half_a_stroke(window)
    return volume


def kept(volume, start, former) -> None:
    """The stroke is in the file, in memory and in its record, as one revision."""
    assert file_of(volume) != former
    told = recorded(volume)
    assert told.grid_hash == hash_of(start), f"it is stroke {len(volume.data.repousse_strokes.kept)}"
    wanted = replayed(told, start)
    assert not np.array_equal(wanted.density, start.density), "nothing has changed"
    assert_same(in_file(volume), wanted)
    assert_same(live_grid(), wanted)
    assert_only_felt()


def assert_only_felt() -> None:
    assert not running()
    assert threads() <= {"repousse arm", "repousse collision", "repousse hash"}, threads()


def felt() -> bool:
    """Whether there is clay that is felt between strokes."""
    session = arm.sessions.live()
    return session is not None and session.feeling is not None and session.feeling.model is not None


def undone(window: Window, start, former) -> Steps:
    """One step of undo is the whole stroke."""
    yield from window.tap("Z", "LEFT_CTRL")
    yield from window.until(lambda: file_of(bpy.context.object) == former, "the stroke to be undone")
    yield from window.drawn()
    assert_same(live_grid(), start)


@scenario(limit=120.0)
def an_arm_ploughs_a_groove(window: Window) -> Steps:
    volume = new_slab(window)
    yield from ready(window)
    start, former = in_file(volume), file_of(volume)
    yield from arm.connect(window, arm.hand(window.folder, GROOVE, loop=True))
    yield from arm.half_a_stroke(window)
    engine, scene = arm.sessions.live().engine, arm.arm().scene
    stresses, forces = [], []
    x, y, z = arm.cursor()
    assert abs(x) < 0.5 and abs(y) < 0.1 and -0.1 < z < 0.35, f"the cursor is at {(x, y, z)}"
    yield from window.picture()
    while running():
        stresses.append(engine.contact.stress)
        forces.append(arm.arm().state.force[2])
        yield 0.01
    yield from window.drawn()
    kept(volume, start, former)
    depth = -heights(live_grid(), 0.0, 0.0) / start.voxel_size
    # What of it reaches the hand depends on the machine: without a graphics card a drawing is longer than a model may
    # be old, and then no force is let in.
    window.figures(stress=max(stresses), force=max(forces), voxels=depth, samples=len(recorded(volume).samples))
    assert max(stresses) > 0.1, f"the clay has resisted with {max(stresses):g} N"
    assert depth > 1.0, f"the groove is {depth:g} voxels deep"
    assert arm.arm().scene == scene, "its own stroke has made another scene"
    yield from undone(window, start, former)
    yield from window.until(lambda: felt() and arm.arm().scene == scene + 1, "another scene to be felt")
    process = arm.arm().loop.process_id
    with window.context():
        bpy.ops.repousse.arm_disconnect()
    yield from arm.gone(window, process)
    assert_at_rest(bpy.context.object)


@scenario(limit=120.0)
def a_loop_that_is_killed_ends_the_stroke_as_if_released(window: Window) -> Steps:
    volume = yield from pressing(window)
    former = file_of(volume)
    start = in_file(volume)
    process = arm.arm().loop.process_id
    os.kill(process, signal.SIGKILL)
    yield from over(window)
    yield from window.drawn()
    kept(volume, start, former)
    told = window.reports()
    assert any("ended from outside" in line for line in told), told
    yield from arm.gone(window, process)
    assert arm_session.arm() is None and "ended from outside" in arm_session.farewell()
    assert_at_rest(volume)
    yield from undone(window, start, former)
    yield from stroke(window, (-0.4, 0.2, 0.0), (0.4, 0.2, 0.0))  # by mouse
    assert_at_rest(bpy.context.object)


@scenario(limit=120.0)
def disconnecting_ends_the_stroke_as_if_released(window: Window) -> Steps:
    volume = yield from pressing(window)
    former, start = file_of(volume), in_file(volume)
    process = arm.arm().loop.process_id
    with window.context():
        assert bpy.ops.repousse.arm_disconnect() == {"FINISHED"}
    yield from over(window)
    yield from window.drawn()
    kept(volume, start, former)
    yield from arm.gone(window, process)
    assert_at_rest(volume)


@scenario(limit=120.0)
def esc_takes_the_stroke_of_an_arm_back(window: Window) -> Steps:
    volume = yield from pressing(window)
    former, start, scene = file_of(volume), in_file(volume), arm.arm().scene
    yield from window.move(window.pixel((0.0, 0.0, 0.0)))
    yield from window.tap("ESC")
    yield from over(window)
    yield from window.drawn()
    assert_same(live_grid(), start)
    assert file_of(volume) == former
    yield from window.until(lambda: arm.arm().scene == scene + 1, "another scene")
    assert arm.arm().state.state in (State.ARMED, State.RUN)
    assert not running(), "the stylus that is still pressed has begun another stroke"


@scenario(limit=120.0)
def the_mouse_does_not_move_the_tool_of_an_arm(window: Window) -> Steps:
    yield from pressing(window)
    yield from window.move(window.pixel((0.5, 0.5, 0.0)))
    yield from window.drag_to(window.pixel((0.5, -0.5, 0.0)))
    yield from window.press()
    yield from window.release()
    yield from window.drawn()
    assert running(), "the mouse has ended it"
    assert abs(arm.cursor()[1]) < 0.2
    path = np.array([sample.position for sample in arm.sessions.live().engine.solved])
    across = (path[:, 1] - path[0, 1]) * live_grid().voxel_size
    assert np.abs(across).max() < 0.2, "a pose of the mouse was solved"


@scenario(limit=120.0)
def the_mouse_sculpts_beside_an_arm(window: Window) -> Steps:
    volume = new_slab(window)
    yield from ready(window)
    yield from arm.connect(window, arm.hand(window.folder, [(0.5, (0.0, 0.5, 0.3), False)]))
    yield from window.until(felt, "the clay to be felt")
    start, former, scene = in_file(volume), file_of(volume), arm.arm().scene
    yield from half_a_stroke(window, (-0.4, 0.0, 0.0), (0.4, 0.0, 0.0))
    assert not felt(), "two engines are at the same voxels"
    yield from end(window)
    yield from window.drawn()
    kept(volume, start, former)
    yield from window.until(felt, "the clay to be felt again")
    assert arm.arm().scene == scene + 1


@scenario(limit=120.0)
def a_file_that_is_loaded_ends_the_arm(window: Window) -> Steps:
    yield from pressing(window)
    process = arm.arm().loop.process_id
    bpy.ops.wm.read_homefile(app_template="")
    assert not running() and not threads() and arm_session.arm() is None
    yield from arm.gone(window, process)


@scenario(limit=120.0)
def the_add_on_is_disabled_in_a_stroke_of_the_arm(window: Window) -> Steps:
    yield from pressing(window)
    process, start = arm.arm().loop.process_id, in_file(bpy.context.object)
    name = bpy.context.object.name
    addon_utils.disable(ADDON)
    assert not threads()
    yield from arm.gone(window, process)
    yield from window.drawn()
    assert_same(in_file(bpy.data.objects[name]), start)
    assert addon_utils.enable(ADDON) is not None
    yield from window.drawn()


@scenario(limit=120.0, alone=True)
def blender_is_quit_in_a_stroke_of_the_arm(window: Window) -> Steps:
    yield from pressing(window)
    bpy.ops.wm.quit_blender()
    yield 60.0
