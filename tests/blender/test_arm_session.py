# SPDX-License-Identifier: GPL-3.0-or-later
"""An arm in Blender: what it feels, when a scene is another one, how its strokes end, and that nothing outlives it."""

import time
from dataclasses import replace

import bpy
import numpy as np
import pytest

from repousse.core import Material, Push, SphereTool, Stroke
from repousse.core.engine import Engine
from repousse.core.stroke import Sample
from repousse.device.fault import Fault, State, fault_text
from repousse.operators import arm_hand, arm_mapping, arm_session, replay_stroke, session
from repousse.operators.aim import Aim

from .arms import (
    AIR,
    EDGE,
    PROFILE,
    REACH,
    TOP,
    TOUCHING,
    FakeLoop,
    at,
    commit,
    preferences,
    preferring,
    small_tool,
    take,
    threads,
    until,
)
from .sculpting import file_of, in_file, new_clay, same, stroke, the


@pytest.fixture(autouse=True)
def closed():
    with preferring(axes="OBJECT", workspace_scale=1.0, force_scale=1.0, stroke_on="BUTTON"):
        yield
        arm_session.close_arm()
        session.close_session()


@pytest.fixture
def clay():
    made = new_clay(name="Clay")
    session.open_session(made)
    small_tool()
    return made


@pytest.fixture
def loop():
    return FakeLoop(PROFILE)


@pytest.fixture
def arm(clay, loop):
    return arm_session.open_arm(loop, PROFILE)


def feels(loop, scene=None):
    """Whether the loop was told of a contact last, of this scene."""
    model = loop.model
    return model is not None and model.stress > 0.0 and scene in (None, model.scene)


def engage(loop, place=TOUCHING):
    """The arm at a place, with force, and what is there is felt."""
    loop.put(place, state=State.RUN, ramp=1.0)
    until(lambda: loop.model is not None, "a model to be sent")
    return loop.model.scene


def press(loop, arm, obj, way):
    """A stroke through some places, each waited for, whose button is still held."""
    loop.put(way[0], state=State.RUN, buttons=1)
    held, engine = take(arm, obj)
    for place in way:
        loop.put(place)
        until(lambda: solved(engine, held, loop), "a pose to be solved")
    return held, engine


def solved(engine, held, loop):
    """Whether the arm's present place has been pushed to."""
    there = held.hand.mapping.position(loop.state().position)
    done = engine.solved
    return bool(done) and np.linalg.norm(np.subtract(done[-1].position, there)) < 0.1


INTO = [at(0.0, 0.0, TOP + depth * EDGE) for depth in (2.0, 1.0, 0.0, -1.0)]


def test_the_surface_is_felt_between_strokes_and_not_changed(arm, loop, clay):
    before, told = in_file(clay), file_of(clay)
    shallow = at(0.0, 0.0, TOP + 3.7 * EDGE)  # it does not yield there
    engage(loop, shallow)
    until(lambda: feels(loop), "the surface to be felt")
    model, live = loop.model, session.live()
    assert model.position == pytest.approx(shallow, abs=1e-12)
    assert model.normal == pytest.approx((0.0, 0.0, 1.0), abs=1e-3)  # up, out of the clay
    assert model.gradient[2] < 0.0  # N/m: deeper is harder
    # It is what a push feels there.
    mapping = live.feeling.hand.mapping
    felt = Push(live.grid, live.feeling.push.tool, bpy.context.scene.repousse.clay).move_to(mapping.position(shallow))
    assert felt.moved_mass == 0.0
    assert model.stress < model.yield_stress == pytest.approx(felt.yield_stress, rel=1e-6)
    assert model.stress == pytest.approx(felt.stress, rel=1e-6)
    for depth in (0.0, -2.0, -4.0):
        loop.put(at(0.1, 0.0, TOP + depth * EDGE))
        count = len(loop.sent)
        until(lambda count=count: len(loop.sent) > count + 3, "more models")
    assert same(live.grid.density, before) and file_of(clay) == told


