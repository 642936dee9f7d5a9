# SPDX-License-Identifier: GPL-3.0-or-later
"""The arm that is connected: its loop, where its workspace lies, and what is felt through it. At most one.

A timer looks at it sixty times a second. Between strokes an engine that only feels lets the surface be felt; when the
stylus is pressed, Sculpt is invoked as the mouse invokes it, with the arm in the mouse's place. Each engine's hand
carries the number of its scene: the same from a stroke to the next, another when anything but the arm's own stroke has
changed what is there, and the loop then lets force in again only from little, slowly.

Nothing here waits for the arm, whose loop is another process.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..core import Push
from ..core.engine import Engine
from ..core.surface import Hit
from ..core.tool import Vector
from ..device.fault import State, fault_text
from .aim import Pointer, voxels_to_world
from .arm_hand import ENGAGED, SECOND, STYLUS, ArmHand, Line, StrokeHand, is_posed
from .arm_place import Place, View, place_of, view_of
from .session import Session, live

if TYPE_CHECKING:
    from ..core.local_model import LocalModel
    from ..core.stroke import Sample
    from ..device import DeviceProfile, HapticLoop
    from ..device.haptic_loop import LoopHealth
    from ..device.protocol import ArmState
    from .arm_mapping import ArmMapping

TICK = 1.0 / 60.0
"""Seconds between looks at the arm."""
PANEL_LOOKS = 6
"""Looks between two drawings of the sidebars, which show its force."""
LINGER = 0.25
"""Seconds out of contact after which a stroke by touch ends."""
TOUCH = 1e-3
"""Newtons of stress that are a touch."""
ROOT = __package__.rpartition(".")[0]
"""What Blender knows this extension by."""


@dataclass(frozen=True)
class ArmSettings:
    """What the preferences say that holds while an arm is connected.

    ``workspace_scale``: the part of the view, or of the object, that its reach spans; ``axes``: "VIEW" or "OBJECT";
    ``force_scale`` from 0 to 1; ``stroke_on``: "BUTTON" or "TOUCH"; ``emulated_script``: a file, or "".
    """

    workspace_scale: float = 1.0
    axes: str = "VIEW"
    force_scale: float = 1.0
    stroke_on: str = "BUTTON"
    emulated_script: str = ""


def arm_settings(context: bpy.types.Context) -> ArmSettings:
    """The preferences of the arm; the defaults where there are none."""
    addon = context.preferences.addons.get(ROOT)
    told = addon.preferences if addon is not None else None
    return ArmSettings(**{field.name: getattr(told, field.name, field.default) for field in fields(ArmSettings)})


_arm: ArmSession | None = None
_farewell = ""


def arm() -> ArmSession | None:
    """The arm that is connected, if there is one."""
    return _arm


def farewell() -> str:
    """Why the last arm is connected no more, in one line; empty when it was asked to go, and while one is there."""
    return _farewell


def is_stroking() -> bool:
    """Whether the stroke that runs is the arm's."""
    session = live()
    stroke = _arm._stroke if _arm is not None else None
    return session is not None and stroke is not None and stroke.engine is session.engine is not None


def open_arm(loop: HapticLoop, profile: DeviceProfile) -> ArmSession:
    """Start the loop of an arm, in place of the one that may be connected.

    Raises RuntimeError or OSError with one line where it cannot be started.
    """
    global _arm, _farewell
    close_arm()
    _farewell = ""
    loop.start()
    _arm = ArmSession(loop, profile)
    if not bpy.app.timers.is_registered(watch):
        bpy.app.timers.register(watch, first_interval=TICK)
    return _arm


def close_arm(why: str = "") -> None:
    """End the loop and all that feels through it. A stroke of the arm ends as if the button were released."""
    global _arm, _farewell
    if bpy.app.timers.is_registered(watch):
        bpy.app.timers.unregister(watch)
    former, _arm = _arm, None
    if former is not None:
        _farewell = why
        former.end(why)


def quieten() -> None:
    """What is felt between strokes is felt no more from here on, for Blender is about to change it."""
    if _arm is not None:
        _arm.rest()


