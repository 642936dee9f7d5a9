# SPDX-License-Identifier: GPL-3.0-or-later
"""Sculpt: push, pull or smooth the active volume under the mouse or pen, from press to release one stroke."""

from __future__ import annotations

import time
import warnings

import bpy
import numpy as np

from ..core import Contact, SphereTool, Stroke
from ..core.engine import Engine
from ..core.guide import Brush, Guide
from ..core.surface import Surface
from ..core.tool import DEFAULT_REACH, vector
from . import arm_session, strokes
from .aim import Aim, Pointer, brush_radius, voxels_to_world
from .arm_session import ArmStroke
from .automatic_level import level_of
from .session import Session, end_stroke, in_array, live, open_session
from .settings import RepousseSettings
from .volumes import OnActiveVolume, active_volume

TICK = 1.0 / 60.0
"""Seconds between looks at what the engine has done."""
PATIENCE = 0.05
"""Seconds for which the release of the button waits for the last poses to be solved before it looks again later."""

VERBS = [
    ("push", "Push", "Push material out of the tool's way"),
    ("pull", "Pull", "Pull material back towards the viewer"),
    ("smooth", "Smooth", "Even the surface out; no mass is lost"),
]


class REPOUSSE_OT_sculpt(OnActiveVolume, bpy.types.Operator):
    bl_idname = "repousse.sculpt"
    bl_label = "Sculpt Volume"
    bl_description = "Push, pull or smooth the active volume while the button is held"
    bl_options = {"UNDO", "BLOCKING"}

    verb: bpy.props.EnumProperty(name="Verb", description="What the tool does to the material", items=VERBS)
    arm: bpy.props.BoolProperty(
        name="Arm", description="The arm moves the tool, in the place of the mouse", options={"HIDDEN", "SKIP_SAVE"}
    )

    def invoke(self, context, event):
        if context.region is None or context.region_data is None:
            self.report({"ERROR"}, "Sculpt in a 3D view")
            return {"CANCELLED"}
        obj, settings = active_volume(context), context.scene.repousse
        try:
            session = open_session(obj)
            if session.engine is not None:
                return {"CANCELLED"}  # one stroke at a time
            self._begin(context, event, obj, session, settings)
        except (ValueError, MemoryError) as error:
            end_stroke()
            self.report({"ERROR"}, str(error) or "There is not enough memory for a stroke in this volume")
            return {"CANCELLED"}
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(_status)
        return {"RUNNING_MODAL"}

    def _begin(self, context, event, obj, session, settings):
        to_world = voxels_to_world(obj, session)
        held = _arm_of(session, to_world) if self.arm else None
        aim = Aim.of(context.region, context.region_data, to_world)
        x, y = event.mouse_region_x, event.mouse_region_y
        level = level_of(obj.data)
        if held is not None:
            radius = held.radius
        else:
            hit = Surface(session.grid, level).hit(*aim.ray(x, y))
            middle = vector((n - 1) / 2.0 for n in session.grid.shape)
            radius = brush_radius(aim, settings, hit.position if hit else middle)
        self._stroke = _stroke_of(settings, self.verb, radius, session)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            push = self._stroke.push(session.grid)
        for warning in told:
            self.report({"WARNING"}, str(warning.message))
        if settings.record:
            self._stroke.grid_hash = session.grid_hash()
        if held is not None:
            engine = Engine(push, hand=held.hand, quality=settings.chosen_quality)
            held.attach(engine)
            self._guide = held
        else:
            engine = Engine(push, quality=settings.chosen_quality)
            brush = _brush_of(settings, self.verb, radius)
            self._guide = Guide(Surface(session.grid, level, engine.history), brush, aim.ray)
        self._volume, self._to_world = obj.data.session_uid, to_world
        self._engine, self._began, self._shown, self._released = engine, time.perf_counter(), None, False
        session.feeling = None
        engine.start()
        session.engine = engine
        self._feed(self._guide.begin(x, y, event.pressure, 0.0))

    def modal(self, context, event):
        session = live()
        if session is None or session.engine is not self._engine or context.area is None:
            return self._leave(context)  # undo, a file, or the add-on's end has ended the stroke
        try:
            if self._engine.failure is not None:
                raise self._engine.failure
            return self._on(context, event, session)
        except Exception as error:  # whatever it is, no thread and no half stroke may outlive it
            if session.engine is None:
                self.report({"WARNING"}, f"The stroke was not recorded: {error}")
                return {"FINISHED"}
            self.report({"ERROR"}, f"The stroke was taken back: {error}")
            return self._take_back(context, session)

    def _on(self, context, event, session):
        """One event of a stroke that runs."""
        if event.value == "PRESS" and event.type in {"ESC", "RIGHTMOUSE"}:
            return self._take_back(context, session)
        if not self._released and self._is_let_go(event):
            self._released = True
            self._engine.release()
            self._engine.settle(PATIENCE)
        elif event.type in {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE"} and not (self._released or self.arm):
            x, y = event.mouse_region_x, event.mouse_region_y
            self._feed(self._guide.move(x, y, event.pressure, self._time))
            context.area.tag_redraw()
        elif event.type == "TIMER" and not self._released:
            self._feed(self._guide.hold(self._time))
        if self._released and self._engine.settle(0.0):
            return self._commit(context, session)
        if self._engine.contact is not self._shown:
            self._shown = self._engine.contact
            context.area.tag_redraw()
            context.workspace.status_text_set(_status)  # its bar is drawn again for this alone
        return {"RUNNING_MODAL"}

    def _is_let_go(self, event) -> bool:
        """Whether this is the end of the stroke."""
        return self._guide.over if self.arm else event.type == "LEFTMOUSE" and event.value == "RELEASE"

    def cancel(self, context):
        """Blender's own call when a file is loaded or a window is closed under the stroke."""
        session = live()
        if session is not None and session.engine is self._engine:
            self._take_back(context, session)
        else:
            self._leave(context)

    @property
    def _time(self) -> float:
        return time.perf_counter() - self._began

    def _feed(self, samples) -> None:
        for sample in samples:
            self._engine.feed(sample)
        session, hit = live(), self._guide.hit
        if session is not None and hit is not None:
            session.pointer = Pointer.at(hit, self._guide.radius, self._to_world)

    def _commit(self, context, session):
        """The button is up and all is solved: the next revision of the volume, and one step of undo."""
        engine, obj = self._engine, active_volume(context)
        samples = engine.finish()
        boxes = [in_array(box, engine.push.origin) for box in engine.touched]
        if self.arm and self._guide.trouble:
            self.report({"WARNING"}, self._guide.trouble)
        if not boxes:
            session.engine = None
            return self._leave(context)
        if obj is None or obj.data.session_uid != self._volume:
            return self._take_back(context, session)
        if self.arm:
            arm_session.feel_on(session, obj)
        session.commit(obj, boxes, engine.mass_out)
        session.last_trace, session.last_choice = engine.trace, engine.choice
        session.engine, stroke = None, self._stroke
        self._leave(context)
        if context.scene.repousse.record:
            stroke.samples = samples
            strokes.keep(stroke, obj.data)
        return {"FINISHED"}

    def _take_back(self, context, session):
        """Every voxel as it was before the stroke."""
        engine, session.feeling = self._engine, None
        engine.cancel()
        if engine.touched:  # it had been finished: what has failed is the commit
            engine.push.restore(engine.history)
        session.changed(None)
        session.engine = None
        return self._leave(context)

    def _leave(self, context):
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        if context.area is not None:
            context.area.tag_redraw()
        self._engine = self._guide = self._stroke = self._shown = None  # Blender keeps what made a step of undo
        return {"CANCELLED"}


def _arm_of(session: Session, to_world: np.ndarray) -> ArmStroke:
    """What the arm moves the tool with. Raises ValueError where none is connected, or it is not ready."""
    arm = arm_session.arm()
    if arm is None:
        raise ValueError("No arm is connected")
    return arm.take_up(session, to_world)


def _brush_of(settings: RepousseSettings, verb: str, radius: float) -> Brush:
    """What the mouse does with the tool."""
    return Brush(
        radius=radius,
        strength=settings.strength,
        verb=verb,
        press=settings.press,
        drill=settings.drill,
        spacing=settings.spacing / 100.0,
        stabiliser=float(settings.stabiliser),
        pressure_radius=settings.pressure_radius,
        pressure_strength=settings.pressure_strength,
    )


def _stroke_of(settings: RepousseSettings, verb: str, radius: float, session: Session) -> Stroke:
    """The header of the stroke that begins: what replays it to the same voxels."""
    axes = settings.mirror_axes
    to_index = np.linalg.inv(session.grid.transform)
    return Stroke(
        tool=SphereTool(radius, DEFAULT_REACH * radius),
        material=settings.clay,
        method=settings.method,
        border=settings.border,
        band=settings.band * radius if settings.use_band and verb == "push" else None,
        verb=verb,
        symmetry=axes,
        mirror=vector(to_index[:3, 3]) if axes else None,
        voxel_size=session.grid.voxel_size,
    )


def _status(header: bpy.types.Header, _context: bpy.types.Context) -> None:
    """The status bar while a stroke runs."""
    layout = header.layout
    if arm_session.is_stroking():
        layout.label(text="Release the stylus to finish")
    else:
        layout.label(text="Finish", icon="MOUSE_LMB")
    layout.label(text="Cancel", icon="MOUSE_RMB")
    layout.label(text="Cancel", icon="EVENT_ESC")
    session = live()
    if session is None or session.engine is None:
        return
    contact: Contact = session.engine.contact
    say = bpy.app.translations.pgettext_iface
    layout.separator_spacer()
    layout.label(
        text=say("{}   stress {:.2f} N   yields at {:.2f} N").format(
            say(contact.regime.value.capitalize()), contact.stress, contact.yield_stress
        ),
        translate=False,
    )


def register():
    bpy.utils.register_class(REPOUSSE_OT_sculpt)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_OT_sculpt)
