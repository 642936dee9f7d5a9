# SPDX-License-Identifier: GPL-3.0-or-later
"""What is chosen once for a scene: the material, the brush, and how a volume is shown while it is sculpted."""

from __future__ import annotations

from math import isclose

import bpy

from ..core import PRESETS, Material
from ..core.material import EXPONENTS
from ..core.native.state import BORDERS
from ..core.push import METHODS
from ..core.quality import QUALITIES, Auto
from .volumes import MATERIAL_ITEMS

_DEFAULT = PRESETS["clay"]
_BORDER_WORDS = {
    "grow": "The volume grows where material reaches its edge",
    "wall": "Nothing leaves the volume: its edges are walls",
    "open": "What leaves the volume is gone",
}
_METHOD_WORDS = {
    "sweep": "All that yields is swept along together: fast, for volumes of any size",
    "recursive": "The paper's recursion, voxel by voxel: for small volumes only",
}
_QUALITY_WORDS = {
    "exact": "The best there is",
    "balanced": "One sweep a step, by leaps far from the tool: within a few per cent of exact, less for large tools",
    "draft": "Half as many steps as well, each a voxel long: twice as fast, for trying out",
}
# Made here, for Python 3.11 finds no name of the module from within a comprehension in an annotation.
_METHOD_ITEMS = [(name, name.capitalize(), _METHOD_WORDS[name]) for name in METHODS]
_QUALITY_ITEMS = [(name, name.capitalize(), _QUALITY_WORDS[name]) for name in QUALITIES]
_QUALITY_ITEMS += [("auto", "Auto", "As near to exact as the frame budget allows, step by step. A replay repeats it")]
_BORDER_ITEMS = [(name, name.capitalize(), _BORDER_WORDS[name]) for name in BORDERS]


def _take_preset(self: RepousseSettings, _context: bpy.types.Context) -> None:
    preset = PRESETS[self.material]
    self.full_force, self.yield_ratio = preset.material.full_force, preset.material.yield_ratio
    self.force_exponent = preset.material.exponent
    self.density = preset.density
    self.use_band = preset.band is not None
    if preset.band is not None:
        self.band = preset.band


