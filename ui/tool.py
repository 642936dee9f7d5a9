# SPDX-License-Identifier: GPL-3.0-or-later
"""The tool in the toolbar, and what follows from its being active: the volume is held ready and shown live."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy

from ..core import Regime
from ..core.tool import DEFAULT_REACH
from ..operators.hover import REPOUSSE_OT_hover
from ..operators.sculpt import REPOUSSE_OT_sculpt
from ..operators.session import Session, close_session, live, open_session
from . import cursor
from .brush_panel import draw_brush, draw_mirror
from .live_view import cannot_show

TOOL = "repousse.push"
"""Identifier of the tool; the add-on's name comes first, as Blender asks."""

_SIZES = (("LEFT_BRACKET", 0.9), ("RIGHT_BRACKET", 1.0 / 0.9))


def _stroke(verb: str, **modifiers: bool) -> tuple:
    event = {"type": "LEFTMOUSE", "value": "PRESS", **modifiers}
    return REPOUSSE_OT_sculpt.bl_idname, event, {"properties": [("verb", verb)]}


def _radial(path: str, **modifiers: bool) -> tuple:
    event = {"type": "F", "value": "PRESS", **modifiers}
    return "wm.radial_control", event, {"properties": [("data_path_primary", path)]}


class RepousseTool(bpy.types.WorkSpaceTool):
    bl_space_type = "VIEW_3D"
    bl_context_mode = "OBJECT"
    bl_idname = TOOL
    bl_label = "Push Volume"
    bl_description = (
        "Push the active volume into shape.\n"
        "• Ctrl pulls material back towards you, Shift smooths\n"
        "• F changes the radius, Shift F the strength"
    )
    bl_icon = str(Path(__file__).parent / "icons" / "repousse.push")
    bl_keymap = (
        (REPOUSSE_OT_hover.bl_idname, {"type": "MOUSEMOVE", "value": "ANY", "any": True}, None),
        _stroke("push"),
        _stroke("pull", ctrl=True),
        _stroke("smooth", shift=True),
        _radial("scene.repousse.radius"),
        _radial("scene.repousse.strength", shift=True),
        *(
            (
                "wm.context_scale_int",
                {"type": key, "value": "PRESS", "repeat": True},
                {"properties": [("data_path", "scene.repousse.radius"), ("value", factor)]},
            )
            for key, factor in _SIZES
        ),
    )

    def draw_settings(context, layout, tool):  # noqa: N805  Blender calls it without an instance
        settings = context.scene.repousse
        if context.region.type != "TOOL_HEADER":
            draw_brush(layout, settings)
            return
        layout.prop(settings, "radius", slider=True)
        layout.prop(settings, "strength", slider=True)
        layout.prop(settings, "press")
        layout.prop(settings, "drill")
        layout.label(icon="MOD_MIRROR")
        draw_mirror(layout, settings)
        hindrance = refusal() or cannot_show(context.space_data)
        if hindrance:
            layout.label(text=bpy.app.translations.pgettext_iface(hindrance), icon="ERROR", translate=False)


def is_active(workspace: bpy.types.WorkSpace) -> bool:
    """Whether the tool is chosen in a workspace."""
    tool = workspace.tools.from_space_view3d_mode("OBJECT", create=False)
    return tool is not None and tool.idname == TOOL


def refusal() -> str:
    """Why the active volume cannot be sculpted, in one line; empty where it can."""
    return _refused[1] if _refused else ""


_refused: tuple[tuple, str] | None = None  # what was asked for last and could not be opened, and why


def _wanted() -> Iterator[bpy.types.Object]:
    """The volumes that the tool is on, in all windows."""
    for window in bpy.context.window_manager.windows:
        active = window.view_layer.objects.active
        if active is not None and active.type == "VOLUME" and active.mode == "OBJECT" and is_active(window.workspace):
            yield active


def _key(obj: bpy.types.Object) -> tuple:
    return obj.data.session_uid, obj.data.filepath


def synchronise() -> None:
    """Hold the volume ready that the tool is on, or none. Called by a timer, never while drawing."""
    global _refused
    session = live()
    if session is not None and session.engine is not None:
        return  # a stroke keeps what it works on
    obj = next(_wanted(), None)
    if obj is None:
        _refused = None
        close_session()
        return
    if _refused is not None and _refused[0] == _key(obj):
        return
    _refused = None
    try:
        open_session(obj).take_display(obj)
    except (ValueError, MemoryError) as error:
        close_session()
        _refused = (_key(obj), str(error) or "There is not enough memory for this volume")
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def _out_of_step(session: Session | None) -> bool:
    obj = next(_wanted(), None)
    if obj is None:
        return session is not None or _refused is not None
    if _refused is not None:
        return _refused[0] != _key(obj)
    return session is None or session.volume_uid != obj.data.session_uid


def _watch() -> None:
    """Before each drawing of a 3D view: is what is held ready still what the tool is on? And where is the tool?"""
    session = live()
    resting = session is None or session.engine is None
    if resting and _out_of_step(session) and not bpy.app.timers.is_registered(synchronise):
        bpy.app.timers.register(synchronise, first_interval=0.0)
    cursor.set_state(_cursor_of(session) if session is not None and is_active(bpy.context.workspace) else None)


def _cursor_of(session: Session) -> cursor.CursorState | None:
    pointer = session.pointer
    if pointer is None:
        return None
    regime, stress, yield_stress = _felt_in(session)
    share = min(stress / yield_stress, 1.0) if yield_stress > 0.0 else 0.0
    text = "" if regime is None else f"{min(stress, yield_stress):.2f} N"
    return cursor.CursorState(
        *(pointer.position, pointer.normal, pointer.radius, DEFAULT_REACH * pointer.radius),
        *(regime or Regime.NONE, share, text),
    )


def _felt_in(session: Session) -> tuple[Regime | None, float, float]:
    """What the tool is in, with stress and yield stress in newtons; no regime where nothing is felt."""
    if session.engine is not None:
        contact = session.engine.contact
        return contact.regime, contact.stress, contact.yield_stress
    model = session.feeling.model if session.feeling is not None else None
    if model is None:
        return None, 0.0, 0.0
    return Regime.ELASTIC if model.stress > 0.0 else Regime.NONE, model.stress, model.yield_stress


_handle = None


def register():
    global _handle
    if bpy.app.background:
        return  # there is no toolbar
    bpy.utils.register_tool(RepousseTool, after={"builtin.transform"}, separator=True)
    _handle = bpy.types.SpaceView3D.draw_handler_add(_watch, (), "WINDOW", "PRE_VIEW")


def unregister():
    global _handle
    if _handle is None:
        return
    if bpy.app.timers.is_registered(synchronise):
        bpy.app.timers.unregister(synchronise)
    bpy.types.SpaceView3D.draw_handler_remove(_handle, "WINDOW")
    _handle = None
    bpy.utils.unregister_tool(RepousseTool)
