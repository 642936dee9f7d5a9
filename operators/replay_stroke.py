# SPDX-License-Identifier: GPL-3.0-or-later
"""Replay Stroke: walk a recorded stroke through the active volume."""

import bpy
from bpy_extras.io_utils import ImportHelper

from ..core import Stroke
from .volumes import OnActiveVolume, active_volume, density_of, show


class REPOUSSE_OT_replay_stroke(OnActiveVolume, bpy.types.Operator, ImportHelper):
    bl_idname = "repousse.replay_stroke"
    bl_label = "Replay Stroke"
    bl_description = "Push a recorded stroke through the active volume. Its poses are in voxels of that volume"
    bl_options = {"REGISTER", "UNDO"}

    filename_ext = ".jsonl"
    filter_glob: bpy.props.StringProperty(default="*.jsonl", options={"HIDDEN"})

    def execute(self, context):
        volume, windows = active_volume(context).data, context.window_manager
        try:
            stroke = Stroke.load(self.filepath)
            push = stroke.push(density_of(volume))
            windows.progress_begin(0, len(stroke.samples))
            try:
                for done, sample in enumerate(stroke.samples):
                    push.move_to(sample.position, sample.radius, stroke.continuous)
                    windows.progress_update(done)
            finally:
                windows.progress_end()
            show(volume, push.grid)
        except (ValueError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{len(stroke.samples)} samples replayed")
        return {"FINISHED"}


def register():
    bpy.utils.register_class(REPOUSSE_OT_replay_stroke)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_OT_replay_stroke)
