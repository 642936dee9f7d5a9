# SPDX-License-Identifier: GPL-3.0-or-later
"""The emulated arm for scenarios: what its hand does, and waiting for it. Its loop is a process of its own."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path

import bpy
import numpy as np
from bl_ext.user_default.repousse.device.fault import State
from bl_ext.user_default.repousse.device.profile import builtin_profiles
from bl_ext.user_default.repousse.operators import arm_session
from bl_ext.user_default.repousse.operators.arm_devices import preferences_of

from .scenario import Steps
from .sculpting import running, sessions
from .window import Window

PROFILE = builtin_profiles()["phantom-premium-1.5"]
METRE = 1.0 / PROFILE.workspace_radius
"""World units to a metre of the arm: the clay is two wide, and the arm's reach half of that."""
LIMIT = 30.0

Key = tuple[float, tuple[float, float, float], bool]


def hand(folder: Path, keys: Iterable[Key], loop: bool = False) -> str:
    """A script of the emulated hand: seconds, a place of the world, and whether the stylus is pressed from then on."""
    lines: list[dict] = [{"intention": 1, "loop": loop}]
    for time, (x, y, z), button in keys:  # it sits before the object, and its x comes towards the user, -y
        lines.append({"time": time, "position": [-y / METRE, x / METRE, z / METRE], "button": button})
    path = folder / "hand.jsonl"
    path.write_text("\n".join(json.dumps(line) for line in lines), encoding="utf-8")
    return str(path)


def arm() -> arm_session.ArmSession:
    """The arm that is connected."""
    found = arm_session.arm()
    assert found is not None, f"no arm is connected: {arm_session.farewell()}"
    return found


def connect(window: Window, script: str) -> Steps:
    """Connect the emulated arm, home and arm it, as from the panel; its hand then follows the script."""
    preferences = preferences_of(bpy.context)
    preferences.device, preferences.profile, preferences.axes = "emulated", PROFILE.key, "OBJECT"
    preferences.workspace_scale, preferences.force_scale, preferences.stroke_on = 1.0, 1.0, "BUTTON"
    preferences.emulated_script = script
    for verb, state in (("connect", State.OPEN), ("home", State.HOMED), ("arm", State.RUN)):
        with window.context():
            assert getattr(bpy.ops.repousse, f"arm_{verb}")() == {"FINISHED"}
        yield from window.until(lambda state=state: arm().state.state == state, f"the arm to be {state.name}", LIMIT)


def half_a_stroke(window: Window) -> Steps:
    """Wait until the hand presses the stylus and voxels have changed."""
    try:
        yield from window.until(lambda: running() and sessions.live().engine.touched, "the hand to push", 2 * LIMIT)
    except AssertionError as error:
        raise AssertionError(f"{error}; {arm().message} {arm().state}") from error


def gone(window: Window, process: int) -> Steps:
    """Wait until the loop's process is no more, not even as a zombie."""
    yield from window.until(lambda: not _exists(process), "the loop's process to end", LIMIT)


def _exists(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def cursor() -> np.ndarray:
    """Where the add-on shows the tool, in the world."""
    session = sessions.live()
    assert session is not None and session.pointer is not None, "there is no cursor"
    return np.array(session.pointer.position)
