# SPDX-License-Identifier: GPL-3.0-or-later
"""The material in numbers."""

from __future__ import annotations

import functools

import bpy

from ..core import SphereTool
from ..core.material import largest_yield_ratio
from .panel import InSidebar
from .presets import REPOUSSE_PT_material_presets


@functools.cache
def yielding_below() -> float:
    """The yield ratio below which uniform material is sure to yield under the brush, a sphere of any radius."""
    return largest_yield_ratio(SphereTool(32.0))


class REPOUSSE_PT_material(InSidebar, bpy.types.Panel):
    bl_label = "Material"
    bl_parent_id = "REPOUSSE_PT_volume"
    bl_order = 1

    def draw_header_preset(self, _context):
        REPOUSSE_PT_material_presets.draw_panel_header(self.layout)

    def draw(self, context):
        layout, settings = self.layout, context.scene.repousse
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "material")
        if not settings.is_preset():
            layout.label(text="Changed from what was chosen", icon="INFO")
        numbers = layout.column(align=True)
        numbers.prop(settings, "full_force", text="Full Force (N)")
        numbers.prop(settings, "yield_ratio")
        numbers.prop(settings, "force_exponent")
        if settings.yield_ratio >= yielding_below():
            text = bpy.app.translations.pgettext_iface("Only yields for certain below {:.2f}")
            layout.label(text=text.format(yielding_below()), icon="ERROR", translate=False)
        layout.prop(settings, "density", slider=True)
        rim = layout.row(heading="Rim", heading_ctxt="")
        rim.prop(settings, "use_band", text="")
        band = rim.row()
        band.active = settings.use_band
        band.prop(settings, "band", text="")
        layout.prop(settings, "border")
        layout.prop(settings, "method")


def register():
    bpy.utils.register_class(REPOUSSE_PT_material)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_PT_material)
