# SPDX-License-Identifier: GPL-3.0-or-later
"""What a volume of some shape takes in memory, told before it is made."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

import bpy

from ..core.formats import MAX_VOXELS

DENSITY = 8
"""Bytes a voxel: float32 in the array that is sculpted, and again in the grid that its file is written from."""
TEXTURE = 2
"""Bytes a voxel on the graphics card while it is sculpted."""
HISTORY = 4
"""Bytes a voxel that a stroke touches: what it was before."""


def mebibytes(shape: Sequence[int]) -> tuple[float, float, float]:
    """Memory in MiB for a full volume: the clay, its picture in the view, and at most the undo of a running stroke."""
    voxels = prod(map(int, shape)) / 2**20
    return voxels * DENSITY, voxels * TEXTURE, voxels * HISTORY


def draw_memory(layout: bpy.types.UILayout, context: bpy.types.Context, shape: Sequence[int], voxel: float) -> None:
    """Two lines on what will be made: voxels and their edge (``voxel``, in metres); its memory."""
    say = bpy.app.translations.pgettext_iface
    edge = bpy.utils.units.to_string(context.scene.unit_settings.system, "LENGTH", voxel, precision=4)
    column = layout.column(align=True)
    column.label(text=say("{} x {} x {} voxels of {}").format(*shape, edge), icon="INFO", translate=False)
    if prod(map(int, shape)) > MAX_VOXELS:
        column.label(text="More than can be sculpted: choose larger voxels", icon="ERROR")
        return
    draw_memory_line(column, shape, icon="BLANK1")


def draw_memory_line(layout: bpy.types.UILayout, shape: Sequence[int], icon: str = "NONE") -> None:
    """One line on what a volume takes."""
    clay, view, history = mebibytes(shape)
    text = bpy.app.translations.pgettext_iface("{:.3g} MiB (clay {:.3g}, view {:.3g}, undo {:.3g})")
    text = text.format(clay + view + history, clay, view, history)
    layout.label(text=text, icon=icon, translate=False)
