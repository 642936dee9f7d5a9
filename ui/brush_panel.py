# SPDX-License-Identifier: GPL-3.0-or-later
"""The brush, laid out as Blender lays out its own."""

from __future__ import annotations

import bpy

from .panel import InSidebar


def draw_brush(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """Every property of the brush, for a sidebar."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    for amount, pressure in ("radius", "pressure_radius"), ("strength", "pressure_strength"):
        row = layout.row(align=True)
        row.prop(settings, amount, slider=True)
        row.prop(settings, pressure, text="", icon="STYLUS_PRESSURE")
    layout.prop(settings, "press")
    layout.prop(settings, "drill")
    stroke = layout.column(align=True)
    stroke.prop(settings, "spacing", slider=True)
    stroke.prop(settings, "stabiliser", slider=True)
    draw_quality(layout, settings)
    draw_mirror(layout, settings)


def draw_quality(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """What a step may cost, and what Auto goes by."""
    layout.prop(settings, "quality")
    if settings.quality == "auto":
        auto = layout.column(align=True)
        auto.prop(settings, "frame_budget", text="Frame Budget (ms)")
        auto.prop(settings, "error_bound")


def draw_mirror(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """The three axes of symmetry in one row."""
    mirror = layout.row(align=True, heading="Mirror")
    for axis in "xyz":
        mirror.prop(settings, f"mirror_{axis}", toggle=True)


class REPOUSSE_PT_brush(InSidebar, bpy.types.Panel):
    bl_label = "Brush"
    bl_parent_id = "REPOUSSE_PT_volume"
    bl_order = 2
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        draw_brush(self.layout, context.scene.repousse)


def register():
    bpy.utils.register_class(REPOUSSE_PT_brush)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_PT_brush)
