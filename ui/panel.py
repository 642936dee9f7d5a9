# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel in the sidebar of the 3D view."""

import bpy

from ..operators.export_vdb import REPOUSSE_OT_export_vdb
from ..operators.import_volume import REPOUSSE_OT_import_volume
from ..operators.mesh_to_clay import REPOUSSE_OT_mesh_to_clay
from ..operators.new_clay_block import REPOUSSE_OT_new_clay_block
from ..operators.replay_stroke import REPOUSSE_OT_replay_stroke
from ..operators.volumes import active_volume


class REPOUSSE_PT_volume(bpy.types.Panel):
    bl_label = "Repoussé"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Repoussé"

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        settings = context.scene.repousse
        layout.prop(settings, "material")
        begin = layout.column(align=True)
        begin.operator_context = "INVOKE_DEFAULT"
        for verb, icon in ((REPOUSSE_OT_new_clay_block, "MESH_CUBE"), (REPOUSSE_OT_mesh_to_clay, "MESH_MONKEY")):
            begin.operator(verb.bl_idname, icon=icon).material = settings.material
        begin.operator(REPOUSSE_OT_import_volume.bl_idname, icon="IMPORT")
        volume = active_volume(context)
        work = layout.column(align=True)
        work.operator(REPOUSSE_OT_replay_stroke.bl_idname, icon="PLAY")
        work.operator(REPOUSSE_OT_export_vdb.bl_idname, icon="EXPORT")
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


def register():
    bpy.utils.register_class(REPOUSSE_PT_volume)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_PT_volume)
