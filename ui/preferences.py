# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's preferences: which arm, what it is, how its workspace lies in the scene, and how strongly it pushes.

Drawing reads properties and what the last look for arms found: no process is started, no device opened.
"""

from __future__ import annotations

import zlib

import bpy

from ..operators.arm_devices import (
    EMULATED,
    EMULATED_DEVICE,
    NO_PERMISSION,
    READY,
    RULES_FILE,
    UNKNOWN,
    VENDOR_DRIVER,
    Device,
    REPOUSSE_OT_arm_choose,
    REPOUSSE_OT_arm_copy_rule,
    REPOUSSE_OT_arm_refresh,
    catalogue,
    chosen,
    device_of,
    is_looking,
    listing,
    profiles_folder,
    rule_of,
)
from .words import draw_text

DEFAULT_PROFILE = "phantom-premium-1.5"
STATES = {
    READY: ("Ready", "CHECKMARK"),
    NO_PERMISSION: ("No permission", "LOCKED"),
    VENDOR_DRIVER: ("Vendor's driver needed", "CANCEL"),
    EMULATED: ("Emulated", "GHOST_ENABLED"),
    UNKNOWN: ("Not seen", "QUESTION"),
}
"""The word and the icon for each state of a device."""


def _number_of(key: str) -> int:
    """What Blender keeps for a profile: the same whichever others there are."""
    return zlib.crc32(key.encode()) >> 1


_items: list[tuple[str, str, str, str, int]] = []  # Blender needs somebody to hold the strings of a list made by a call


def _profile_items(_preferences, _context) -> list[tuple[str, str, str, str, int]]:
    _items[:] = [
        (key, profile.name, profile.source, "NONE", _number_of(key)) for key, profile in catalogue().profiles.items()
    ]
    return _items


class RepoussePreferences(bpy.types.AddonPreferences):
    bl_idname = __package__.rpartition(".")[0]

    device: bpy.props.StringProperty(
        name="Arm", description="Identifier of the arm that is connected to", default=EMULATED_DEVICE
    )
    profile: bpy.props.EnumProperty(
        name="Profile",
        description="What the arm is: lengths, motors, encoders and limits. A wrong one makes wrong forces",
        items=_profile_items,
        default=_number_of(DEFAULT_PROFILE),
    )
    workspace_scale: bpy.props.FloatProperty(
        name="Workspace",
        description="Part of the view, or of the object, that the arm's reach spans, from 0.05 to 10: 1 is all of it",
        default=1.0,
        min=0.05,
        soft_min=0.25,
        soft_max=2.0,
        max=10.0,
        precision=2,
    )
    axes: bpy.props.EnumProperty(
        name="Axes",
        description="What moving the arm is relative to",
        items=[
            ("VIEW", "View", "Towards you is towards the viewer, as the view was when the arm was engaged"),
            ("OBJECT", "Object", "Along the axes of the volume's object, wherever it is looked at from"),
        ],
        default="VIEW",
    )
    force_scale: bpy.props.FloatProperty(
        name="Force",
        description="Part of the profile's largest force that the arm may push with, from 0 to 1",
        default=1.0,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
    )
    stroke_on: bpy.props.EnumProperty(
        name="Stroke",
        description="When a stroke begins and ends",
        items=[
            ("BUTTON", "Button", "While the stylus button is held; without it the arm only feels"),
            ("TOUCH", "Touch", "While the tool touches material: for an arm without a button"),
        ],
        default="BUTTON",
    )
    emulated_script: bpy.props.StringProperty(
        name="Hand",
        description="File of JSON lines with what the emulated arm's hand does; empty: a short demonstration",
        subtype="FILE_PATH",
    )

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        _draw_devices(layout, context, self)
        layout.prop(self, "profile")
        _draw_what_to_do(layout, context, self)
        if self.device == EMULATED_DEVICE:
            layout.prop(self, "emulated_script")
        draw_use(layout, self)
        _draw_own_profiles(layout.column(align=True), context)


def draw_use(layout: bpy.types.UILayout, preferences: RepoussePreferences) -> None:
    """What is set while working with the arm."""
    layout.prop(preferences, "force_scale", slider=True)
    layout.prop(preferences, "workspace_scale")
    layout.row().prop(preferences, "axes", expand=True)
    layout.row().prop(preferences, "stroke_on", expand=True)


def _draw_devices(layout: bpy.types.UILayout, context: bpy.types.Context, preferences: RepoussePreferences) -> None:
    """Every arm that was found, and how it stands with each."""
    found, used = listing(), device_of(preferences.device)
    head = layout.row()
    head.label(text="Arms")
    if is_looking():
        head.label(text="Looking for arms", icon="SORTTIME")
    else:
        head.operator(REPOUSSE_OT_arm_refresh.bl_idname, icon="FILE_REFRESH")
    box = layout.box().column()
    for device in found.devices if used in found.devices else (*found.devices, used):
        _draw_device(box.row(), device, device == used)
    if found.error:
        draw_text(box, context, found.error, icon="ERROR")
    elif not found.looked:
        box.label(text="Arms are looked for when you press Refresh, and never otherwise", icon="INFO")
    elif len(found.devices) == 1:
        box.label(text="No arm is plugged in that a profile knows", icon="INFO")


def _draw_device(row: bpy.types.UILayout, device: Device, is_chosen: bool) -> None:
    say = bpy.app.translations.pgettext_iface
    row.operator(
        REPOUSSE_OT_arm_choose.bl_idname,
        text=say("Emulated Arm") if device.state == EMULATED else device.name,
        icon="RADIOBUT_ON" if is_chosen else "RADIOBUT_OFF",
        depress=is_chosen,
        translate=False,
    ).device = device.identifier
    word, icon = STATES[device.state]
    row.label(text=say(word), icon=icon, translate=False)


def _draw_what_to_do(layout: bpy.types.UILayout, context: bpy.types.Context, preferences: RepoussePreferences) -> None:
    """Why the chosen arm cannot be driven yet, and what to do."""
    device = device_of(preferences.device)
    say = bpy.app.translations.pgettext_iface
    try:
        chosen(preferences)
    except ValueError as error:
        draw_text(layout, context, str(error), icon="ERROR")
    rule = rule_of(device)
    if not rule:
        return
    box = layout.box().column(align=True)
    row = box.row()
    row.label(text=say("Save this as {}").format(RULES_FILE), translate=False)
    row.operator(REPOUSSE_OT_arm_copy_rule.bl_idname, icon="COPYDOWN").device = device.identifier
    for line in rule.splitlines():
        box.label(text=line, translate=False)
    box.label(text="Then unplug the arm, plug it in and press Refresh")


def _draw_own_profiles(column: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Where an artist's own profiles go, and what is wrong with those that are there."""
    say = bpy.app.translations.pgettext_iface
    text = say("Profiles of your own, TOML files: {}").format(profiles_folder())
    column.label(text=text, icon="FILE_FOLDER", translate=False)
    for error in catalogue().errors:
        draw_text(column, context, error, icon="ERROR")


def register():
    bpy.utils.register_class(RepoussePreferences)


def unregister():
    bpy.utils.unregister_class(RepoussePreferences)
    _items.clear()
