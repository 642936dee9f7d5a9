# SPDX-License-Identifier: GPL-3.0-or-later
"""Recording: whether strokes are kept, and those that were."""

from __future__ import annotations

import bpy

from ..operators.strokes import (
    REPOUSSE_OT_forget_stroke,
    REPOUSSE_OT_replay_kept_stroke,
    REPOUSSE_OT_save_strokes,
)
from ..operators.volumes import active_volume
from .panel import OfVolume


class REPOUSSE_UL_strokes(bpy.types.UIList):
    bl_idname = "REPOUSSE_UL_strokes"

    def draw_item(self, _context, layout, _data, item, _icon, _active_data, _active_property, _index=0, _flag=0):
        if item.text is None:
            layout.label(text="Its text was deleted", icon="ERROR")
        else:
            layout.prop(item.text, "name", text="", emboss=False, icon="TEXT")


class REPOUSSE_PT_strokes(OfVolume, bpy.types.Panel):
    bl_label = "Strokes"
    bl_parent_id = "REPOUSSE_PT_volume"
    bl_order = 5
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, strokes = self.layout, active_volume(context).data.repousse_strokes
        layout.prop(context.scene.repousse, "record")
        if not len(strokes.kept):
            return
        row = layout.row()
        row.template_list(REPOUSSE_UL_strokes.bl_idname, "", strokes, "kept", strokes, "active", rows=3)
        row.operator(REPOUSSE_OT_forget_stroke.bl_idname, text="", icon="REMOVE")
        work = layout.column(align=True)
        chosen = strokes.kept[min(max(strokes.active, 0), len(strokes.kept) - 1)].text
        if chosen is not None:
            work.operator(REPOUSSE_OT_replay_kept_stroke.bl_idname, text="Replay", icon="PLAY").text = chosen.name
        work.operator(REPOUSSE_OT_save_strokes.bl_idname, icon="EXPORT")


_CLASSES = (REPOUSSE_UL_strokes, REPOUSSE_PT_strokes)


def register():
    for made in _CLASSES:
        bpy.utils.register_class(made)


def unregister():
    for made in reversed(_CLASSES):
        bpy.utils.unregister_class(made)