def feel_on(session: Session, obj: bpy.types.Object) -> None:
    """After a stroke of the arm on ``obj``: see :meth:`ArmSession.feel_on`."""
    if _arm is not None:
        _arm.feel_on(session, voxels_to_world(obj, session))


def watch() -> float | None:
    """The timer. Whatever fails lets the arm go: no process and no thread may be left that nobody looks at."""
    if _arm is None:
        return None
    try:
        _arm.look()
    except GoneError as error:
        close_arm(str(error))
    except Exception as error:
        close_arm(f"The arm was disconnected: {error}")
    if _arm is None:
        _redraw("UI", "WINDOW")
        return None
    return TICK


class GoneError(RuntimeError):
    """The arm's loop has ended; the text is one line."""


class ArmSession:
    """One arm.

    Attributes
    ----------
    loop, profile
        Its subprocess, and what it is.
    scene
        Number of what is felt now.
    clutched
        Whether the clutch is held: the arm moves, the tool does not.
    message
        Why nothing can be felt or pushed, one line; else empty.
    """

    def __init__(self, loop: HapticLoop, profile: DeviceProfile) -> None:
        self.loop, self.profile = loop, profile
        self.scene = 0
        self.clutched = False
        self.message = ""
        self._line = Line(loop)
        self._stroke: ArmStroke | None = None
        self._place: Place | None = None  # as the last look found it
        self._felt: Place | None = None  # what the scene's number stands for
        self._hollow: Place | None = None  # where there was nothing to feel
        self._pressed = True  # at the last look: a button that is held already begins nothing
        self._silent = True  # the loop knows that there is nothing to be felt
        self._pointer: Pointer | None = None
        self._shift: Vector = (0.0, 0.0, 0.0)
        self._held_at: Vector = (0.0, 0.0, 0.0)  # where the tool is while the clutch is held, as a place of the arm
        self._second = False  # the second button, at the last look
        self._force_scale = 1.0
        self._looks = 0

    @property
    def state(self) -> ArmState:
        """The newest that is known of the arm."""
        return self._line.state()

    @property
    def health(self) -> LoopHealth:
        """How its loop fares."""
        return self.loop.health()

    @property
    def has_pointer(self) -> bool:
        """Whether the cursor is the arm's, not the mouse's."""
        return self._pointer is not None

    def look(self) -> None:
        """Once in a while: see that the right thing is felt, follow the tool, and begin a stroke when one is wanted.

        Raises GoneError when the loop has ended.
        """
        if not self.loop.running:
            raise GoneError(self.loop.failure or "The arm's loop has ended: connect again")
        state, wanted, session = self.state, arm_settings(bpy.context), live()
        self._scale_force(wanted.force_scale)
        self._ask_second_button(state)
        self._looks += 1
        if self._looks % PANEL_LOOKS == 0:
            _redraw("UI")
        if session is not None and session.engine is not None:
            self._look_at_stroke(session)
            return
        self._stroke = None
        view = view_of(bpy.context, session) if session is not None else None
        if self.clutched and view is not None:
            self.rest()
        elif view is None or not is_posed(state):
            self.rest()
            self._felt = None  # nobody knows what comes next
            self._point(session, None)
        else:
            self._look_around(session, view, wanted, state)

    def _look_at_stroke(self, session: Session) -> None:
        """The arm's own stroke lets it feel; that of the mouse changes what would be felt, so nothing is."""
        self._pressed = True
        if self._stroke is not None and self._stroke.engine is session.engine:
            self._silent = False
            self._stroke.look()
            return
        self.rest()
        self._felt = self._pointer = None

    def _look_around(self, session: Session, view: View, wanted: ArmSettings, state: ArmState) -> None:
        """Between strokes: feel what is there, once that is the same for two looks. On the way to another view or
        radius nothing is felt."""
        settings = bpy.context.scene.repousse
        try:
            place = place_of(view, session, settings, wanted, self.profile, self._shift, self._place)
            to_world = voxels_to_world(view.obj, session)
            mapping = place.mapping(self.profile, to_world)
        except ValueError as error:
            self.message = str(error)
            self.rest()
            self._place = self._felt = None
            self._point(session, None)
            return
        steady, self._place = place == self._place, place
        if not steady:
            self.rest()
        elif session.feeling is None and place != self._hollow:
            self._feel(session, place, mapping, to_world)
        feeling = session.feeling
        if feeling is not None and feeling.failure is not None:
            raise RuntimeError(feeling.failure) from feeling.failure
        model = feeling.model if feeling is not None else None
        hit = _hit(mapping.position(state.position), model, mapping)
        self._point(session, Pointer.at(hit, place.radius_in(to_world), to_world))
        pressed = self._is_pressed(state, wanted, model)
        begins, self._pressed = pressed and not self._pressed, pressed
        if begins and feeling is not None and state.state in ENGAGED:
            self._begin(view)

    def _feel(self, session: Session, place: Place, mapping: ArmMapping, to_world: np.ndarray) -> None:
        """Let the arm feel the volume as it is."""
        if place != self._felt:
            self.scene, self._felt = self.scene + 1, place
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # it is said when a stroke begins
                push = Push(session.grid, place.tool_in(to_world), place.material)
        except (ValueError, MemoryError) as error:
            self.message, self._hollow = str(error) or "There is not enough memory to feel this volume", place
            return
        engine = Engine(push, hand=ArmHand(self._line, mapping, self.scene, time.perf_counter()), deform=False)
        session.feeling = engine
        engine.start()
        self.message, self._hollow, self._silent = "", None, False

    def rest(self) -> None:
        """Let nothing be felt, and a button that is held begin nothing."""
        session = live()
        if session is not None:
            session.feeling = None  # first, for its hand would tell the loop otherwise
        self._pressed = True
        if not self._silent:
            self._line.send_nothing()
            self._silent = True

    def _is_pressed(self, state: ArmState, wanted: ArmSettings, model: LocalModel | None) -> bool:
        """Whether the user wants to push: the stylus is pressed or, by touch, force is felt."""
        if not self._is_by_touch(wanted):
            return bool(state.buttons & STYLUS)
        return state.state == State.RUN and model is not None and model.stress > TOUCH

    def _is_by_touch(self, wanted: ArmSettings) -> bool:
        return wanted.stroke_on == "TOUCH" or not self.profile.buttons

    def _begin(self, view: View) -> None:
        """Begin a stroke, as the mouse does."""
        try:
            with bpy.context.temp_override(window=view.window, area=view.area, region=view.region):
                bpy.ops.repousse.sculpt("INVOKE_DEFAULT", verb="push", arm=True)
        except RuntimeError as error:  # what an operator reports as an error
            self.message = str(error).strip().removeprefix("Error: ")

    def take_up(self, session: Session, to_world: np.ndarray) -> ArmStroke:
        """What moves the tool of a stroke that begins. Raises ValueError with one line where the arm cannot."""
        state = self.state
        if self._place is None or self._felt != self._place or state.state not in ENGAGED or self.clutched:
            raise ValueError("The arm is not ready: home it, arm it and let go of the clutch")
        by_touch = self._is_by_touch(arm_settings(bpy.context))
        mapping = self._place.mapping(self.profile, to_world)
        hand = StrokeHand(self._line, mapping, self.scene, time.perf_counter(), by_touch)
        self._stroke = ArmStroke(hand, self._place.radius_in(to_world))
        return self._stroke

    def feel_on(self, session: Session, to_world: np.ndarray) -> None:
        """The arm's stroke is solved: let it feel what that has left, while it is still to be written to its file."""
        place = self._place
        if place is not None and place == self._felt and not self.clutched and is_posed(self.state):
            self._feel(session, place, place.mapping(self.profile, to_world), to_world)

    def set_clutch(self, held: bool) -> None:
        """Hold the clutch, or let it go: meanwhile the arm is moved and the tool stays. A stroke ends.

        Raises ValueError with one line while it is not known where the arm is.
        """
        state = self.state
        if held == self.clutched:
            return
        if held and not is_posed(state):
            raise ValueError("Home the arm first: it is not known where it is")
        self.rest()
        if held:
            if self._stroke is not None:
                self._stroke.hand.let_go()
            self._held_at = _sum(state.position, self._shift)
        elif is_posed(state):
            self._shift = _sum(self._held_at, state.position, -1.0)
        self.clutched, self._felt = held, None
        self.loop.set_clutch(held)

    def _ask_second_button(self, state: ArmState) -> None:
        """Where there is one it is the clutch."""
        second = self.profile.buttons > 1 and bool(state.buttons & SECOND)
        if second != self._second and (is_posed(state) or not second):
            self.set_clutch(second)
        self._second = second

    def _scale_force(self, scale: float) -> None:
        if scale != self._force_scale:
            self.loop.set_force_scale(scale)
            self._force_scale = scale

    def _point(self, session: Session | None, pointer: Pointer | None) -> None:
        """Show the cursor there; None leaves it to the mouse."""
        if session is not None and (pointer, session.pointer) != (self._pointer, pointer):
            session.pointer = pointer
            _redraw("WINDOW")
        self._pointer = pointer

    def end(self, why: str) -> None:
        """End its loop and all that feels through it; ``why`` is told by the stroke that may run."""
        try:
            if self._stroke is not None:
                self._stroke.lose(why) if why else self._stroke.hand.let_go()
            self.rest()
            self._point(live(), None)
        finally:
            self._line.cut()
            self.loop.stop()


