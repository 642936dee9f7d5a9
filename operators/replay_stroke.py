# SPDX-License-Identifier: GPL-3.0-or-later
"""Replay Stroke: walk a recorded stroke through the active volume."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import bpy
from bpy_extras.io_utils import ImportHelper

from ..core import DensityGrid, Stroke
from .session import close_session, live, open_session
from .volumes import OnActiveVolume, active_volume

ELSEWHERE = "This stroke was recorded on another volume, or another state of it: the result is not the recorded one"


def walk(stroke: Stroke, grid: DensityGrid, windows: bpy.types.WindowManager) -> float:
    """Walk every pose of a stroke, of any verb and symmetry, through ``grid``, which is changed; show how far it is.

    Returns the mass that left the grid, in voxels' worth.
    """
    push, mass_out = stroke.push(grid), 0.0
    windows.progress_begin(0, len(stroke.samples))
    try:
        for done, sample in enumerate(stroke.samples):
            mass_out += push.walk(sample, stroke.continuous).mass_out
            windows.progress_update(done)
    finally:
        windows.progress_end()
    return mass_out


def replay(operator: bpy.types.Operator, context: bpy.types.Context, read: Callable[[], Stroke]) -> set[str]:
    """A whole execution: the stroke that ``read`` returns through the active volume, as its next revision."""
    held = live()
    try:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            stroke = read()
            elsewhere = _replay(stroke, active_volume(context), context.window_manager)
    except (ValueError, OSError, MemoryError) as error:
        operator.report({"ERROR"}, str(error) or "There is not enough memory for this stroke")
        return {"CANCELLED"}
    finally:
        if live() is not held:  # it was opened for this alone
            close_session()
    for warning in told:
        operator.report({"WARNING"}, str(warning.message))
    if elsewhere:
        operator.report({"WARNING"}, ELSEWHERE)
    operator.report({"INFO"}, f"{len(stroke.samples)} samples replayed")
    return {"FINISHED"}


def _replay(stroke: Stroke, obj: bpy.types.Object, windows: bpy.types.WindowManager) -> bool:
    """Walk a stroke through a volume and commit it, or leave all as it was. Whether it began on other voxels."""
    session = open_session(obj)
    if session.engine is not None:
        raise ValueError("a stroke is under way: finish it first")
    session.feeling = None
    elsewhere = stroke.grid_hash is not None and stroke.grid_hash != session.grid_hash()
    try:
        mass_out = walk(stroke, session.grid, windows)
        session.commit(obj, None, mass_out)
    except Exception:
        session.load(obj.data)
        raise
    session.changed(None)
    return elsewhere


class REPOUSSE_OT_replay_stroke(OnActiveVolume, bpy.types.Operator, ImportHelper):
    bl_idname = "repousse.replay_stroke"
    bl_label = "Replay Stroke"
    bl_description = "Push a recorded stroke through the active volume. Its poses are in voxels of that volume"
    bl_options = {"REGISTER", "UNDO"}

    filename_ext = ".jsonl"
    filter_glob: bpy.props.StringProperty(default="*.jsonl", options={"HIDDEN"})

    def execute(self, context):
        return replay(self, context, lambda: Stroke.load(self.filepath))


def register():
    bpy.utils.register_class(REPOUSSE_OT_replay_stroke)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_OT_replay_stroke)
