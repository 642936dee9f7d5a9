# SPDX-License-Identifier: GPL-3.0-or-later
"""What the operators have in common that make new clay: its material, and its density."""

from __future__ import annotations

import bpy

from ..core import PRESETS
from .volumes import MATERIAL_ITEMS


def _take_density(self: ClayChoice, _context: bpy.types.Context) -> None:
    self.density = PRESETS[self.material].density


class ClayChoice:
    material: bpy.props.EnumProperty(
        name="Material",
        description="What the clay is; it gives its density",
        items=MATERIAL_ITEMS,
        update=_take_density,
    )
    density: bpy.props.FloatProperty(
        name="Density",
        description="Density of the clay, from 0, empty, to 1, full",
        default=PRESETS[MATERIAL_ITEMS[0][0]].density,
        min=0.01,
        max=1.0,
        subtype="FACTOR",
    )

    def take_settings(self, context: bpy.types.Context) -> None:
        """Begin with the scene's material, where the caller has not said which."""
        settings = context.scene.repousse
        if not self.properties.is_property_set("material"):
            self.material = settings.material
            self.density = settings.density

    @property
    def asked_density(self) -> float:
        """The density that was given, else the material's."""
        given = self.properties.is_property_set("density")
        return self.density if given else PRESETS[self.material].density

    def draw_clay(self, layout: bpy.types.UILayout) -> None:
        """The two properties."""
        layout.prop(self, "material")
        layout.prop(self, "density", slider=True)