class ArmStroke:
    """What moves the tool of a stroke in the place of a Guide, whose methods it has: its poses go another way.

    Attributes
    ----------
    hand
        Of the stroke's engine.
    engine
        That one, once it is known.
    radius
        Of the tool, in voxels.
    """

    def __init__(self, hand: StrokeHand, radius: float) -> None:
        self.hand, self.radius = hand, radius
        self.engine: Engine | None = None
        self._why = ""
        self._touched = time.perf_counter()

    def attach(self, engine: Engine) -> None:
        """The engine whose hand this is, before it is started."""
        self.engine, self.hand.release = engine, engine.release

    @property
    def over(self) -> bool:
        """Whether the button is up, or the arm gone."""
        return self.hand.over

    @property
    def trouble(self) -> str:
        """Why the arm has let go, in one line; empty where its user did."""
        if not self.hand.lost:
            return ""
        return self._why or fault_text(self.hand.line.state().fault) or "The arm has stopped"

    @property
    def hit(self) -> Hit | None:
        """Where the tool is, in voxels."""
        model = self.engine.model if self.engine is not None else None
        return None if model is None else _hit(model.position, model, self.hand.mapping)

    def begin(self, *_: float) -> list[Sample]:
        """The engine has the poses from its hand: none are fed."""
        return []

    hold = begin

    def look(self) -> None:
        """By touch, a stroke ends when nothing has been touched for a while."""
        model, now = self.engine.model, time.perf_counter()
        if model is not None and model.stress > TOUCH:
            self._touched = now
        elif self.hand.by_touch and now - self._touched > LINGER:
            self.hand.let_go()

    def lose(self, why: str) -> None:
        """The arm is gone."""
        self._why = why
        self.hand.let_go(lost=True)


def _hit(position: Vector, model: LocalModel | None, mapping: ArmMapping) -> Hit:
    """A place of the tool with the way out of the material there; where that is not known, towards the user."""
    if model is not None and any(model.normal):
        return Hit(position, model.normal)
    return Hit(position, mapping.towards_user)


def _sum(one: Vector, other: Vector, share: float = 1.0) -> Vector:
    """``one`` and a share of the other."""
    return one[0] + share * other[0], one[1] + share * other[1], one[2] + share * other[2]


def _redraw(*kinds: str) -> None:
    """Have these regions of all 3D views drawn anew."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type in kinds:
                        region.tag_redraw()


def register():
    pass


def unregister():
    close_arm()
