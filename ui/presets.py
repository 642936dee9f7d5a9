# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials by name: those that are built in, and the artist's own as presets of Blender's."""

from __future__ import annotations

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ..operators.volumes import MATERIAL_ITEMS

SUBDIR = "repousse/material"
"""Of Blender's folders for presets."""


class REPOUSSE_OT_add_material_preset(AddPresetBase, bpy.types.Operator):
    bl_idname = "repousse.add_material_preset"
    bl_label = "Add Material Preset"
    bl_description = "Keep the numbers of this material as a preset of your own, or remove one"

    preset_menu = "REPOUSSE_PT_material_presets"
    preset_subdir = SUBDIR
    preset_defines = ("settings = bpy.context.scene.repousse",)
    # The material comes first: choosing it sets the others.
    preset_values = tuple(
        f"settings.{name}"
        for name in ("material", "full_force", "yield_ratio", "force_exponent", "density", "use_band", "band")
    )


class REPOUSSE_PT_material_presets(PresetPanel, bpy.types.Panel):
    bl_label = "Material Presets"
    preset_subdir = SUBDIR
    preset_operator = "script.execute_preset"
    preset_add_operator = REPOUSSE_OT_add_material_preset.bl_idname

    def draw(self, context):
        column = self.layout.column(align=True)
        for name, *_ in MATERIAL_ITEMS:
            column.prop_enum(context.scene.repousse, "material", name)
        self.layout.separator()
        if bpy.utils.preset_paths(SUBDIR):
            PresetPanel.draw(self, context)
        else:  # none of the artist's own yet
            self.layout.operator_context = "INVOKE_DEFAULT"
            self.layout.operator(self.preset_add_operator, text="Add Preset", icon="ADD")


_CLASSES = (REPOUSSE_OT_add_material_preset, REPOUSSE_PT_material_presets)


def register():
    for made in _CLASSES:
        bpy.utils.register_class(made)


def unregister():
    for made in reversed(_CLASSES):
        bpy.utils.unregister_class(made)
