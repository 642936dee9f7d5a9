# SPDX-License-Identifier: GPL-3.0-or-later
"""The cursor: rings on the surface where the tool and its reach touch, in the colour of the regime.

Around them the stress as an arc, and beside them in newtons.

Each is drawn twice, as far as it is in sight in full and behind things faintly, so that it is never lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import blf
import bpy
import gpu
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader

from ..core import Regime
from ..core.tool import Vector

CORNERS = 64
"""Of a ring."""
TOOL_WIDTH, REACH_WIDTH, ARC_WIDTH = 2.0, 1.0, 5.0
"""Pixels."""
ARC_RADIUS = 1.12
"""Of the stress's arc, in radii of the tool."""
LIFTED = 0.02
"""Radii by which the rings are above the surface, or it would swallow half of them."""
IN_SIGHT, BEHIND = 1.0, 0.25
"""Opacities."""
TEXT_SIZE = 13.0
"""Pixels at a resolution scale of 1."""
COLOURS = {
    Regime.NONE: (0.90, 0.90, 0.90),
    Regime.ELASTIC: (0.34, 0.71, 0.91),
    Regime.PLASTIC: (0.95, 0.62, 0.05),
    Regime.UNLOADING: (0.80, 0.60, 0.85),
}
"""Of Okabe and Ito's palette, which the colour-blind tell apart as well."""


@dataclass(frozen=True)
class CursorState:
    """What the cursor shows: position and unit normal in the world, lengths in world units, share of stress over yield
    stress from 0 to 1, and a text beside it."""

    position: Vector
    normal: Vector
    radius: float
    reach: float
    regime: Regime
    share: float
    text: str


_state: CursorState | None = None


def set_state(state: CursorState | None) -> None:
    """Show this from the next drawing on; None shows nothing."""
    global _state
    _state = state


def circle(centre: Vector, normal: Vector, radius: float, share: float = 1.0) -> np.ndarray:
    """Points (n, 3) of a circle, or of the first ``share`` of it, in the plane through ``centre`` across ``normal``."""
    out_of = np.array(normal) / np.linalg.norm(normal)
    side = np.cross(out_of, np.eye(3)[np.abs(out_of).argmin()])
    side /= np.linalg.norm(side)
    other = np.cross(out_of, side)
    turn = 2.0 * np.pi * share * np.linspace(0.0, 1.0, max(2, round(CORNERS * share) + 1))
    return np.array(centre) + radius * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other)


def strokes(state: CursorState) -> list[tuple[np.ndarray, float]]:
    """The lines of a cursor: points (n, 3) in the world, and widths in pixels."""
    centre = np.array(state.position) + LIFTED * state.radius * np.array(state.normal)
    lines = [
        (circle(centre, state.normal, state.radius), TOOL_WIDTH),
        (circle(centre, state.normal, state.reach), REACH_WIDTH),
    ]
    if state.share > 0.0:
        lines.append((circle(centre, state.normal, ARC_RADIUS * state.radius, state.share), ARC_WIDTH))
    return lines


def draw_rings(state: CursorState, scale: float = 1.0) -> None:
    """Draw into the view that is being drawn, by its depth; lines are as wide as they say times ``scale``."""
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    former = gpu.state.depth_test_get(), gpu.state.depth_mask_get(), gpu.state.blend_get()
    gpu.state.depth_mask_set(False)
    gpu.state.blend_set("ALPHA")
    shader.bind()
    shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
    try:
        for points, width in strokes(state):
            batch = batch_for_shader(shader, "LINE_STRIP", {"pos": points.astype(np.float32)})
            shader.uniform_float("lineWidth", width * scale)
            for depth_test, opacity in (("LESS_EQUAL", IN_SIGHT), ("GREATER", BEHIND)):
                gpu.state.depth_test_set(depth_test)
                shader.uniform_float("color", (*COLOURS[state.regime], opacity))
                batch.draw(shader)
    finally:
        gpu.state.depth_test_set(former[0])
        gpu.state.depth_mask_set(former[1])
        gpu.state.blend_set(former[2])


def draw_text(state: CursorState) -> None:
    """Write beside the ring, in pixels of the region that is being drawn."""
    region, view = bpy.context.region, bpy.context.region_data
    at = location_3d_to_region_2d(region, view, state.position)
    right = np.array(view.view_matrix)[0, :3]
    edge = location_3d_to_region_2d(region, view, np.array(state.position) + ARC_RADIUS * state.radius * right)
    if at is None or edge is None:
        return
    scale = bpy.context.preferences.system.ui_scale
    blf.size(0, TEXT_SIZE * scale)
    blf.color(0, *COLOURS[state.regime], IN_SIGHT)
    blf.position(0, edge.x + 8.0 * scale, at.y - 0.35 * TEXT_SIZE * scale, 0.0)
    blf.enable(0, blf.SHADOW)
    blf.shadow(0, 3, 0.0, 0.0, 0.0, 0.8)
    blf.draw(0, state.text)
    blf.disable(0, blf.SHADOW)


def _draw_rings() -> None:
    if _state is not None and bpy.context.region_data is not None:
        draw_rings(_state, bpy.context.preferences.system.ui_scale)


def _draw_text() -> None:
    if _state is not None and _state.text and bpy.context.region_data is not None:
        draw_text(_state)


_handles: list = []


def register():
    if not bpy.app.background:
        add = bpy.types.SpaceView3D.draw_handler_add
        _handles[:] = [add(_draw_rings, (), "WINDOW", "POST_VIEW"), add(_draw_text, (), "WINDOW", "POST_PIXEL")]


def unregister():
    global _state
    for handle in _handles:
        bpy.types.SpaceView3D.draw_handler_remove(handle, "WINDOW")
    _handles.clear()
    _state = None
