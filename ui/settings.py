# SPDX-License-Identifier: GPL-3.0-or-later
"""What is chosen once for a scene."""

import bpy

from ..operators.volumes import MATERIAL_ITEMS


class RepousseSettings(bpy.types.PropertyGroup):
    material: bpy.props.EnumProperty(
        name="Material",
        description="What new clay is made of: it gives its density",
        items=MATERIAL_ITEMS,
    )


def register():
    bpy.utils.register_class(RepousseSettings)
    bpy.types.Scene.repousse = bpy.props.PointerProperty(type=RepousseSettings)


def unregister():
    del bpy.types.Scene.repousse
    bpy.utils.unregister_class(RepousseSettings)
