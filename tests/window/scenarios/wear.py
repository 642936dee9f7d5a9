# SPDX-License-Identifier: GPL-3.0-or-later
"""What many strokes leave behind: no time, no threads, no file handles, bounded files and memory."""

import gc
import threading
import time
from pathlib import Path

import bpy
import numpy as np
from bl_ext.user_default.repousse.core.engine import Engine

from ..clay import file_of, new_block
from ..scenario import Steps, scenario
from ..sculpting import assert_at_rest, begin, end, ready
from ..window import Window

STROKES = 100
SAMPLE = 20
"""Strokes at either end of which the median is taken."""
MEMORY_CACHE = 64
"""MiB that Blender may keep of volumes it has read; its default is 4096."""


def handles() -> int:
    """How many files this process has open; 0 where the system does not tell."""
    folder = Path("/proc/self/fd")
    return len(list(folder.iterdir())) if folder.is_dir() else 0


def resident() -> float:
    """MiB of memory that this process has; 0 where the system does not tell."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.is_file() else []
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS")), 0.0)


@scenario(limit=300.0)
def a_hundred_strokes(window: Window) -> Steps:
    bpy.context.preferences.system.memory_cache_limit = MEMORY_CACHE
    volume = new_block(window)
    # What is drawn is not what is measured: a third of the view, without overlays, in large pixels.
    window.area.spaces.active.overlay.show_overlays = False
    bpy.context.scene.render.preview_pixel_size = "4"
    with window.context():
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.34)
    yield from window.drawn()
    window.area.ui_type = "TEXT_EDITOR"
    yield from ready(window, record=False, radius=25)
    begun, ended, memory = [], [], []
    for number in range(STROKES):
        y = 0.7 * np.sin(number)
        started = time.perf_counter()
        yield from begin(window, (-0.2, y, 1.0))
        begun.append(time.perf_counter() - started)
        yield from window.drag_to(window.pixel((0.2, y, 1.0)), 4)
        started = time.perf_counter()
        yield from end(window)
        ended.append(time.perf_counter() - started)
        memory.append(resident())
        if number == SAMPLE:
            threads_then, handles_then = threading.active_count(), handles()
    gc.collect()
    assert_at_rest(volume)
    kept = sum(isinstance(thing, Engine) for thing in gc.get_objects())
    assert kept <= 1, f"{kept} engines of former strokes are still there"
    for what, times in (("begin", begun), ("end", ended)):
        first, last = np.median(times[:SAMPLE]), np.median(times[-SAMPLE:])
        window.figures(**{f"first strokes {what} ms": 1e3 * first, f"last strokes {what} ms": 1e3 * last})
        assert last <= 1.5 * first + 0.05, f"strokes {what} in {1e3 * first:.0f} ms, in the end in {1e3 * last:.0f} ms"
    window.figures(**{"MiB after 20 strokes": memory[SAMPLE], "MiB in the end": memory[-1]})
    assert threading.active_count() <= threads_then
    assert handles() <= handles_then
    assert memory[-1] - memory[SAMPLE] <= 150.0, f"{memory[SAMPLE]:.0f} MiB after {SAMPLE}, then {memory[-1]:.0f} MiB"
    revisions = len(list(file_of(volume).parent.glob("*.vdb")))
    assert revisions <= bpy.context.preferences.edit.undo_steps + 4, f"{revisions} files"
