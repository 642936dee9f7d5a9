# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel in the sidebar of the 3D view: making clay, and what is known of it. Its parts are files of their own.

Drawing reads properties alone: no file, and nothing that takes longer for a larger volume.
"""

import bpy

from ..operators.export_vdb import REPOUSSE_OT_export_vdb
from ..operators.import_volume import REPOUSSE_OT_import_volume
from ..operators.memory import draw_memory_line
from ..operators.mesh_to_clay import REPOUSSE_OT_mesh_to_clay
from ..operators.new_clay_block import REPOUSSE_OT_new_clay_block
from ..operators.replay_stroke import REPOUSSE_OT_replay_stroke
from ..operators.resample_volume import REPOUSSE_OT_resample_volume
from ..operators.volumes import active_volume


class InSidebar:
    """Where all the panels are."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Repoussé"


class OfVolume(InSidebar):
    """A panel that is there only while a volume is active."""

    @classmethod
    def poll(cls, context):
        return active_volume(context) is not None


class REPOUSSE_PT_volume(InSidebar, bpy.types.Panel):
    bl_label = "Repoussé"

    def draw(self, context):
        layout, settings = self.layout, context.scene.repousse
        begin = layout.column(align=True)
        begin.operator_context = "INVOKE_DEFAULT"
        for verb, icon in ((REPOUSSE_OT_new_clay_block, "MESH_CUBE"), (REPOUSSE_OT_mesh_to_clay, "MESH_MONKEY")):
            clay = begin.operator(verb.bl_idname, icon=icon)
            clay.material, clay.density = settings.material, settings.density
        begin.operator(REPOUSSE_OT_import_volume.bl_idname, icon="IMPORT")
        work = layout.column(align=True)
        work.operator_context = "INVOKE_DEFAULT"
        work.operator(REPOUSSE_OT_replay_stroke.bl_idname, icon="PLAY")
        work.operator(REPOUSSE_OT_resample_volume.bl_idname, icon="MOD_REMESH")
        work.operator(REPOUSSE_OT_export_vdb.bl_idname, icon="EXPORT")
        volume = active_volume(context)
        if volume is not None:
            _draw_told(layout.box().column(align=True), context, volume)


def _draw_told(column: bpy.types.UILayout, context: bpy.types.Context, volume: bpy.types.Object) -> None:
    """What was noted of a volume when it was written."""
    told = volume.data.repousse
    column.label(text=volume.name, icon="OUTLINER_OB_VOLUME", translate=False)
    if not any(told.shape):
        column.label(text="Not sculpted yet")
        return
    say = bpy.app.translations.pgettext_iface
    edge = bpy.utils.units.to_string(context.scene.unit_settings.system, "LENGTH", told.voxel_size, precision=4)
    lines = (
        say("{} x {} x {} voxels").format(*told.shape),
        say("Voxels of {}").format(edge),
        say("Mass {:.6g} voxels").format(told.mass),
    )
    for line in lines:
        column.label(text=line, translate=False)
    draw_memory_line(column, told.shape)


def register():
    bpy.utils.register_class(REPOUSSE_PT_volume)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_PT_volume)
