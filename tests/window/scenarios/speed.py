# SPDX-License-Identifier: GPL-3.0-or-later
"""How fast a stroke is in a Blender with a window: figures for make bench, which claim nothing."""

import time
from collections.abc import Callable
from contextlib import contextmanager

import bpy
import numpy as np
from bl_ext.user_default.repousse.core.engine import Engine
from bl_ext.user_default.repousse.operators.sculpt import REPOUSSE_OT_sculpt
from bl_ext.user_default.repousse.operators.session import Session
from bl_ext.user_default.repousse.ui.texture import DensityTexture

from ..clay import file_of, new_slab
from ..scenario import Steps, scenario
from ..sculpting import begin, over, ready, running, sessions
from ..window import Window

TRIALS = 24
"""Events whose way to the texture is timed."""
TOOL = 16
"""Radius in voxels, as that of the other figures: seen from here a pixel is a voxel of 256."""
FRAMES = 30
STROKES = 6


@contextmanager
def ends_of(owner: type, name: str):
    """The moments (perf_counter, s) at which calls of a method end, and how long each took, in a list that grows."""
    method: Callable = getattr(owner, name)
    ends: list[tuple[float, float]] = []

    def timed(*arguments, **options):
        began = time.perf_counter()
        try:
            return method(*arguments, **options)
        finally:
            now = time.perf_counter()
            ends.append((now, now - began))

    setattr(owner, name, timed)
    try:
        yield ends
    finally:
        setattr(owner, name, method)


def circle(number: int) -> tuple[float, float, float]:
    """Places on the slab, one after the other, near enough for a drag."""
    return 0.4 * np.cos(number / 8.0), 0.4 * np.sin(number / 8.0), 0.0


def frames(window: Window) -> Steps:
    """Milliseconds from one frame to the next, with an event to each: the median, as the generator's result."""
    drawn: list[float] = []
    handler = bpy.types.SpaceView3D.draw_handler_add(
        lambda: drawn.append(time.perf_counter()), (), "WINDOW", "POST_PIXEL"
    )
    for number in range(FRAMES):
        before = len(drawn)
        yield from window.move(window.pixel(circle(number)))
        window.area.tag_redraw()
        yield from window.until(lambda count=before: len(drawn) > count, "a frame")
    bpy.types.SpaceView3D.draw_handler_remove(handler, "WINDOW")
    return 1e3 * float(np.median(np.diff(drawn)))


def speed(window: Window, size: int) -> Steps:
    volume = new_slab(window, size)
    yield from ready(window, record=False, radius=TOOL * 256 // size)
    window.figures(**{"frame, no stroke": (yield from frames(window))})

    starts, ends = [], []
    with (
        ends_of(Session, "commit") as commits,
        ends_of(Engine, "start") as engines,
        ends_of(REPOUSSE_OT_sculpt, "_begin") as begins,
    ):
        for number in range(STROKES):
            yield from window.move(window.pixel((-0.4, 0.1 * number - 0.3, 0.0)))
            yield from window.idle()
            pressed = time.perf_counter()
            yield from window.press()
            yield from window.until(running, "a stroke")
            starts.append(engines[-1][0] - pressed)
            yield from window.drag_to(window.pixel((0.0, 0.1 * number - 0.3, 0.0)))
            former, released = file_of(volume), time.perf_counter()
            yield from window.release()
            yield from window.until(lambda shown=former: file_of(volume) != shown, "the stroke's end", 30.0)
            ends.append(commits[-1][0] - released)
    window.figures(
        **{
            "press to stroke": 1e3 * np.median(starts),
            "stroke start": 1e3 * np.median([taken for _, taken in begins]),
            "commit": 1e3 * np.median([taken for _, taken in commits]),
            "stroke end": 1e3 * np.median(ends),
        }
    )

    yield from begin(window, circle(0))
    lags = []
    with ends_of(DensityTexture, "patch") as patches:
        for number in range(TRIALS):
            done = len(patches)
            sent = time.perf_counter()
            yield from window.move(window.pixel(circle(number + 1)))
            yield from window.until(lambda count=done: len(patches) > count, "the texture to change")
            lags.append(patches[done][0] - sent)
    window.figures(
        **{
            "event to texture": 1e3 * np.median(lags),
            "patch": 1e3 * np.median([taken for _, taken in patches]),
            "frame, in a stroke": (yield from frames(window)),
        }
    )
    health = sessions.live().engine.health
    window.figures(
        **{"collisions": health.rate, "discarded": health.discarded, "longest solve": 1e3 * health.longest_solve}
    )
    yield from window.release()
    yield from over(window)


@scenario(limit=180.0, kind="figures")
def speed_128(window: Window) -> Steps:
    yield from speed(window, 128)


@scenario(limit=240.0, kind="figures")
def speed_256(window: Window) -> Steps:
    yield from speed(window, 256)
