# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes for scenarios, and their voxels as they are in memory and in files."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bl_ext.user_default.repousse.core import DensityGrid
from bl_ext.user_default.repousse.core.formats import read_volume
from bl_ext.user_default.repousse.operators.volumes import active_volume

from .window import Window


def new_block(window: Window, resolution: int = 64, material: str = "clay") -> bpy.types.Object:
    """A block of clay, two metres wide, about the world's middle: the active object."""
    with window.context():
        assert bpy.ops.repousse.new_clay_block(resolution=resolution, size=2.0, material=material) == {"FINISHED"}
        bpy.ops.ed.undo_push(message="New Clay Block")
        return active_volume(bpy.context)


def file_of(volume: bpy.types.Object) -> Path:
    """The file that Blender shows of a volume."""
    return Path(bpy.path.abspath(volume.data.filepath))


def in_file(volume: bpy.types.Object) -> DensityGrid:
    """The voxels of a volume, from its file."""
    return read_volume(file_of(volume))


def same(one: DensityGrid, other: DensityGrid) -> bool:
    """Whether two grids have the same voxels in the same places, to the last bit of density."""
    return np.array_equal(one.density, other.density) and np.allclose(one.transform, other.transform, rtol=1e-6)