def test_the_models_place_is_the_arms(arm, loop):
    """Wherever the arm is: at 1 kHz the loop goes on from there."""
    engage(loop)
    for place in (AIR, at(0.2, -0.1, TOP), at(-0.3, 0.2, TOP - EDGE)):
        loop.put(place)
        until(lambda place=place: loop.model.position == pytest.approx(place, abs=1e-12), "the model to follow")


def test_in_air_nothing_presses_and_the_scene_is_one(arm, loop):
    scene = engage(loop, AIR)
    assert scene > 0 and loop.model.stress == 0.0


@pytest.mark.parametrize("state", [State.CLOSED, State.OPEN, State.SAFE])
def test_without_a_pose_nothing_is_felt_and_no_cursor_shown(arm, loop, state):
    engage(loop)
    assert session.live().pointer is not None
    loop.put(state=state)
    until(lambda: loop.model is None, "the loop to be told that nothing is there")
    assert session.live().pointer is None and session.live().feeling is None
    assert not threads()


@pytest.mark.parametrize("place", [(np.nan, 0.0, 0.0), (0.0, np.inf, 0.0)])
def test_a_place_that_is_no_number_is_none(arm, loop, place):
    engage(loop)
    loop.put(place)
    until(lambda: session.live().feeling is None, "the engine to be ended")
    assert loop.model is None and session.live().pointer is None


def test_homed_is_enough_to_feel_and_to_point(arm, loop):
    """So the force that the loop lets in later is that of where the arm is."""
    loop.put(TOUCHING, state=State.HOMED)
    until(lambda: feels(loop), "the surface to be felt")
    assert session.live().pointer.position == pytest.approx((0.0, 0.0, TOP + EDGE), abs=1e-5)


def test_the_cursor_is_where_the_tool_is(arm, loop):
    engage(loop)
    until(lambda: feels(loop) and session.live().pointer is not None, "the cursor")
    loop.put(at(0.2, 0.1, TOP))
    until(lambda: session.live().pointer.position == pytest.approx((0.2, 0.1, TOP), abs=1e-5), "the cursor to follow")
    assert session.live().pointer.radius == pytest.approx(session.live().feeling.push.tool.radius * EDGE, rel=1e-5)
    assert session.live().pointer.normal == pytest.approx((0.0, 0.0, 1.0), abs=0.01)
    assert arm.has_pointer


def change(event, arm, loop, clay):
    """Something that is not the arm's own stroke."""
    settings, live = bpy.context.scene.repousse, session.live()
    if event == "undo":
        bpy.ops.ed.undo()
    elif event == "redo":
        bpy.ops.ed.undo()
        bpy.ops.ed.redo()
    elif event == "preset":
        settings.material = "snow"
    elif event == "force":
        settings.full_force *= 1.5
    elif event == "radius":
        settings.radius *= 2
    elif event == "object moved":
        clay.location.x += 0.01
        bpy.context.view_layer.update()
    elif event == "other object":
        session.open_session(new_clay(name="Other"))
    elif event == "workspace":
        preferences().workspace_scale = 1.1
    elif event == "axes":
        preferences().axes = "VIEW"
    elif event == "clutch":
        arm.set_clutch(True)
        arm.set_clutch(False)
    elif event == "a stroke of the mouse":
        live.feeling = None
        live.engine = engine = Engine(Push(live.grid, SphereTool(4.0), Material()))
        engine.start()
        engine.feed(Sample(0.0, (12.0, 12.0, 21.0)))
        assert engine.settle(10.0)
        arm_session.watch()
        commit(clay, engine)
    elif event == "another file":
        volume = in_file(clay)
        volume[:2] = 0.0
        live.grid.density[:2] = 0.0
        live.commit(clay, [((0, 0, 0), (2, 24, 24))])
        live.changed(None)
    elif event == "a replay":
        header = {"tool": SphereTool(4.0), "material": Material()}
        text = bpy.data.texts.new("stroke")
        text.from_string(Stroke.line((12.0, 12.0, 28.0), (12.0, 12.0, 22.0), **header).to_text())
        assert bpy.ops.repousse.replay_kept_stroke(text="stroke") == {"FINISHED"}
    elif event == "a stroke taken back":
        _, engine = press(loop, arm, clay, INTO)
        loop.put(TOUCHING, buttons=0)
        engine.cancel()
        live.changed(None)
        live.engine = None


