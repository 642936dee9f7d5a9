# SPDX-License-Identifier: GPL-3.0-or-later
"""The arm: connected or not, what it does and why it gives no force, the force it gives, and how its loop fares.

Drawing reads what the arm's session last saw; nothing here talks to the arm.
"""

from __future__ import annotations

from math import hypot, isfinite
from typing import TYPE_CHECKING

import bpy

from ..operators.arm_devices import (
    EMULATED,
    UNKNOWN,
    REPOUSSE_OT_arm_refresh,
    chosen,
    device_of,
    is_looking,
    preferences_of,
)
from ..operators.arm_session import arm, farewell
from ..operators.arm_verbs import (
    REPOUSSE_OT_arm_arm,
    REPOUSSE_OT_arm_clutch,
    REPOUSSE_OT_arm_connect,
    REPOUSSE_OT_arm_disarm,
    REPOUSSE_OT_arm_disconnect,
    REPOUSSE_OT_arm_home,
)
from .panel import InSidebar
from .preferences import STATES, RepoussePreferences, draw_use
from .words import draw_text

if TYPE_CHECKING:
    from ..device.haptic_loop import LoopHealth
    from ..device.protocol import ArmState
    from ..operators.arm_session import ArmSession

WARM = 0.8
"""Heat (0 to 1) from which it is said that force will be held back."""
LONG_AGO = 10.0
"""Age in seconds from which there is no model to speak of; before the first, it is the age of the clock."""
STATE_ICONS = ("UNLINKED", "LINKED", "HOME", "PAUSE", "PLAY", "CANCEL")
"""For each State, in its order."""


class REPOUSSE_PT_arm(InSidebar, bpy.types.Panel):
    bl_label = "Arm"
    bl_order = 1
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header_preset(self, _context):
        show = self.layout.operator("preferences.addon_show", text="", icon="PREFERENCES", emboss=False)
        show.module = RepoussePreferences.bl_idname

    def draw(self, context):
        layout = self.layout
        session = arm()
        if session is None:
            _draw_choice(layout, context)
        else:
            _draw_arm(layout, context, session)
        use = layout.column()
        use.use_property_split = True
        use.use_property_decorate = False
        draw_use(use, preferences_of(context))


