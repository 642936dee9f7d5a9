# SPDX-License-Identifier: GPL-3.0-or-later
"""After a crash: an autosave, opened by the next Blender, shows the sculpture. The second scenario needs the first."""

import os
import signal
import time
from pathlib import Path

import bpy
import numpy as np

from ..clay import assert_same, file_of, in_file, new_block
from ..scenario import Steps, scenario
from ..sculpting import assert_at_rest, copy_of, live_grid, ready, stroke
from ..window import Window

KILLED = 128 + signal.SIGKILL


def autosaves() -> list[Path]:
    """The autosaves of this and former Blenders of the session."""
    return sorted(Path(os.environ["TMPDIR"]).glob("*autosave.blend"))


@scenario(limit=150.0, alone=True, leaves=KILLED)
def autosave_then_a_crash(window: Window) -> Steps:
    new_block(window)
    bpy.context.preferences.filepaths.use_auto_save_temporary_files = True
    bpy.context.preferences.filepaths.auto_save_time = 1  # minutes, the least there is
    yield from ready(window)
    yield from stroke(window, (-0.5, 0.0, 1.0), (0.5, 0.0, 1.0))
    np.save(window.folder / "autosaved.npy", live_grid().density)
    done = time.time()
    yield from window.until(lambda: any(path.stat().st_mtime > done for path in autosaves()), "an autosave", 120.0)
    yield from stroke(window, (-0.5, 0.4, 1.0), (0.5, 0.4, 1.0))  # the autosave knows nothing of it
    os.kill(os.getpid(), signal.SIGKILL)
    yield 60.0


@scenario(alone=True)
def autosave_shows_the_sculpture(window: Window) -> Steps:
    (autosave,) = autosaves()
    wanted = np.load(window.folder / "autosaved.npy")
    with window.context():
        bpy.ops.wm.open_mainfile(filepath=str(autosave))
    yield from window.drawn()
    volume = bpy.context.view_layer.objects.active
    assert file_of(volume).is_file(), f"{file_of(volume)} is gone"
    found = in_file(volume)
    assert np.array_equal(found.density, wanted)
    yield from ready(window)
    assert_same(live_grid(), found)
    before = copy_of(live_grid())
    yield from stroke(window, (-0.5, -0.4, 1.0), (0.5, -0.4, 1.0))
    assert_at_rest(volume)
    assert not np.array_equal(live_grid().density, before.density)
