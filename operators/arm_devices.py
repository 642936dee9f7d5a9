# SPDX-License-Identifier: GPL-3.0-or-later
"""Which arms are plugged in, and which profiles there are for them.

Arms are looked for only when the artist asks, by a subprocess (device/hid_bus.py): hidapi has crashed its host, and
never sees Blender. Nothing is opened by it. What was found is kept here until the next look, and drawing reads that.
"""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import bpy

if TYPE_CHECKING:
    from ..device.profile import DeviceProfile, Link

READY, NO_PERMISSION, VENDOR_DRIVER, EMULATED, UNKNOWN = STATES = (
    "ready",
    "no permission",
    "vendor driver needed",
    "emulated",
    "unknown",
)
"""What can be said of a device; the first three are hid_bus's words."""
EMULATED_DEVICE = "emulated"
"""The identifier of the arm in software."""
RULES_FILE = "/etc/udev/rules.d/70-repousse.rules"
LIMIT = 10.0
"""Seconds after which a look is given up: a device that does not answer can hold the system's list back."""
TICK = 0.05
"""Seconds between looks at whether the subprocess is done."""
MOST_DEVICES, MOST_TEXT = 64, 200
_PACKAGE = __package__.rpartition(".")[0]


@dataclass(frozen=True)
class Device:
    """An arm that can be chosen.

    ``identifier`` is the same whenever it is plugged in: its USB ids, and its number where there are several. ``path``
    is hidapi's, for this time. ``candidates`` are the (profile key, link name) that fit it. ``message`` says what to do
    where ``state``, one of :data:`STATES`, is not enough.
    """

    identifier: str
    name: str
    state: str
    message: str = ""
    path: str = ""
    candidates: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Listing:
    """What the last look found; ``error``: one line why it found nothing out; ``looked``: whether there was one."""

    devices: tuple[Device, ...] = (Device(EMULATED_DEVICE, "Emulated Arm", EMULATED, path=EMULATED_DEVICE),)
    error: str = ""
    looked: bool = False


@dataclass(frozen=True)
class Catalogue:
    """The profiles of arms that can be driven, by their key, and one line for each file that was refused."""

    profiles: dict[str, DeviceProfile] = field(default_factory=dict)
    errors: tuple[str, ...] = ()


_NOTHING = Listing()
_listing = _NOTHING
_look: _Look | None = None


def listing() -> Listing:
    """What the last look found."""
    return _listing


def is_looking() -> bool:
    """Whether a look is under way."""
    return _look is not None


def device_of(identifier: str) -> Device:
    """The device that is chosen by ``identifier``; of state UNKNOWN where the last look did not see it."""
    for device in _listing.devices:
        if device.identifier == identifier:
            return device
    return Device(identifier, identifier, UNKNOWN)


def profiles_folder() -> Path:
    """Where the artist's own profiles are; it need not be there."""
    try:
        return Path(bpy.utils.extension_path_user(_PACKAGE, path="profiles"))
    except ValueError:  # not run as an extension
        return Path(bpy.utils.user_resource("DATAFILES", path="repousse/profiles"))


def preferences_of(context: bpy.types.Context) -> bpy.types.AddonPreferences:
    """The add-on's preferences (ui/preferences.py). Raises KeyError where it is not enabled as an add-on."""
    return context.preferences.addons[_PACKAGE].preferences


@cache
def catalogue() -> Catalogue:
    """The profiles: our own and the artist's. Files are read the first time, and after each look."""
    from ..device.profile import builtin_profiles, load_profiles

    known, errors = dict(builtin_profiles()), []
    if profiles_folder().is_dir():
        own, errors = load_profiles(profiles_folder())
        known |= own
    driven = {key: profile for key, profile in known.items() if profile.driven}
    return Catalogue(driven, tuple(_told(line) for line in errors))