EVENTS = [
    "undo",
    "redo",
    "preset",
    "force",
    "radius",
    "object moved",
    "other object",
    "workspace",
    "axes",
    "clutch",
    "a stroke of the mouse",
    "another file",
    "a replay",
    "a stroke taken back",
]


@pytest.mark.parametrize("event", EVENTS)
def test_what_the_arm_did_not_do_makes_another_scene(arm, loop, clay, event):
    """So the small-force gate and the ramp are gone through again; and in between nothing is felt."""
    stroke(clay, 1)
    stroke(clay, 2)
    scene = engage(loop)
    until(lambda: session.live().feeling is not None, "the clay to be felt")
    change(event, arm, loop, the("Clay"))
    until(lambda: loop.model is not None and loop.model.scene > scene, "another scene")
    now = loop.model.scene
    told = [0 if model is None else model.scene for model in loop.sent]
    first = told.index(now)
    assert told[:first].count(0), "nothing is told in between"
    assert set(told[first:]) == {now}, "the former scene is felt after the new one"
    assert now == scene + 1


def test_nothing_is_felt_from_the_undo_on(arm, loop, clay):
    """Not from the next look at the arm: undo may take its time."""
    stroke(clay, 1)
    engage(loop)
    told = []

    def note(*_):
        told.append((loop.model, session.live().feeling))

    bpy.app.handlers.undo_post.insert(0, note)
    try:
        bpy.ops.ed.undo()
    finally:
        bpy.app.handlers.undo_post.remove(note)
    assert told == [(None, None)]


def test_nothing_is_felt_while_a_stroke_is_replayed(arm, loop, clay, monkeypatch):
    engage(loop)
    felt = []
    monkeypatch.setattr(replay_stroke, "walk", lambda *_: felt.append(session.live().feeling) or 0.0)
    change("a replay", arm, loop, clay)
    assert felt == [None]


def test_another_object_is_reached_as_a_whole(arm, loop, clay):
    loop.put(at(0.0, 0.0, TOP), state=State.HOMED)
    look()
    assert session.live().pointer.position == pytest.approx((0.0, 0.0, TOP), abs=1e-5)
    assert bpy.ops.repousse.new_clay_block(resolution=16, size=2.4) == {"FINISHED"}
    session.open_session(bpy.context.object)
    look()
    assert session.live().pointer.position == pytest.approx((0.0, 0.0, 2.0 * TOP), abs=1e-5)


def test_a_view_that_is_being_turned_is_not_felt(arm, loop, clay):
    with preferring(axes="VIEW"):
        engage(loop, PROFILE.workspace_centre)
        eye = arm_session.view_of(bpy.context, session.live()).eye
        scene, sent = loop.model.scene, len(loop.sent)
        for _ in range(4):
            eye.view_location.x += 0.05
            arm_session.watch()
            assert session.live().feeling is None
        assert loop.sent[sent:].count(None) == 1 and not threads()
        until(lambda: loop.model is not None, "the view that has come to rest to be felt")
        assert loop.model.scene == scene + 1


