# SPDX-License-Identifier: GPL-3.0-or-later
"""What fails in a stroke: it is taken back, said in one line, and work goes on."""

import bpy
from bl_ext.user_default.repousse.core import guide
from bl_ext.user_default.repousse.core.formats import FormatError, revision
from bl_ext.user_default.repousse.operators import strokes

from ..clay import assert_same, file_of, in_file, new_block
from ..scenario import Steps, scenario
from ..sculpting import assert_at_rest, half_a_stroke, live_grid, over, ready, recorded, replayed, stroke, threads
from ..window import Window

LINE = ((-0.5, 0.0, 1.0), (0.5, 0.0, 1.0))


def failing(error: Exception):
    """A function that does nothing but fail."""

    def fail(*_, **__):
        raise error

    return fail


def taken_back(window: Window, start, former, words: str) -> Steps:
    """The stroke is over, every voxel and the file are as before, and the user has been told."""
    yield from over(window)
    yield from window.drawn()
    assert not threads()
    assert_same(live_grid(), start)
    assert file_of(bpy.context.object) == former
    told = window.reports()
    assert any(words in line for line in told), told
    yield from window.picture()
    yield from window.tap("ESC")  # the popup that says so takes the next click otherwise


@scenario()
def a_failure_in_the_stroke_takes_it_back(window: Window) -> Steps:
    volume = new_block(window)
    yield from ready(window)
    start, former = in_file(volume), file_of(volume)
    yield from half_a_stroke(window, *LINE)
    sound = guide.Guide.move
    guide.Guide.move = failing(ValueError("no way to go on"))
    try:
        yield from window.drag_to(window.pixel((0.4, 0.2, 1.0)))
        yield from taken_back(window, start, former, "no way to go on")
    finally:
        guide.Guide.move = sound
    yield from window.release()
    yield from stroke(window, *LINE)
    assert_at_rest(volume)


@scenario()
def a_disk_that_is_full_takes_the_stroke_back(window: Window) -> Steps:
    volume = new_block(window)
    yield from ready(window)
    start, former = in_file(volume), file_of(volume)
    sound = revision.VolumeFile.write
    revision.VolumeFile.write = failing(FormatError("clay.vdb: cannot be written: No space left on device"))
    try:
        yield from half_a_stroke(window, *LINE)
        yield from window.release()
        yield from taken_back(window, start, former, "No space left on device")
    finally:
        revision.VolumeFile.write = sound
    yield from stroke(window, *LINE)
    assert_same(in_file(volume), replayed(recorded(volume), start))


@scenario()
def a_stroke_that_cannot_be_recorded_is_kept(window: Window) -> Steps:
    volume = new_block(window)
    yield from ready(window)
    former = file_of(volume)
    sound = strokes.keep
    strokes.keep = failing(RuntimeError("no room for a text"))
    try:
        yield from stroke(window, *LINE)
    finally:
        strokes.keep = sound
    assert file_of(volume) != former
    assert_same(live_grid(), in_file(volume))
    assert any("was not recorded" in line for line in window.reports())