def chosen(preferences: bpy.types.AddonPreferences) -> tuple[DeviceProfile, Link, str]:
    """Profile, link and hidapi's path (or "emulated") of the arm that is chosen in the preferences.

    Raises ValueError with one line that says what to do where it cannot be driven.
    """
    device = device_of(preferences.device)
    profile = catalogue().profiles.get(preferences.profile)
    if profile is None:
        raise ValueError("There is no such profile any more: choose that of your arm in the preferences of Repoussé")
    if device.state == EMULATED:
        if profile.emulated is None:
            raise ValueError(
                f"{profile.name} cannot be emulated: choose another profile in the preferences of Repoussé"
            )
        return profile, profile.links[0], device.path
    if device.state == UNKNOWN:
        raise ValueError(f"The arm {device.name} has not been seen: plug it in and press Refresh")
    if device.state != READY:
        raise ValueError(f"{device.name}: {device.message or device.state}")
    for link in profile.links:
        if (profile.key, link.name) in device.candidates:
            return profile, link, device.path
    raise ValueError(f"{device.name} does not fit the profile {profile.name}: choose another in the preferences")


def rule_of(device: Device) -> str:
    """The udev rule that lets who sits at this machine use a device, with where it belongs; "" where none helps."""
    if device.state != NO_PERMISSION:
        return ""
    from ..device.hid_bus import udev_rule

    profiles = catalogue().profiles
    keys = dict.fromkeys(key for key, _ in device.candidates)
    links = [link for key in keys if key in profiles for link in profiles[key].links]
    fitting = [link for link in links if link.name in {name for _, name in device.candidates}]
    return f"# {RULES_FILE}\n{udev_rule(fitting)}" if fitting else ""


def parse_devices(text: str) -> tuple[Device, ...]:
    """The devices that hid_bus tells as JSON. Raises ValueError with one line where that is not what it should be."""
    try:
        entries = json.loads(text)
        if not isinstance(entries, list) or len(entries) > MOST_DEVICES:
            raise ValueError(f"not a list of at most {MOST_DEVICES}")
        entries = sorted(entries, key=lambda entry: entry["path"])
        found, count = [], {}
        for entry in entries:
            ids = f"{entry['vendor']:04x}:{entry['product']:04x}"
            count[ids] = count.get(ids, 0) + 1
            found.append(_device(ids if count[ids] == 1 else f"{ids} #{count[ids]}", entry))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"What was found cannot be read ({error}): install Repoussé anew") from error
    return tuple(found)


def _device(identifier: str, entry: dict[str, Any]) -> Device:
    if entry["state"] not in STATES[:3]:
        raise ValueError(f"there is no state {entry['state']!r}")
    candidates = tuple((str(profile), str(link)) for profile, link in entry["candidates"])
    name = _told(entry["name"]) or identifier
    return Device(identifier, name, entry["state"], _told(entry["message"]), str(entry["path"]), candidates)


def _told(text: str) -> str:
    """A text from outside, such as a device's name, as a line that can be shown."""
    return "".join(mark if mark.isprintable() else " " for mark in text)[:MOST_TEXT].strip()


class _Look:
    """One look for arms: a subprocess, and a thread that listens to it. Knows nothing of Blender."""

    def __init__(self, folder: Path) -> None:
        from ..device import child

        hidapi = child.find_hidapi()
        if hidapi is None:
            raise OSError("hidapi is not there: install Repoussé anew, as an extension")
        config = {"hidapi": hidapi, "profiles": str(folder) if folder.is_dir() else None}
        self._process = child.start("hid_bus", config)
        self._thread = Thread(target=self._listen, name="Repoussé: looking for arms")
        self._said: tuple[str, str] = "", ""
        self._late = False
        self._thread.start()

    def _listen(self) -> None:
        try:
            self._said = self._process.communicate(timeout=LIMIT)
        except subprocess.TimeoutExpired:
            self._late = True
            self._process.kill()
            self._process.communicate()

    @property
    def is_over(self) -> bool:
        """Whether all has been said."""
        return not self._thread.is_alive()

    def wait(self) -> None:
        """Until it is over, at most LIMIT."""
        self._thread.join()

    def end(self) -> None:
        """Give it up."""
        self._process.kill()
        self._thread.join()

    def result(self) -> Listing:
        """What it found, once it is over."""
        said, complaint = self._said
        if self._late:
            return Listing(error=f"The devices were not listed within {LIMIT:g} s: unplug what hangs, and try again")
        if self._process.returncode:
            return Listing(error=_told(complaint.strip().rpartition("\n")[2]) or "The devices cannot be listed")
        try:
            return Listing((*_NOTHING.devices, *parse_devices(said)), looked=True)
        except ValueError as error:
            return Listing(error=_told(str(error)))