def test_the_arm_moves_as_one_sees_it(arm, loop, clay):
    """Up is up in the view, at the part of the view that the hand has gone of its reach."""
    with preferring(axes="VIEW", workspace_scale=0.5):
        view = arm_session.view_of(bpy.context, session.live())
        aim = Aim.of(view.region, view.eye, np.eye(4))
        half = min(view.region.width, view.region.height) / 2.0
        centre = (aim.to_clip @ (*view.eye.view_location, 1.0))[:2] / (aim.to_clip @ (*view.eye.view_location, 1.0))[3]
        for away, wanted in (
            ((0, 0, REACH), (0.0, half / 2)),
            ((0, REACH, 0), (half / 2, 0.0)),
            ((REACH, 0, 0), (0, 0)),
        ):
            loop.put(np.add(PROFILE.workspace_centre, away), state=State.HOMED)
            arm_session.watch()
            clip = aim.to_clip @ (*session.live().pointer.position, 1.0)
            pixels = (clip[:2] / clip[3] - centre) * (view.region.width / 2.0, view.region.height / 2.0)
            assert pixels == pytest.approx(wanted, abs=0.01)


def test_a_stroke_is_made_by_the_arms_poses_and_replays_to_the_same_voxels(arm, loop, clay):
    before, scene = in_file(clay), engage(loop, AIR)
    held, engine = press(loop, arm, clay, INTO)
    loop.put(buttons=0)
    until(lambda: held.over, "the stroke to end")
    samples = commit(clay, engine)
    after = in_file(clay)
    assert not same(after, before)
    again = Push(session.DensityGrid(before), engine.push.tool, Material())
    for sample in samples:
        again.walk(sample)
    assert same(again.grid.density, after)
    assert not held.trouble
    until(lambda: session.live().feeling is not None and feels(loop), "the clay to be felt again")
    assert loop.model.scene == scene, "the stroke's own changes make another scene"


def test_a_stroke_that_makes_the_clay_grow_keeps_scene_and_place(arm, loop, clay):
    side = [at(TOP - depth * EDGE, 0.0, TOP - 3 * EDGE) for depth in (8.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0, 0.0)]
    scene = engage(loop, side[0])
    held, engine = press(loop, arm, clay, side)
    loop.put(buttons=0)
    until(lambda: held.over, "the stroke to end")
    commit(clay, engine)
    assert session.live().grid.shape != (24, 24, 24), "it has not grown"
    until(lambda: session.live().feeling is not None and feels(loop), "the clay to be felt again")
    assert loop.model.scene == scene
    where = pytest.approx((TOP, 0.0, TOP - 3 * EDGE), abs=1e-5)
    assert session.live().pointer.position == where
    bpy.ops.ed.undo()
    until(lambda: session.live().feeling is not None and feels(loop), "the clay to be felt again")
    assert session.live().grid.shape == (24, 24, 24)
    assert loop.model.scene == scene + 1 and session.live().pointer.position == where


def test_a_stroke_ends_when_the_button_does_however_late_blender_looks(arm, loop, clay):
    engage(loop, AIR)
    held, engine = press(loop, arm, clay, INTO)
    loop.put(buttons=0)
    until(lambda: held.over, "the hand to let go")
    deepest = engine.solved[-1].position
    sent = len(loop.sent)
    loop.put(at(0.3, 0.0, TOP - 2 * EDGE))
    until(lambda: loop.model.position == pytest.approx(loop.state().position), "what is there to be felt")
    assert engine.settle(5.0)
    assert engine.solved[-1].position == deepest, "it has pushed on"
    assert len(loop.sent) > sent and feels(loop)
    commit(clay, engine)


@pytest.mark.parametrize("fault", [Fault.UNPLUGGED, Fault.SILENT, Fault.ENCODER_JUMP])
def test_a_fault_ends_the_stroke_as_if_released_and_says_why(arm, loop, clay, fault):
    engage(loop, AIR)
    before = in_file(clay)
    held, engine = press(loop, arm, clay, INTO)
    pushed = session.live().grid.density.copy()
    loop.fail(fault)
    until(lambda: held.over, "the stroke to end")
    assert held.trouble == fault_text(fault)
    assert engine.failure is None and engine.settle(5.0)
    commit(clay, engine)
    assert same(in_file(clay), pushed) and not same(pushed, before)
    until(lambda: loop.model is None, "nothing to be felt")
    bpy.ops.ed.undo()
    assert same(session.live().grid.density, before)


