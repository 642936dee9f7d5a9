# SPDX-License-Identifier: GPL-3.0-or-later
"""Between density grids and Blender's volume objects, whose voxels Blender only ever reads from a file.

Blender caches a volume by its path for as long as it runs, so each revision is written under a new name.
"""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..core import PRESETS, DensityGrid
from ..core.formats import read_volume, write_in_place_of, write_volume
from ..core.histogram import BINS, histogram
from . import revisions

OPACITY = 0.5
"""Optical depth of a full voxel in the material that a new volume gets: solid within a few voxels."""

MATERIAL_ITEMS = [
    (name, name.capitalize(), f"{preset.feel.capitalize()}. Density {preset.density:g}")
    for name, preset in PRESETS.items()
]
"""The materials as the items of an EnumProperty."""


class RepousseVolume(bpy.types.PropertyGroup):
    """What the panel shows of a volume, noted when its file was written: drawing must not read files."""

    shape: bpy.props.IntVectorProperty(name="Voxels", description="Voxels along each axis")
    voxel_size: bpy.props.FloatProperty(name="Voxel Size", description="Edge of a voxel, in metres", unit="LENGTH")
    mass: bpy.props.FloatProperty(name="Mass", description="Sum of the density of all voxels, in full voxels' worth")
    histogram: bpy.props.FloatVectorProperty(
        name="Histogram", description="Voxels by density, from just above 0 to 1, in equal steps", size=BINS
    )
    level: bpy.props.FloatProperty(
        name="Visible Level",
        description="Density, from 0 to 1, at which the surface is seen and touched",
        default=0.5,
        min=0.001,
        max=0.999,
        precision=3,
        subtype="FACTOR",
    )


def register():
    bpy.utils.register_class(RepousseVolume)
    bpy.types.Volume.repousse = bpy.props.PointerProperty(type=RepousseVolume)


def unregister():
    del bpy.types.Volume.repousse
    bpy.utils.unregister_class(RepousseVolume)


def active_volume(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object, where it is a volume."""
    active = context.active_object
    return active if active is not None and active.type == "VOLUME" else None


class OnActiveVolume:
    """What the operators have in common that work on the active volume."""

    @classmethod
    def poll(cls, context):
        if active_volume(context) is None:
            cls.poll_message_set("Select a volume")
            return False
        return True


def add_volume(
    context: bpy.types.Context, grid: DensityGrid, name: str, matrix: Matrix | None = None
) -> bpy.types.Object:
    """A new volume object that shows ``grid``, active and alone selected; ``matrix`` is its place in the world."""
    volume = bpy.data.volumes.new(name)
    show(volume, grid)
    volume.materials.append(_material(name, grid))
    made = bpy.data.objects.new(name, volume)
    if matrix is not None:
        made.matrix_world = matrix
    context.collection.objects.link(made)
    for selected in context.selected_objects:
        selected.select_set(False)
    made.select_set(True)
    context.view_layer.objects.active = made
    return made


def show(volume: bpy.types.Volume, grid: DensityGrid) -> None:
    """Let ``volume`` show ``grid`` from a new file, in which the other grids of its former one are as they were."""
    path = revisions.new_path(volume)
    if volume.filepath:
        write_in_place_of(path_of(volume), grid, path)
    else:
        write_volume(grid, path)
    revisions.commit(volume, path)
    note(volume, grid, grid.mass)


def note(volume: bpy.types.Volume, grid: DensityGrid, mass: float) -> None:
    """Keep what the panel shows of a volume; ``mass`` in voxels' worth."""
    told = volume.repousse
    told.shape, told.voxel_size, told.mass = grid.shape, grid.voxel_size, mass
    told.histogram = histogram(grid.density)


def density_of(volume: bpy.types.Volume) -> DensityGrid:
    """The voxels of a volume, from its file: of the grid "density", else of the first that can be read.

    Raises ValueError with one line for data that must not be changed or cannot be read.
    """
    return read_volume(path_of(volume))


def path_of(volume: bpy.types.Volume) -> Path:
    """The file of a volume. Raises ValueError with one line where there is none, or none that may be replaced."""
    if volume.library is not None or volume.override_library is not None:
        raise ValueError(f"{volume.name}: is linked from another file: make it local first")
    if volume.is_sequence:
        raise ValueError(f"{volume.name}: is a sequence of files: import the one of a single frame")
    if not volume.filepath:
        raise ValueError(f"{volume.name}: has no file")
    return revisions.path_of(volume)


def place_in_world(grid: DensityGrid, matrix: Matrix) -> DensityGrid:
    """``grid`` where an object with this world matrix shows it. Raises ValueError when that is not made of cubes."""
    try:
        return DensityGrid(
            grid.density, np.array(matrix) @ grid.transform, grid.name, grid.metadata, grid.notes, copy=False
        )
    except ValueError as error:
        raise ValueError(f"the object's scale is not the same along its axes: {error}") from error


def _material(name: str, grid: DensityGrid) -> bpy.types.Material:
    """What lets a volume render: scattering in the colour of clay, as dense as its voxels are small."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # 4.5 makes a material without nodes
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    scatter = nodes.new("ShaderNodeVolumePrincipled")
    scatter.inputs["Color"].default_value = (0.50, 0.235, 0.145, 1.0)
    scatter.inputs["Density"].default_value = OPACITY / grid.voxel_size
    scatter.inputs["Density Attribute"].default_value = grid.name
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location.x = 300.0
    material.node_tree.links.new(scatter.outputs["Volume"], output.inputs["Volume"])
    return material
