# SPDX-License-Identifier: GPL-3.0-or-later
"""Resample: the active volume on finer or coarser voxels."""

from __future__ import annotations

from math import isclose

import bpy

from ..core.resample import SAME_SIZE, resample, resampled_shape
from .memory import draw_memory
from .volumes import OnActiveVolume, active_volume, density_of, note, show


class REPOUSSE_OT_resample_volume(OnActiveVolume, bpy.types.Operator):
    bl_idname = "repousse.resample_volume"
    bl_label = "Resample"
    bl_description = "Give the active volume finer or coarser voxels. Its mass stays, and what it looks like"
    bl_options = {"REGISTER", "UNDO"}

    voxel_size: bpy.props.FloatProperty(
        name="Voxel Size",
        description="Edge of a voxel in metres, before the object's scale",
        default=0.02,
        min=1e-6,
        soft_max=1.0,
        precision=5,
        step=0.1,
        unit="LENGTH",
    )

    def invoke(self, context, _event):
        volume = active_volume(context).data
        try:
            if not any(volume.repousse.shape):  # its file is not one of ours
                grid = density_of(volume)
                note(volume, grid, grid.mass)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not self.properties.is_property_set("voxel_size"):
            self.voxel_size = volume.repousse.voxel_size
        return context.window_manager.invoke_props_dialog(self)

    def draw(self, context):
        layout, told = self.layout, active_volume(context).data.repousse
        layout.use_property_split = True
        layout.prop(self, "voxel_size")
        layout.label(
            text=bpy.app.translations.pgettext_iface("Now {} x {} x {} voxels").format(*told.shape), translate=False
        )
        # What was noted of the volume stands for its grid, of which only the shape and the voxel size are asked for.
        draw_memory(layout, context, resampled_shape(told, self.voxel_size), self.voxel_size)

    def execute(self, context):
        volume = active_volume(context).data
        try:
            grid = density_of(volume)
            if isclose(grid.voxel_size, self.voxel_size, rel_tol=SAME_SIZE):
                raise ValueError("the voxels have this size already: choose another")
            show(volume, resample(grid, self.voxel_size))
        except (ValueError, MemoryError) as error:
            self.report({"ERROR"}, str(error) or "There is not enough memory: choose larger voxels")
            return {"CANCELLED"}
        return {"FINISHED"}


def register():
    bpy.utils.register_class(REPOUSSE_OT_resample_volume)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_OT_resample_volume)
