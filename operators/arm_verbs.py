# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user tells the arm: to connect, where its home is, to give force or not, to hold the tool still, to go."""

from __future__ import annotations

import bpy

from ..device.fault import State
from .arm_devices import chosen, preferences_of
from .arm_session import arm, arm_settings, close_arm, open_arm


class REPOUSSE_OT_arm_connect(bpy.types.Operator):
    bl_idname = "repousse.arm_connect"
    bl_label = "Connect Arm"
    bl_description = "Open the arm that is chosen in the preferences. Its motors stay off until you arm it"

    @classmethod
    def poll(cls, _context):
        if arm() is not None:
            cls.poll_message_set("An arm is connected: disconnect it first")
            return False
        return True

    def execute(self, context):
        from ..device import HapticLoop

        try:
            profile, link, path = chosen(preferences_of(context))
            script = bpy.path.abspath(arm_settings(context).emulated_script)
            open_arm(HapticLoop(profile, link, path, script or None), profile)
        except (ValueError, RuntimeError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class OnArm:
    """What the orders have in common: an arm is connected, and in one of ``states`` unless that is None."""

    states: frozenset[State] | None = None
    hint = ""

    @classmethod
    def poll(cls, _context):
        if arm() is None:
            cls.poll_message_set("Connect the arm first")
            return False
        if cls.states is not None and arm().state.state not in cls.states:
            cls.poll_message_set(cls.hint)
            return False
        return True


class REPOUSSE_OT_arm_disconnect(OnArm, bpy.types.Operator):
    bl_idname = "repousse.arm_disconnect"
    bl_label = "Disconnect Arm"
    bl_description = "Switch the arm's motors off and let it go. A stroke that it is making ends and is kept"

    def execute(self, _context):
        close_arm()
        return {"FINISHED"}


class REPOUSSE_OT_arm_home(OnArm, bpy.types.Operator):
    bl_idname = "repousse.arm_home"
    bl_label = "Home"
    bl_description = "The arm rests in its home pose now: count its encoders from there. No force is given"

    states = frozenset({State.OPEN, State.HOMED, State.SAFE})
    hint = "Connect the arm and disarm it: it is homed while it gives no force"

    def execute(self, _context):
        arm().loop.home()
        return {"FINISHED"}


class REPOUSSE_OT_arm_arm(OnArm, bpy.types.Operator):
    bl_idname = "repousse.arm_arm"
    bl_label = "Arm"
    bl_description = "Let the arm give force. It begins outside of the material, and rises slowly"

    states = frozenset({State.HOMED})
    hint = "Home the arm first"

    def execute(self, _context):
        arm().loop.arm()
        return {"FINISHED"}


class REPOUSSE_OT_arm_disarm(OnArm, bpy.types.Operator):
    bl_idname = "repousse.arm_disarm"
    bl_label = "Disarm"
    bl_description = "No force any more. The arm stays homed, and still moves the cursor"

    def execute(self, _context):
        arm().loop.disarm()
        return {"FINISHED"}


class REPOUSSE_OT_arm_clutch(OnArm, bpy.types.Operator):
    bl_idname = "repousse.arm_clutch"
    bl_label = "Clutch"
    bl_description = "Hold the tool where it is while you move the arm back; press again to go on from there"

    def execute(self, _context):
        try:
            arm().set_clutch(not arm().clutched)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


_CLASSES = (
    REPOUSSE_OT_arm_connect,
    REPOUSSE_OT_arm_disconnect,
    REPOUSSE_OT_arm_home,
    REPOUSSE_OT_arm_arm,
    REPOUSSE_OT_arm_disarm,
    REPOUSSE_OT_arm_clutch,
)


def register():
    for made in _CLASSES:
        bpy.utils.register_class(made)


def unregister():
    for made in reversed(_CLASSES):
        bpy.utils.unregister_class(made)