def test_disarming_ends_the_stroke_and_is_no_trouble(arm, loop, clay):
    engage(loop, AIR)
    held, engine = press(loop, arm, clay, INTO)
    loop.put(state=State.HOMED)
    until(lambda: held.over, "the stroke to end")
    assert held.trouble == ""
    commit(clay, engine)


def test_a_loop_that_dies_in_a_stroke_ends_it_and_is_cleared_away(arm, loop, clay):
    engage(loop, AIR)
    held, engine = press(loop, arm, clay, INTO)
    loop.die("the arm's loop was ended from outside (exit code -9)")
    arm_session.watch()
    assert held.over and "exit code -9" in held.trouble
    assert engine.running and engine.settle(5.0) and engine.failure is None
    assert arm_session.arm() is None and loop.stops == 1
    assert "exit code -9" in arm_session.farewell()
    assert not same(session.live().grid.density, in_file(clay))
    commit(clay, engine)
    assert not threads()


def test_a_loop_that_dies_between_strokes_is_cleared_away(arm, loop):
    engage(loop)
    loop.die("it fell over")
    assert arm_session.watch() is None
    assert arm_session.arm() is None and "it fell over" in arm_session.farewell()
    assert loop.stops == 1 and not threads()
    assert session.live().pointer is None


@pytest.mark.parametrize("event", ["disconnect", "load", "unregister", "exit", "python's end", "failure", "another"])
@pytest.mark.parametrize("stroking", [False, True])
def test_what_ends_the_arm_leaves_nothing_behind(arm, loop, clay, addon, monkeypatch, event, stroking):
    from repousse.operators import handlers

    engage(loop, AIR)
    live, before = session.live(), in_file(clay)
    held, engine = press(loop, arm, clay, INTO) if stroking else (None, None)
    if event == "disconnect":
        assert bpy.ops.repousse.arm_disconnect() == {"FINISHED"}
    elif event == "load":
        bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    elif event == "unregister":
        addon.unregister()
        addon.register()
    elif event == "exit":
        handlers.before_exit()
        monkeypatch.setattr(handlers, "_leaving", False)
    elif event == "python's end":
        monkeypatch.setattr(handlers.revisions, "clear", lambda: None)
        handlers.at_exit()
    elif event == "failure":
        monkeypatch.setattr(arm, "look", lambda: 1 / 0)
        arm_session.watch()
        assert "division by zero" in arm_session.farewell()
    else:
        other = FakeLoop(PROFILE)
        assert arm_session.open_arm(other, PROFILE) is arm_session.arm() is not arm
        arm_session.close_arm()
        assert (other.starts, other.stops) == (1, 1)
    assert arm_session.arm() is None and (loop.starts, loop.stops) == (1, 1)
    assert not bpy.app.timers.is_registered(arm_session.watch)
    if not stroking:
        assert not threads() and live.pointer is None
    elif event in ("disconnect", "failure", "another"):
        assert held.over and engine.failure is None and engine.settle(5.0)
        pushed = live.grid.density.copy()
        commit(clay, engine)
        assert same(in_file(the("Clay")), pushed) and not same(pushed, before)
    else:  # as a stroke of the mouse
        assert same(live.grid.density, before)
    assert not threads()


def test_an_arm_that_cannot_be_started_is_not_there(clay, loop, monkeypatch):
    monkeypatch.setattr(loop, "start", lambda: (_ for _ in ()).throw(RuntimeError("no Python to start")))
    with pytest.raises(RuntimeError, match="no Python"):
        arm_session.open_arm(loop, PROFILE)
    assert arm_session.arm() is None and not bpy.app.timers.is_registered(arm_session.watch)


@pytest.fixture
def begun(monkeypatch):
    """How often a stroke was begun."""
    count = []
    monkeypatch.setattr(arm_session.ArmSession, "_begin", lambda self, view: count.append(None))
    return count