class RepousseSettings(bpy.types.PropertyGroup):
    """Material, brush and view. Lengths of the brush are pixels on the screen, as those of Blender's own brushes."""

    material: bpy.props.EnumProperty(
        name="Material",
        description="What clay is made of: sets its forces, its density and how far ahead it flows",
        items=MATERIAL_ITEMS,
        update=_take_preset,
    )
    full_force: bpy.props.FloatProperty(
        name="Full Force",
        description="Stress in newtons with the tool wholly inside full material",
        default=_DEFAULT.material.full_force,
        min=0.01,
        soft_max=25.0,
        max=1000.0,
        precision=2,
    )
    yield_ratio: bpy.props.FloatProperty(
        name="Yield Ratio",
        description="Part (0 to 1) of a full voxel in the tool that one full voxel around it carries before it yields",
        default=_DEFAULT.material.yield_ratio,
        min=1e-3,
        soft_max=0.4,
        max=1.0,
        precision=3,
        step=1,
    )
    force_exponent: bpy.props.FloatProperty(
        name="Force Exponent",
        description="Power, from 0.5 to 1.5, of what the tool holds that its force grows with: 1 is the paper's, 0.75 "
        "elastic contact's, 0.5 fully plastic contact's, firm from the first touch. No voxel depends on it",
        default=_DEFAULT.material.exponent,
        min=EXPONENTS[0],
        max=EXPONENTS[1],
        precision=2,
        step=5,
    )
    density: bpy.props.FloatProperty(
        name="Density",
        description="Density of new clay, from 0, empty, to 1, full; full clay rises as a rim, light clay packs",
        default=_DEFAULT.density,
        min=0.01,
        max=1.0,
        subtype="FACTOR",
    )
    method: bpy.props.EnumProperty(
        name="Method",
        description="How material finds its way",
        items=_METHOD_ITEMS,
    )
    border: bpy.props.EnumProperty(
        name="Border",
        description="What happens at the edge of the volume",
        items=_BORDER_ITEMS,
    )
    use_band: bpy.props.BoolProperty(
        name="Rim",
        description="Material turns back a little way ahead of the tool, and rises as a rim around it",
        default=_DEFAULT.band is not None,
    )
    band: bpy.props.FloatProperty(
        name="Band",
        description="How far ahead of the tool material goes before it turns back, in tool radii",
        default=_DEFAULT.band or 1.0,
        min=0.0,
        soft_max=4.0,
        max=100.0,
    )

    radius: bpy.props.IntProperty(
        name="Radius",
        description="Radius of the tool in pixels on the screen (F)",
        default=40,
        min=1,
        soft_max=200,
        max=2000,
        subtype="PIXEL",
    )
    strength: bpy.props.FloatProperty(
        name="Strength",
        description="How deep the tool is pressed in, as a part of its radius (Shift F)",
        default=0.5,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
    )
    press: bpy.props.EnumProperty(
        name="Direction",
        description="Which way the tool is pressed, and material flows",
        items=[
            ("view", "View", "Away from the viewer"),
            ("normal", "Normal", "Straight into the surface"),
            ("stroke", "Stroke", "Into the surface; material flows along the stroke, as before a plough"),
        ],
        default="normal",
    )
    drill: bpy.props.BoolProperty(
        name="Drill", description="While it is held the tool goes on, by strength times radius a second"
    )
    pressure_radius: bpy.props.BoolProperty(name="Pressure on Radius", description="The pen's pressure sets the radius")
    pressure_strength: bpy.props.BoolProperty(
        name="Pressure on Strength", description="The pen's pressure sets the strength", default=True
    )
    quality: bpy.props.EnumProperty(
        name="Quality",
        description="What a step may cost, and so how near it comes to the exact one",
        items=_QUALITY_ITEMS,
    )
    frame_budget: bpy.props.FloatProperty(
        name="Frame Budget",
        description="Milliseconds in which the tool should be where the pointer is: else Auto takes a faster quality",
        default=8.0,
        min=0.1,
        soft_min=1.0,
        soft_max=50.0,
        max=1000.0,
        precision=1,
    )
    error_bound: bpy.props.FloatProperty(
        name="Error Bound",
        description="How much of what is moved may lie elsewhere than by Exact, in per cent: Auto takes nothing worse",
        default=5.0,
        min=0.1,
        soft_max=30.0,
        max=100.0,
        subtype="PERCENTAGE",
    )
    spacing: bpy.props.FloatProperty(
        name="Spacing",
        description="Way between two poses of the tool, in per cent of its radius",
        default=15.0,
        min=1.0,
        max=100.0,
        subtype="PERCENTAGE",
    )
    stabiliser: bpy.props.IntProperty(
        name="Stabilizer",
        description="Length in pixels of the string by which the mouse drags the tool; 0 is none",
        default=0,
        min=0,
        soft_max=150,
        max=1000,
        subtype="PIXEL",
    )
    mirror_x: bpy.props.BoolProperty(
        name="X", description="Push on both sides of the object's origin along the volume's X axis"
    )
    mirror_y: bpy.props.BoolProperty(
        name="Y", description="Push on both sides of the object's origin along the volume's Y axis"
    )
    mirror_z: bpy.props.BoolProperty(
        name="Z", description="Push on both sides of the object's origin along the volume's Z axis"
    )
    record: bpy.props.BoolProperty(
        name="Record Strokes", description="Keep each stroke as a text of this file, to be replayed later"
    )
    shading: bpy.props.EnumProperty(
        name="Show As",
        description="How the volume is shown while the tool is active",
        items=[
            ("SURFACE", "Surface", "The surface where density passes the level"),
            ("FOG", "Fog", "All densities, as fog"),
        ],
    )

    @property
    def mirror_axes(self) -> str:
        """The axes that are mirrored: a Stroke's ``symmetry``."""
        return "".join(axis for axis in "xyz" if getattr(self, f"mirror_{axis}"))

    @property
    def clay(self) -> Material:
        """The forces as the core has them."""
        return Material(self.full_force, self.yield_ratio, self.force_exponent)

    @property
    def chosen_quality(self) -> str | Auto:
        """The quality of the next stroke, or who chooses it."""
        return Auto(self.frame_budget, self.error_bound / 100.0) if self.quality == "auto" else self.quality

    def is_preset(self) -> bool:
        """Whether the numbers are still those of the chosen material."""
        preset, now = PRESETS[self.material], self.clay
        asked = (preset.material.full_force, preset.material.yield_ratio, preset.material.exponent)
        given = (now.full_force, now.yield_ratio, now.exponent)
        same_band = self.use_band == (preset.band is not None) and (
            not self.use_band or isclose(self.band, preset.band, rel_tol=1e-6)
        )
        return same_band and all(isclose(a, b, rel_tol=1e-6) for a, b in zip(asked, given))


def register():
    bpy.utils.register_class(RepousseSettings)
    bpy.types.Scene.repousse = bpy.props.PointerProperty(type=RepousseSettings)


def unregister():
    del bpy.types.Scene.repousse
    bpy.utils.unregister_class(RepousseSettings)
