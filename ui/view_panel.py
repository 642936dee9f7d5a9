# SPDX-License-Identifier: GPL-3.0-or-later
"""How the volume is shown while it is sculpted: shading, visible level, and how much of it has which density."""

from __future__ import annotations

import bpy

from ..operators.automatic_level import REPOUSSE_OT_automatic_level, level_of
from ..operators.volumes import active_volume
from .live_view import cannot_show
from .panel import OfVolume
from .plots import histogram_plot

PLOT_SCALE = 7.0


class REPOUSSE_PT_view(OfVolume, bpy.types.Panel):
    bl_label = "Live View"
    bl_parent_id = "REPOUSSE_PT_volume"
    bl_order = 3

    def draw(self, context):
        layout, told = self.layout, active_volume(context).data.repousse
        layout.use_property_split = True
        layout.use_property_decorate = False
        say = bpy.app.translations.pgettext_iface
        reason = cannot_show(context.space_data)
        if reason is not None:
            layout.label(text=say(reason), icon="ERROR", translate=False)
        layout.prop(context.scene.repousse, "shading", expand=True)
        level = level_of(active_volume(context).data)
        row = layout.row(align=True)
        if told.is_property_set("level"):
            row.prop(told, "level", slider=True)
            row.operator(REPOUSSE_OT_automatic_level.bl_idname, text="", icon="LOOP_BACK").automatic = True
        else:
            found = say("Automatic") if level is None else say("Automatic: {:.2f}").format(level)
            row.label(text=say("Visible Level"), translate=False)
            row.operator(
                REPOUSSE_OT_automatic_level.bl_idname, text=found, icon="GREASEPENCIL", translate=False
            ).automatic = False
        if any(told.histogram):
            plot = histogram_plot(told.histogram, level or 0.0)
            if plot.icon:
                layout.template_icon(plot.icon, scale=PLOT_SCALE)
                layout.label(text="Voxels by density, 0 to 1; grey is not seen")


def register():
    bpy.utils.register_class(REPOUSSE_PT_view)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_PT_view)
