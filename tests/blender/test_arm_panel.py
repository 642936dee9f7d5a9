# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of the arm, drawn on paper: what it says and offers in each state of an arm that is only told of."""

from types import SimpleNamespace

import bpy
import pytest

from repousse.device.fault import Fault, State, fault_text, state_text
from repousse.device.haptic_loop import LoopHealth
from repousse.device.limits import limits_of
from repousse.device.protocol import ArmState, Figures
from repousse.operators import arm_devices
from repousse.ui import arm_panel

from .paper import draw

HEALTH = LoopHealth(
    Figures(rate=999.6, longest=0.0042, lost=3, superseded=14, realtime=True),
    period=(0.001, 0.00125, 0.00187),
    work=(41e-6, 58e-6, 73e-6),
)


class Region:
    """As wide as no text is long."""

    width = 9000


@pytest.fixture
def wide():
    """A context in which no text is broken."""
    return SimpleNamespace(region=Region, preferences=bpy.context.preferences)


@pytest.fixture
def preferences():
    told = arm_devices.preferences_of(bpy.context)
    for name in type(told).__annotations__:
        told.property_unset(name)
    yield told
    for name in type(told).__annotations__:
        told.property_unset(name)
    arm_devices._listing = arm_devices._NOTHING


@pytest.fixture
def arm(monkeypatch, preferences):
    """Connects an arm that is in a state: the panel's own view of it."""

    def connect(key="phantom-premium-1.5", health=HEALTH, clutched=False, message="", **told):
        profile = arm_devices.catalogue().profiles[key]
        session = SimpleNamespace(
            profile=profile,
            loop=SimpleNamespace(link=profile.links[0]),
            state=ArmState(**told),
            health=health,
            clutched=clutched,
            message=message,
        )
        monkeypatch.setattr(arm_panel, "arm", lambda: session)
        return session

    return connect


def panel(context):
    return draw(bpy.types.REPOUSSE_PT_arm, context)


def bars(paper):
    return [(call.given["text"], call.given["factor"]) for call in paper.calls if call.name == "progress"]


def test_without_an_arm_it_can_be_connected_and_nothing_else(wide, preferences):
    paper = panel(wide)
    verbs = {name for name in paper.operators() if name.startswith("repousse.")}
    assert verbs == {"repousse.arm_connect"}
    assert "Emulated Arm" in paper.texts and bars(paper) == []
    assert (preferences, "profile") in paper.shown("prop")


def test_the_preferences_can_be_opened_from_the_panel(addon):
    [shown] = draw(bpy.types.REPOUSSE_PT_arm, method="draw_header_preset").operators().values()
    assert shown == {"module": addon.__package__}


def test_an_arm_that_is_not_seen_can_be_looked_for_and_not_connected(wide, preferences):
    preferences.device = "1234:0006"
    paper = panel(wide)
    assert "repousse.arm_refresh" in paper.operators()
    assert any("press Refresh" in text for text in paper.texts)
    assert "repousse.arm_connect" not in paper.operators()


def test_why_the_last_arm_is_gone_is_told_until_there_is_another(wide, arm, monkeypatch):
    monkeypatch.setattr(arm_panel, "farewell", lambda: "The arm was unplugged")
    assert "The arm was unplugged" in panel(wide).texts
    arm(state=State.OPEN)
    assert "The arm was unplugged" not in panel(wide).texts


@pytest.mark.parametrize("state", list(State))
def test_each_state_is_told_in_words_with_what_can_be_done(wide, arm, state):
    arm(state=state)
    paper = panel(wide)
    assert state_text(state) in paper.texts
    moving = state in (State.ARMED, State.RUN)
    assert {"repousse.arm_home", "repousse.arm_clutch", "repousse.arm_disconnect"} <= set(paper.operators())
    assert ("repousse.arm_disarm" in paper.operators()) == moving
    assert ("repousse.arm_arm" in paper.operators()) == (not moving)
    assert "repousse.arm_connect" not in paper.operators()
    icons = {call.given.get("icon") for call in paper.calls if call.given.get("text") == state_text(state)}
    assert icons == {arm_panel.STATE_ICONS[state]} and len(set(arm_panel.STATE_ICONS)) == len(State)
    told = any(text.startswith("Home pose: ") for text in paper.texts)
    assert told == (state in (State.OPEN, State.SAFE))


@pytest.mark.parametrize("fault", list(Fault))
def test_the_reason_of_the_last_fault_is_told(wide, arm, fault):
    arm(state=State.SAFE, fault=fault, message="The volume is linked")
    errors = [call.given["text"] for call in panel(wide).calls if call.given.get("icon") == "ERROR"]
    assert errors == [text for text in (fault_text(fault), "The volume is linked") if text]


