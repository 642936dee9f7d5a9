# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole way: preferences, verbs, the loop in its process, the emulated arm and its hand, and voxels."""

import json
import os
import signal
import threading

import bpy
import numpy as np
import pytest

from repousse.core import Material, Push
from repousse.device.fault import State
from repousse.operators import arm_session, session

from .arms import EDGE, PROFILE, TOP, at, commit, preferring, small_tool, take, threads, until
from .sculpting import in_file, new_clay, same

LIMIT = 30.0
"""Seconds: the machine may be busy, the arm itself takes three."""


def intention(folder, *keys, loop=False):
    """A script of the hand: (time, place of the arm as ``at`` gives it, button)."""
    lines = [{"intention": 1, "loop": loop}]
    for when, place, button in keys:
        position = np.subtract(place, PROFILE.workspace_centre).tolist()
        lines.append({"time": when, "position": position, "button": button})
    path = folder / "hand.jsonl"
    path.write_text("\n".join(json.dumps(line) for line in lines))
    return str(path)


@pytest.fixture
def clay():
    made = new_clay(name="Clay")
    session.open_session(made)
    small_tool()
    yield made
    arm_session.close_arm()
    session.close_session()


@pytest.fixture
def strokes(monkeypatch):
    """The strokes that a press of the stylus has begun, as Sculpt begins them: a modal operator needs a window."""
    begun = []
    monkeypatch.setattr(
        arm_session.ArmSession, "_begin", lambda self, view: begun.append(take(self, bpy.data.objects["Clay"]))
    )
    return begun


def connected(script):
    """The emulated arm, homed and armed, with its hand at work."""
    assert bpy.ops.repousse.arm_connect() == {"FINISHED"}
    arm = arm_session.arm()
    until(lambda: arm.state.state == State.OPEN, "the arm to be open", LIMIT)
    assert bpy.ops.repousse.arm_home() == {"FINISHED"}
    until(lambda: arm.state.state == State.HOMED, "the arm to be homed", LIMIT)
    assert bpy.ops.repousse.arm_arm() == {"FINISHED"}
    until(lambda: arm.state.state == State.RUN, "the arm to run", LIMIT)
    return arm


ABOVE, IN = at(0.0, 0.0, TOP + 6 * EDGE), at(0.0, 0.0, TOP - 1 * EDGE)


def emulated(script):
    return preferring(device="emulated", axes="OBJECT", emulated_script=script, stroke_on="BUTTON", force_scale=1.0)


def test_a_hand_presses_into_clay_and_feels_it(clay, strokes, tmp_path):
    script = intention(
        tmp_path, (0.5, ABOVE, False), (3.0, ABOVE, True), (5.0, IN, True), (6.0, IN, True), (7.0, ABOVE, False)
    )
    before = in_file(clay)
    with emulated(script):
        arm = connected(script)
        until(lambda: strokes, "the stylus to begin a stroke", LIMIT)
        held, engine = strokes[0]
        scene, forces = arm.scene, []

        def over():
            forces.append(arm.state.force)
            return held.over

        until(over, "the stylus to be released", LIMIT)
        assert not held.trouble
        samples = commit(clay, engine)
        hardest = max(force[2] for force in forces)
        assert hardest > 0.1, f"the hand feels {hardest:g} N at most"
        assert all(abs(x) < 0.5 * hardest + 0.1 for x, _, _ in forces)
        assert not same(in_file(clay), before)
        again = Push(session.DensityGrid(before), engine.push.tool, Material())
        for sample in samples:
            again.walk(sample)
        assert same(again.grid.density, in_file(clay))
        until(lambda: session.live().feeling is not None, "the clay to be felt again")
        assert arm.scene == scene
        process = arm.loop.process_id
        assert bpy.ops.repousse.arm_disconnect() == {"FINISHED"}
    assert_ended(process)


def test_a_loop_that_is_killed_in_a_stroke_costs_nothing(clay, strokes, tmp_path):
    script = intention(tmp_path, (0.5, ABOVE, False), (3.0, ABOVE, True), (5.0, IN, True))
    before = in_file(clay)
    with emulated(script):
        arm = connected(script)
        until(lambda: strokes and strokes[0][1].touched, "voxels to change", LIMIT)
        held, engine = strokes[0]
        process = arm.loop.process_id
        os.kill(process, signal.SIGKILL)
        until(lambda: held.over, "the stroke to end", LIMIT)
    assert "exit code -9" in held.trouble
    pushed = session.live().grid.density.copy()
    commit(clay, engine)
    assert engine.failure is None
    assert same(in_file(clay), session.live().grid.density) and not same(pushed, before)
    assert arm_session.arm() is None
    assert_ended(process)


def test_a_script_that_is_wrong_ends_the_arm_with_the_reason(clay, tmp_path):
    script = tmp_path / "wrong.jsonl"
    script.write_text('{"intention": 2}\n{"time": 0, "position": [0, 0, 0]}\n')
    with emulated(str(script)):
        assert bpy.ops.repousse.arm_connect() == {"FINISHED"}
        until(lambda: arm_session.arm() is None, "the loop to end", LIMIT)
    assert "wrong.jsonl" in arm_session.farewell()


def test_loading_a_file_ends_the_process(clay):
    with emulated(""):
        assert bpy.ops.repousse.arm_connect() == {"FINISHED"}
        process = arm_session.arm().loop.process_id
        bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    assert_ended(process)


def assert_ended(process):
    """Neither process nor thread is left; not as a zombie either."""
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
    assert not threads() and not [t for t in threading.enumerate() if t.name.startswith("repousse arm")]