def _draw_choice(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What would be connected to, why it cannot be, and why the last one is connected no more."""
    say = bpy.app.translations.pgettext_iface
    preferences = preferences_of(context)
    device = device_of(preferences.device)
    word, icon = STATES[device.state]
    name = say("Emulated Arm") if device.state == EMULATED else f"{device.name}: {say(word)}"
    layout.label(text=name, icon=icon, translate=False)
    if is_looking():
        layout.label(text="Looking for arms", icon="SORTTIME")
    elif device.state == UNKNOWN:
        layout.operator(REPOUSSE_OT_arm_refresh.bl_idname, icon="FILE_REFRESH")
    layout.prop(preferences, "profile", text="")
    try:
        chosen(preferences)
    except ValueError as error:
        draw_text(layout, context, str(error), icon="ERROR")
    else:
        layout.operator(REPOUSSE_OT_arm_connect.bl_idname, icon="LINKED")
    if farewell():
        draw_text(layout, context, say(farewell()), icon="ERROR")


def _draw_arm(layout: bpy.types.UILayout, context: bpy.types.Context, session: ArmSession) -> None:
    """The arm that is connected: its state, what can be done, its force and heat."""
    from ..device.fault import State, fault_text, state_text

    say = bpy.app.translations.pgettext_iface
    state = session.state
    head = layout.row(align=True)
    head.label(text=session.profile.name, translate=False)
    head.operator(REPOUSSE_OT_arm_disconnect.bl_idname, text="", icon="UNLINKED")
    draw_text(layout, context, say(state_text(state.state)), icon=STATE_ICONS[state.state])
    for reason in (fault_text(state.fault), session.message):
        if reason:
            draw_text(layout, context, say(reason), icon="ERROR")
    if state.state in (State.OPEN, State.SAFE) and session.profile.home_pose:
        text = say("Home pose: {}").format(say(session.profile.home_pose))
        draw_text(layout, context, text, icon="HOME")
    work = layout.row(align=True)
    work.operator(REPOUSSE_OT_arm_home.bl_idname, icon="HOME")
    if state.state in (State.ARMED, State.RUN):
        work.operator(REPOUSSE_OT_arm_disarm.bl_idname, icon="PAUSE")
    else:
        work.operator(REPOUSSE_OT_arm_arm.bl_idname, icon="PLAY")
    layout.operator(REPOUSSE_OT_arm_clutch.bl_idname, icon="VIEW_PAN", depress=session.clutched)
    _draw_force(layout.column(align=True), context, session, state)


def _draw_force(column: bpy.types.UILayout, context: bpy.types.Context, session: ArmSession, state: ArmState) -> None:
    """The force as a bar, of the most that is allowed now and why that is; and how warm the motors are."""
    from ..device.fault import State
    from ..device.limits import limits_of

    say = bpy.app.translations.pgettext_iface
    limits = limits_of(session.profile, session.loop.link, preferences_of(context).force_scale)
    force, most = hypot(*state.force), limits.max_force
    share = min(force / most, 1.0) if most > 0.0 and isfinite(force) else 0.0
    column.progress(text=say("{:.2f} of {:.2f} N").format(force, most), factor=share, translate=False)
    if state.state == State.RUN and state.ramp < 1.0:
        column.label(text=say("Force comes in: {:.0%}").format(state.ramp), translate=False)
    if limits.reason:
        draw_text(column, context, say(limits.reason), icon="INFO")
    heat = min(max(state.heat, 0.0), 1.0)
    column.progress(text=say("Motor heat {:.0%}").format(heat), factor=heat, translate=False)
    if heat >= WARM:
        draw_text(column, context, say("The motors are warm: force is held back until they cool"), icon="ERROR")


class REPOUSSE_PT_arm_loop(InSidebar, bpy.types.Panel):
    bl_label = "Loop"
    bl_parent_id = "REPOUSSE_PT_arm"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, _context):
        return arm() is not None

    def draw(self, _context):
        session = arm()
        column = self.layout.column(align=True)
        for line in (*health_lines(session.health), *model_lines(session.state)):
            column.label(text=line, translate=False)


def health_lines(health: LoopHealth) -> list[str]:
    """How the loop fares, a line each, short enough for a sidebar."""
    say = bpy.app.translations.pgettext_iface
    figures, period, work = health.figures, (1e3 * t for t in health.period), (1e6 * t for t in health.work)
    return [
        say("{:.0f} periods a second").format(figures.rate),
        say("In real time") if figures.realtime else say("Not in real time: other programs may hold it up"),
        say("Period {:.2f} ms, p99 {:.2f}, p99.9 {:.2f}").format(*period),
        say("Longest gap {:.2f} ms").format(1e3 * figures.longest),
        say("Work {:.0f} µs, p99 {:.0f}, p99.9 {:.0f}").format(*work),
        say("Reports lost {}, overtaken {}").format(figures.lost, figures.superseded),
    ]


def model_lines(state: ArmState) -> list[str]:
    """What the loop makes of what it is told: how old that is, and how stiff it may be."""
    say = bpy.app.translations.pgettext_iface
    return [
        say("Model {:.0f} ms old").format(1e3 * state.model_age) if state.model_age < LONG_AGO else say("No model"),
        say("Stiffness {:.0f} of {:.0f} N/m").format(state.slope_granted, state.slope_asked),
    ]


_CLASSES = (REPOUSSE_PT_arm, REPOUSSE_PT_arm_loop)


def register():
    for made in _CLASSES:
        bpy.utils.register_class(made)


def unregister():
    for made in reversed(_CLASSES):
        bpy.utils.unregister_class(made)