def test_the_force_is_a_bar_of_the_most_that_is_allowed(wide, arm, preferences):
    session = arm(state=State.RUN, force=(1.0, -2.0, 2.0), ramp=1.0)
    most = limits_of(session.profile, session.loop.link).max_force
    [force, _] = bars(panel(wide))
    assert force == (f"3.00 of {most:.2f} N", pytest.approx(3.0 / most))
    preferences.force_scale = 0.5
    [force, _] = bars(panel(wide))
    assert force == (f"3.00 of {most / 2:.2f} N", pytest.approx(6.0 / most))


@pytest.mark.parametrize(
    "force", [(0.0, 0.0, 0.0), (300.0, 0.0, 0.0), (float("nan"), 0.0, 0.0), (float("inf"), 0.0, 0.0)]
)
@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_the_bar_stays_a_bar(wide, arm, preferences, force, scale):
    preferences.force_scale = scale
    arm(state=State.RUN, force=force, heat=7.0)
    assert all(0.0 <= factor <= 1.0 for _, factor in bars(panel(wide)))


def test_a_quarter_of_the_force_is_told_with_its_reason(wide, arm):
    session = arm("woodenhaptics-2019", state=State.HOMED)
    reason = limits_of(session.profile, session.loop.link).reason
    assert "a quarter" in reason and reason in panel(wide).texts
    arm(state=State.HOMED)
    assert not any("a quarter" in text for text in panel(wide).texts)


def test_force_that_comes_in_is_told_as_that(wide, arm):
    arm(state=State.RUN, ramp=0.25)
    assert "Force comes in: 25%" in panel(wide).texts
    for told in {"state": State.RUN, "ramp": 1.0}, {"state": State.HOMED, "ramp": 0.25}:
        arm(**told)
        assert not any(text.startswith("Force comes in") for text in panel(wide).texts)


def test_heat_is_told_and_warned_of(wide, arm):
    for heat, warned in (0.2, False), (0.95, True):
        arm(state=State.RUN, heat=heat, ramp=1.0)
        paper = panel(wide)
        assert bars(paper)[1] == (f"Motor heat {heat:.0%}", pytest.approx(heat))
        assert any("warm" in text for text in paper.texts) == warned


def test_the_clutch_is_seen_to_be_held(wide, arm):
    for clutched in False, True:
        arm(state=State.RUN, clutched=clutched)
        [clutch] = [call for call in panel(wide).calls if call.given.get("operator") == "repousse.arm_clutch"]
        assert clutch.given["depress"] is clutched


def test_what_is_set_while_working_can_be_set_with_and_without_an_arm(wide, arm, preferences):
    wanted = {"force_scale", "workspace_scale", "axes", "stroke_on"}
    assert wanted <= {name for data, name in panel(wide).shown("prop") if data == preferences}
    arm(state=State.RUN)
    assert wanted == {name for data, name in panel(wide).shown("prop") if data == preferences}


def test_how_the_loop_fares_is_told_in_numbers(wide, arm):
    assert not bpy.types.REPOUSSE_PT_arm_loop.poll(wide)
    arm(state=State.RUN, model_age=0.0123, slope_asked=900.0, slope_granted=640.0)
    assert bpy.types.REPOUSSE_PT_arm_loop.poll(wide)
    assert draw(bpy.types.REPOUSSE_PT_arm_loop, wide).texts == [
        "1000 periods a second",
        "In real time",
        "Period 1.00 ms, p99 1.25, p99.9 1.87",
        "Longest gap 4.20 ms",
        "Work 41 µs, p99 58, p99.9 73",
        "Reports lost 3, overtaken 14",
        "Model 12 ms old",
        "Stiffness 640 of 900 N/m",
    ]
    arm(state=State.RUN, health=LoopHealth(Figures(), (0.0,) * 3, (0.0,) * 3), model_age=25_308.0)
    texts = draw(bpy.types.REPOUSSE_PT_arm_loop, wide).texts
    assert {"Not in real time: other programs may hold it up", "No model"} <= set(texts)


def test_the_panel_asks_for_nothing_but_the_newest_state(wide, preferences, monkeypatch):
    """Not even for the loop's percentiles, unless they are shown; and nothing of the arm is called."""

    class Session:
        profile = arm_devices.catalogue().profiles["phantom-premium-1.5"]
        clutched, message = False, ""
        loop = type("Loop", (), {"link": profile.links[0]})
        asked = 0

        @property
        def state(self):
            Session.asked += 1
            return ArmState(state=State.RUN)

    monkeypatch.setattr(arm_panel, "arm", Session)
    panel(wide)
    assert Session.asked == 1
