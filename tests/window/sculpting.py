# SPDX-License-Identifier: GPL-3.0-or-later
"""Strokes by the hand of a scenario, and what the add-on knows of them."""

from __future__ import annotations

import threading
from collections.abc import Iterable

import bpy
import numpy as np
from bl_ext.user_default.repousse.core import DensityGrid, Stroke
from bl_ext.user_default.repousse.operators import session as sessions
from bl_ext.user_default.repousse.operators import strokes

from .clay import file_of
from .scenario import Steps
from .window import FROM_ABOVE, Window

TOOL = "repousse.push"


def take_tool(window: Window, tool: str = TOOL) -> Steps:
    """Choose a tool; with the push tool, wait until the active volume is ready to be sculpted."""
    with window.context():
        assert bpy.ops.wm.tool_set_by_id(name=tool) == {"FINISHED"}
    if tool == TOOL:
        yield from window.until(lambda: sessions.live() is not None, "the volume to be made ready")
    yield from window.drawn()


def ready(window: Window, rotation=FROM_ABOVE, target=(0.0, 0.0, 0.0), distance=4.0, **settings) -> Steps:
    """Look at the active volume, with the tool in hand, these settings of the brush, and strokes recorded."""
    for name, value in ({"record": True, "radius": 40, "strength": 0.5} | settings).items():
        setattr(bpy.context.scene.repousse, name, value)
    with window.context():
        bpy.ops.ed.undo_push(message="Settings")  # or undo takes them back along with the first stroke
    with window.context():
        bpy.ops.wm.tool_set_by_id(name=TOOL)
    yield from window.until(lambda: sessions.live() is not None, "the volume to be made ready")
    yield from window.look(rotation, target, distance)


def begin(window: Window, point: Iterable[float], *modifiers: str) -> Steps:
    """Press the button over a point of the world, and wait until a stroke runs."""
    yield from window.move(window.pixel(point))
    for modifier in modifiers:
        yield from window.press(modifier)
    yield from window.press()
    yield from window.until(running, "the stroke to begin")


def end(window: Window, *modifiers: str) -> Steps:
    """Let the button go, and wait until the stroke is over."""
    yield from window.release()
    for modifier in modifiers:
        yield from window.release(modifier)
    yield from over(window)


def over(window: Window) -> Steps:
    """Wait until no stroke runs."""
    yield from window.until(lambda: not running(), "the stroke to end", 20.0)


def stroke(window: Window, start: Iterable[float], finish: Iterable[float], *modifiers: str, moves=24) -> Steps:
    """A whole stroke between two points of the world, straight on the screen, with keys held."""
    yield from begin(window, start, *modifiers)
    yield from window.drag_to(window.pixel(finish), moves)
    yield from end(window, *modifiers)


def half_a_stroke(window: Window, start: Iterable[float], finish: Iterable[float]) -> Steps:
    """Begin a stroke, and go on until voxels have changed; the button stays pressed."""
    former = copy_of(live_grid())
    yield from begin(window, start)
    yield from window.drag_to(window.pixel(finish))
    yield from window.until(lambda: not equal(live_grid(), former), "voxels to change")


def equal(one: DensityGrid, other: DensityGrid) -> bool:
    """Whether two grids have the same voxels, to the last bit."""
    return np.array_equal(one.density, other.density)


def running() -> bool:
    """Whether a stroke is under way."""
    session = sessions.live()
    return session is not None and session.engine is not None


def live_grid() -> DensityGrid:
    """The voxels that are sculpted."""
    session = sessions.live()
    assert session is not None, "no volume is being sculpted"
    return session.grid


def copy_of(grid: DensityGrid) -> DensityGrid:
    """A grid of the same voxels, to compare with later."""
    return DensityGrid(grid.density, grid.transform)


def threads() -> set[str]:
    """The names of the add-on's threads."""
    return {thread.name for thread in threading.enumerate() if thread.name.startswith("repousse")}


def stroke_threads() -> set[str]:
    """The names of those that only a stroke may have; the hash of a new revision is made after it."""
    return threads() - {"repousse hash"}


def recorded(volume: bpy.types.Object) -> Stroke:
    """The last stroke kept with a volume."""
    return strokes.stroke_in(strokes.kept(volume.data)[-1])


def replayed(stroke: Stroke, start: DensityGrid) -> DensityGrid:
    """What the core makes of a stroke on a copy of the grid on which it began."""
    push = stroke.push(copy_of(start))
    push.follow(stroke)
    return push.grid


def assert_at_rest(volume: bpy.types.Object) -> None:
    """No stroke, none of its threads; the live grid, where there is one, is that of the volume's file."""
    assert not running(), "a stroke is running"
    assert not stroke_threads(), f"there are threads left: {stroke_threads()}"
    session = sessions.live()
    if session is not None:
        assert session.path == file_of(volume), f"the session is of {session.path}, the volume of {file_of(volume)}"