def start_look() -> None:
    """Begin to look for arms, unless that is under way; what is found is listed when Blender next has time."""
    global _look, _listing
    if _look is not None:
        return
    catalogue.cache_clear()
    try:
        _look = _Look(profiles_folder())
    except OSError as error:
        _listing = Listing(error=_told(str(error)))
        return
    bpy.app.timers.register(take_look, first_interval=TICK, persistent=True)


def take_look() -> float | None:
    """A timer's: list what was found once the look is over."""
    global _look, _listing
    if _look is None:
        return None
    if not _look.is_over:
        return TICK
    _listing, _look = _look.result(), None
    _show()
    return None


def end_look() -> None:
    """Give up the look that may be under way."""
    global _look
    if bpy.app.timers.is_registered(take_look):
        bpy.app.timers.unregister(take_look)
    if _look is not None:
        _look.end()
        _look = None


def _show() -> None:
    """Have the preferences and the sidebars drawn anew."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PREFERENCES":
                area.tag_redraw()
            elif area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()


class REPOUSSE_OT_arm_refresh(bpy.types.Operator):
    bl_idname = "repousse.arm_refresh"
    bl_label = "Refresh"
    bl_description = "Look for arms that are plugged in. Nothing is sent to them"

    @classmethod
    def poll(cls, _context):
        return not is_looking()

    def invoke(self, _context, _event):
        start_look()
        return {"FINISHED"}

    def execute(self, _context):
        """From a script there is nobody to wait for a list."""
        start_look()
        if _look is not None:
            _look.wait()
            take_look()
        if _listing.error:
            self.report({"WARNING"}, _listing.error)
        return {"FINISHED"}


class REPOUSSE_OT_arm_choose(bpy.types.Operator):
    bl_idname = "repousse.arm_choose"
    bl_label = "Choose Arm"
    bl_description = "Use this arm from the next connection on"
    bl_options = {"INTERNAL"}

    device: bpy.props.StringProperty(name="Device", description="Identifier of the arm")

    def execute(self, context):
        preferences = preferences_of(context)
        preferences.device = self.device
        fitting = [key for key, _ in device_of(self.device).candidates if key in catalogue().profiles]
        if fitting and preferences.profile not in fitting:
            preferences.profile = fitting[0]
        context.preferences.is_dirty = True
        return {"FINISHED"}


class REPOUSSE_OT_arm_copy_rule(bpy.types.Operator):
    bl_idname = "repousse.arm_copy_rule"
    bl_label = "Copy"
    bl_description = "Copy the udev rule that lets you use this arm, to be saved as the file named in its first line"
    bl_options = {"INTERNAL"}

    device: bpy.props.StringProperty(name="Device", description="Identifier of the arm")

    def execute(self, context):
        rule = rule_of(device_of(self.device))
        if not rule:
            self.report({"ERROR"}, f"{self.device}: no rule is needed, or none helps")
            return {"CANCELLED"}
        context.window_manager.clipboard = rule
        self.report({"INFO"}, f"Copied: save it as {RULES_FILE}, then plug the arm in anew")
        return {"FINISHED"}


_CLASSES = (REPOUSSE_OT_arm_refresh, REPOUSSE_OT_arm_choose, REPOUSSE_OT_arm_copy_rule)


def register():
    for made in _CLASSES:
        bpy.utils.register_class(made)


def unregister():
    global _listing
    end_look()
    _listing = _NOTHING
    catalogue.cache_clear()
    for made in reversed(_CLASSES):
        bpy.utils.unregister_class(made)
