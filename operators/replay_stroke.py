# SPDX-License-Identifier: GPL-3.0-or-later
"""Replay Stroke: walk a recorded stroke through the active volume."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import bpy
from bpy_extras.io_utils import ImportHelper

from ..core import DensityGrid, Stroke
from ..core.stroke import hash_of
from .volumes import OnActiveVolume, active_volume, density_of, show

ELSEWHERE = "This stroke was recorded on another volume, or another state of it: the result is not the recorded one"


def walk(stroke: Stroke, grid: DensityGrid, windows: bpy.types.WindowManager) -> None:
    """Walk every pose of a stroke, of any verb and symmetry, through ``grid``, which is changed; show how far it is."""
    push = stroke.push(grid)
    windows.progress_begin(0, len(stroke.samples))
    try:
        for done, sample in enumerate(stroke.samples):
            push.walk(sample, stroke.continuous)
            windows.progress_update(done)
    finally:
        windows.progress_end()


def replay(operator: bpy.types.Operator, context: bpy.types.Context, read: Callable[[], Stroke]) -> set[str]:
    """A whole execution: the stroke that ``read`` returns through the active volume, as its next revision."""
    volume = active_volume(context).data
    try:
        stroke, grid = read(), density_of(volume)
        elsewhere = stroke.grid_hash is not None and stroke.grid_hash != hash_of(grid)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            walk(stroke, grid, context.window_manager)
        show(volume, grid)
    except (ValueError, OSError, MemoryError) as error:
        operator.report({"ERROR"}, str(error) or "There is not enough memory for this stroke")
        return {"CANCELLED"}
    for warning in told:
        operator.report({"WARNING"}, str(warning.message))
    if elsewhere:
        operator.report({"WARNING"}, ELSEWHERE)
    operator.report({"INFO"}, f"{len(stroke.samples)} samples replayed")
    return {"FINISHED"}


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