def look(times=3):
    for _ in range(times):
        arm_session.watch()


def test_a_press_begins_one_stroke(arm, loop, begun):
    engage(loop, AIR)
    look()
    assert not begun
    loop.put(buttons=1)
    look()
    assert len(begun) == 1
    loop.put(buttons=0)
    look()
    loop.put(buttons=1)
    look()
    assert len(begun) == 2


def test_a_button_that_is_held_already_begins_none(clay, loop, begun):
    loop.put(AIR, state=State.RUN, buttons=1)
    arm_session.open_arm(loop, PROFILE)
    until(lambda: loop.model is not None, "a model")
    look()
    assert not begun
    bpy.context.scene.repousse.radius *= 2
    look(6)
    assert not begun
    loop.put(buttons=0)
    look()
    loop.put(buttons=1)
    look()
    assert len(begun) == 1


@pytest.mark.parametrize("state", [State.HOMED, State.OPEN, State.SAFE])
def test_an_arm_that_is_not_armed_begins_none(arm, loop, begun, state):
    engage(loop, AIR)
    loop.put(state=state)
    look()
    loop.put(buttons=1)
    look()
    assert not begun
    loop.put(state=State.RUN)
    look()
    assert not begun, "the button was pressed before it meant anything"


def test_by_touch_a_stroke_begins_where_the_clay_is_felt(arm, loop, begun):
    with preferring(stroke_on="TOUCH"):
        engage(loop, AIR)
        look()
        loop.put(buttons=1)
        look()
        assert not begun, "a button is not asked for"
        loop.put(TOUCHING)
        until(lambda: begun, "the touch to begin a stroke")
        look()
        assert len(begun) == 1


def test_by_touch_nothing_begins_while_force_is_kept_out(arm, loop, begun):
    """After undo the tool may be in the clay: it has to come out first."""
    with preferring(stroke_on="TOUCH"):
        engage(loop, AIR)
        loop.put(TOUCHING, state=State.ARMED, waiting=True)
        until(lambda: feels(loop), "the clay to be felt")
        look()
        assert not begun


def test_an_arm_without_a_button_strokes_by_touch(clay, begun):
    bare = replace(PROFILE, buttons=0)
    loop = FakeLoop(bare)
    arm_session.open_arm(loop, bare)
    engage(loop, AIR)
    look()
    loop.put(TOUCHING)
    until(lambda: begun, "the touch to begin a stroke")


def test_by_touch_a_stroke_ends_out_of_the_clay_and_not_at_once(arm, loop, clay, monkeypatch):
    with preferring(stroke_on="TOUCH"):
        engage(loop, AIR)
        held, engine = press(loop, arm, clay, INTO)
        now = [time.perf_counter()]
        monkeypatch.setattr(arm_session.time, "perf_counter", lambda: now[0])
        loop.put(AIR)
        until(lambda: engine.model.stress == 0.0, "the tool to be out")
        now[0] += arm_session.LINGER / 2
        look()
        assert not held.over
        loop.put(TOUCHING)
        until(lambda: engine.model.stress > 0.0, "the tool to be in")
        look()
        loop.put(AIR)
        until(lambda: engine.model.stress == 0.0, "the tool to be out")
        now[0] += 0.6 * arm_session.LINGER
        look()
        assert not held.over, "what was touched in between does not count"
        now[0] += 0.6 * arm_session.LINGER
        look()
        assert held.over and not held.trouble
        commit(clay, engine)


