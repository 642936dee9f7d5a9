# SPDX-License-Identifier: GPL-3.0-or-later
"""The visible level of a volume: found in its densities, or set by hand."""

from __future__ import annotations

import bpy

from .session import live
from .volumes import OnActiveVolume, active_volume


def level_of(volume: bpy.types.Volume) -> float | None:
    """The density at which a volume's surface is seen: as set by hand, else as found; None until it is sculpted."""
    told, session = volume.repousse, live()
    if told.is_property_set("level"):
        return told.level
    return session.auto_level if session is not None and session.volume_uid == volume.session_uid else None


class REPOUSSE_OT_automatic_level(OnActiveVolume, bpy.types.Operator):
    bl_idname = "repousse.automatic_level"
    bl_label = "Automatic Level"
    bl_description = "Choose whether the visible level is found in the volume's densities or set by hand"
    bl_options = {"REGISTER", "UNDO"}

    automatic: bpy.props.BoolProperty(
        name="Automatic", description="Take the level that parts the empty from the full voxels best", default=True
    )

    def execute(self, context):
        volume = active_volume(context).data
        if self.automatic:
            volume.repousse.property_unset("level")
        else:
            found = level_of(volume)
            volume.repousse.level = volume.repousse.level if found is None else found
        return {"FINISHED"}


def register():
    bpy.utils.register_class(REPOUSSE_OT_automatic_level)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_OT_automatic_level)
