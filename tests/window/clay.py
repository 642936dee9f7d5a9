# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes for scenarios, and their voxels as they are in memory and in files."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bl_ext.user_default.repousse.core import DensityGrid
from bl_ext.user_default.repousse.core.formats import read_volume
from bl_ext.user_default.repousse.operators.volumes import active_volume, add_volume

from .window import Window

RESOLUTION = 72
"""Voxels along an edge. No power of two, nor when the grid has grown: Mesa's software renderer compiles a shader anew,
for two seconds, whenever a side of a texture becomes one or ceases to be one."""


def new_block(window: Window, resolution: int = RESOLUTION, material: str = "clay") -> bpy.types.Object:
    """A block of clay about the world's middle, two metres wide, to the edges of its grid: the active object."""
    with window.context():
        assert bpy.ops.repousse.new_clay_block(resolution=resolution, size=2.0, material=material) == {"FINISHED"}
        bpy.ops.ed.undo_push(message="New Clay Block")
        return active_volume(bpy.context)


def new_slab(window: Window, resolution: int = RESOLUTION, density: float = 1.0) -> bpy.types.Object:
    """A slab in the lower half of a cubic grid two metres wide, with air on all sides: its top is at z = 0."""
    voxels = np.zeros((resolution,) * 3, np.float32)
    air = resolution // 8
    voxels[air:-air, air:-air, air : resolution // 2] = density
    edge = 2.0 / resolution
    transform = np.diag([edge, edge, edge, 1.0])
    transform[:3, 3] = 0.5 * edge - 1.0
    with window.context() as context:
        made = add_volume(context, DensityGrid(voxels, transform, copy=False), "Slab")
        bpy.ops.ed.undo_push(message="Slab")
        return made


def file_of(volume: bpy.types.Object) -> Path:
    """The file that Blender shows of a volume."""
    return Path(bpy.path.abspath(volume.data.filepath))


def in_file(volume: bpy.types.Object) -> DensityGrid:
    """The voxels of a volume, from its file."""
    return read_volume(file_of(volume))


def assert_same(found: DensityGrid, wanted: DensityGrid) -> None:
    """Two grids have the same voxels in the same places, to the last bit of density."""
    assert found.shape == wanted.shape, f"{found.shape} voxels, not {wanted.shape}"
    different = np.argwhere(found.density != wanted.density)
    if len(different):
        worst = np.abs(found.density - wanted.density).max()
        place = f"from {different.min(axis=0)} to {different.max(axis=0)}"
        raise AssertionError(f"{len(different)} voxels differ, {place}, by up to {worst:g}")
    assert np.allclose(found.transform, wanted.transform, rtol=1e-5, atol=1e-7), "the grids lie in different places"


def heights(grid: DensityGrid, x: float, y: float) -> float:
    """World z of the highest place of the column nearest to (x, y) where the density passes a half; -inf: nowhere."""
    to_index = np.linalg.inv(grid.transform)
    i, j = (round(v) for v in (to_index @ (x, y, 0.0, 1.0))[:2])
    column = grid.density[i, j]
    full = np.flatnonzero(column >= 0.5)
    if not len(full):
        return -np.inf
    k = int(full[-1])
    above = float(column[k + 1]) if k + 1 < len(column) else 0.0
    return float((grid.transform @ (i, j, k + (float(column[k]) - 0.5) / (float(column[k]) - above), 1.0))[2])