def test_with_the_clutch_held_the_tool_stays_and_goes_on_from_there(arm, loop):
    engage(loop, at(0.2, 0.1, TOP + 5 * EDGE))
    look()
    stayed = session.live().pointer.position
    assert bpy.ops.repousse.arm_clutch() == {"FINISHED"}
    assert arm.clutched and loop.orders[-1] == ("clutch", True)
    loop.put(at(-0.4, 0.0, 0.0))
    look()
    assert session.live().pointer.position == stayed and loop.model is None and not threads()
    bpy.ops.repousse.arm_clutch()
    assert not arm.clutched and loop.orders[-1] == ("clutch", False)
    look()
    assert session.live().pointer.position == pytest.approx(stayed, abs=1e-5)
    loop.put(at(-0.3, 0.0, 0.0))
    look()
    assert session.live().pointer.position == pytest.approx(np.add(stayed, (0.1, 0.0, 0.0)), abs=1e-5)


def test_the_clutch_ends_a_stroke(arm, loop, clay):
    engage(loop, AIR)
    held, engine = press(loop, arm, clay, INTO)
    arm.set_clutch(True)
    assert held.over and not held.trouble
    commit(clay, engine)


def test_the_second_button_is_the_clutch(arm, loop):
    engage(loop, AIR)
    loop.put(buttons=2)
    look()
    assert arm.clutched
    loop.put(buttons=0)
    look()
    assert not arm.clutched
    assert [order for order in loop.orders if order[0] == "clutch"] == [("clutch", True), ("clutch", False)]


def test_the_clutch_needs_a_pose(arm, loop):
    loop.put(state=State.OPEN)
    with pytest.raises(RuntimeError, match="Home the arm first"):
        bpy.ops.repousse.arm_clutch()
    assert not arm.clutched


def test_the_orders_reach_the_loop(arm, loop):
    orders = bpy.ops.repousse
    loop.put(state=State.OPEN)
    assert not orders.arm_arm.poll() and orders.arm_home.poll()
    orders.arm_home()
    loop.put(state=State.HOMED)
    orders.arm_arm()
    loop.put(state=State.RUN)
    assert not orders.arm_home.poll()
    orders.arm_disarm()
    assert loop.orders == ["home", "arm", "disarm"]
    assert not orders.arm_connect.poll()
    arm_session.close_arm()
    assert orders.arm_connect.poll()
    for verb in ("home", "arm", "disarm", "clutch", "disconnect"):
        assert not getattr(orders, f"arm_{verb}").poll()


def test_the_force_is_scaled_as_preferred(arm, loop):
    with preferring(force_scale=0.25):
        look()
        look()
        assert loop.orders == [("force_scale", 0.25)]


def test_clay_without_clay_is_not_felt(arm, loop, clay):
    live = session.live()
    live.grid.density[:] = 0.0
    live.changed(None)
    loop.put(TOUCHING, state=State.RUN)
    look(5)
    assert "empty" in arm.message and loop.model is None and not threads()
    assert live.pointer is not None
    live.grid.density[:] = 1.0
    live.changed(None)
    until(lambda: feels(loop), "the clay to be felt")
    assert arm.message == ""


def test_a_stroke_of_an_arm_that_is_not_ready_is_refused(arm, loop, clay):
    loop.put(AIR, state=State.HOMED)
    until(lambda: loop.model is not None, "a model")
    with pytest.raises(ValueError, match="not ready"):
        take(arm, clay)
    assert session.live().engine is None


def test_what_a_thread_calls_knows_no_blender():
    for module in (arm_hand, arm_mapping):
        assert "bpy" not in vars(module)


def test_what_a_stroke_has_left_is_felt_before_it_is_written(arm, loop, clay):
    """To write a large volume takes longer than a model may be old."""
    scene = engage(loop, AIR)
    held, engine = press(loop, arm, clay, INTO)
    loop.put(buttons=0)
    until(lambda: held.over, "the stroke to end")
    engine.finish()
    live = session.live()
    arm_session.feel_on(live, clay)
    sent = len(loop.sent)
    until(lambda: len(loop.sent) > sent + 3, "what is there to be felt", 5.0)
    assert live.engine is engine and feels(loop, scene) and not live.feeling.deform
    feeling = live.feeling
    commit(clay, engine)
    look()
    assert live.feeling is feeling and loop.model.scene == scene
