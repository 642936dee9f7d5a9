# SPDX-License-Identifier: GPL-3.0-or-later
"""What an emulated hand wants: smooth from keyframe to keyframe, and read from a script that may say anything."""

import json
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.device.hand import (
    LARGEST_SCRIPT,
    LINEAR,
    Hand,
    Intention,
    IntentionError,
    Keyframe,
    built_in,
    load_intention,
)

KEYS = (
    Keyframe(0.5, (0.0, 0.0, 0.03)),
    Keyframe(1.5, (0.01, -0.02, -0.01), button=True),
    Keyframe(2.0, (0.02, 0.02, 0.0)),
)
HEADER = {"intention": 1}


def script(tmp_path, *lines):
    path = tmp_path / "hand.jsonl"
    path.write_bytes(b"\n".join(line if isinstance(line, bytes) else json.dumps(line).encode() for line in lines))
    return path


def test_it_is_at_each_keyframe_at_its_time_and_at_rest_there():
    intention = Intention(KEYS)
    for key in KEYS:
        position, velocity, button = intention.at(key.time)
        assert position == pytest.approx(key.position, abs=1e-15)
        assert velocity == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
        assert button == key.button
    assert intention.at(0.0) == (KEYS[0].position, (0.0, 0.0, 0.0), False)
    assert intention.at(99.0) == (KEYS[-1].position, (0.0, 0.0, 0.0), False)


def test_minimum_jerk_goes_half_the_way_in_half_the_time_at_fifteen_eighths_of_the_mean_speed():
    position, velocity, button = Intention(KEYS).at(1.0)
    assert position == pytest.approx((0.005, -0.01, 0.01))
    assert velocity == pytest.approx(tuple(1.875 * way for way in (0.01, -0.02, -0.04)))
    assert not button  # it goes down at the keyframe that says so


@pytest.mark.parametrize("interpolation", ["minimum-jerk", LINEAR])
@given(time=st.floats(0.01, 5.9).filter(lambda time: all(abs(time % 2.0 - at) > 2e-3 for at in (0, 0.5, 1.5, 2))))
def test_its_velocity_is_the_slope_of_its_position(interpolation, time):
    intention = Intention(KEYS, interpolation, loop=True)
    before, after = intention.at(time - 1e-6)[0], intention.at(time + 1e-6)[0]
    slope = tuple((b - a) / 2e-6 for a, b in zip(before, after))
    assert intention.at(time)[1] == pytest.approx(slope, abs=1e-6)


def test_a_loop_comes_round_without_a_leap():
    intention = built_in(0.1)
    end = intention.keyframes[-1].time
    for once, again in zip(intention.at(0.7), intention.at(end + 0.7)):
        assert again == pytest.approx(once)
    places = [intention.at(number * 1e-3)[0] for number in range(int(2.5 * end * 1000))]
    assert all(max(abs(b - a) for a, b in zip(one, other)) < 3e-4 for one, other in pairwise(places))


def test_the_built_in_hand_stays_in_the_workspace_and_holds_the_button_down_where_it_presses():
    intention = built_in(0.1)
    samples = [intention.at(number * 0.01) for number in range(900)]
    assert all(sum(axis * axis for axis in position) < 0.1**2 for position, _, _ in samples)
    assert {button for position, _, button in samples if position[2] < -0.02} == {True}
    assert not any(button for position, _, button in samples if position[2] == pytest.approx(0.03, abs=1e-9))


def test_a_script_is_read_as_it_was_written(tmp_path):
    path = script(
        tmp_path,
        {"intention": 1, "interpolation": "linear", "loop": True},
        b"",
        {"time": 0, "position": [0, 0, 0.02]},
        {"time": 1.5, "position": [0.01, 0, -0.02], "button": True},
    )
    assert load_intention(path) == Intention(
        (Keyframe(0.0, (0.0, 0.0, 0.02)), Keyframe(1.5, (0.01, 0.0, -0.02), True)), "linear", True
    )


@pytest.mark.parametrize(
    "lines, reason",
    [
        ([], "has no positions"),
        ([HEADER], "has no positions"),
        ([{"intention": 2}, {"time": 0, "position": [0, 0, 0]}], "line 1: intention: .*1 to 1"),
        ([HEADER, {"time": 0, "position": [0, 0]}], "line 2: position: .*of 2"),
        ([HEADER, {"time": 0, "position": [0, 0, 5]}], "line 2: position.2: 5 is not from -1 to 1"),
        ([HEADER, b'{"time": NaN, "position": [0, 0, 0]}'], "line 2: time: nan is not"),
        ([HEADER, b'{"time": 0, "position": [0, 0, Infinity]}'], "line 2: position.2: inf"),
        ([HEADER, {"time": 0, "position": [0, 0, 0], "grip": 1}], "line 2: 'grip': there is no such field"),
        ([HEADER, {"position": [0, 0, 0]}], "line 2: time: is missing"),
        ([HEADER, b"", b"{"], "line 3: is not JSON"),
        ([HEADER, b"\xff\xfe"], "line 2: is not JSON"),
        ([HEADER, b"[" * 100000], "line 2: is not JSON"),
        ([HEADER, {"time": 1, "position": [0, 0, 0]}, {"time": 1, "position": [0, 0, 0]}], "1 does not come after 1"),
        ([{"intention": 1, "loop": True}, {"time": 0, "position": [0, 0, 0]}], "loops takes some time"),
        ([HEADER, *[{"time": at, "position": [0, 0, 0]} for at in range(10001)]], "more than 10000 positions"),
        ([b" " * (LARGEST_SCRIPT + 1)], "more than 1048576 bytes"),
    ],
)
def test_a_wrong_script_is_refused_in_one_line(tmp_path, lines, reason):
    with pytest.raises(IntentionError, match=rf"^hand\.jsonl: .*{reason}") as error:
        load_intention(script(tmp_path, *lines))
    assert "\n" not in str(error.value)


def test_a_script_that_is_not_there_or_no_file_is_refused(tmp_path):
    for path in (tmp_path, tmp_path / "none"):
        with pytest.raises(IntentionError, match="is no file"):
            load_intention(path)


@given(content=st.binary(max_size=200))
def test_whatever_a_script_holds_it_is_read_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("fuzz") / "hand.jsonl"
    path.write_bytes(json.dumps(HEADER).encode() + b"\n" + content)
    try:
        intention = load_intention(path)
    except IntentionError:
        return
    assert intention.keyframes


@pytest.mark.parametrize("wrong", [{"mass": -0.1}, {"damping": float("nan")}, {"stiffness": 1e6}])
def test_a_hand_that_no_arm_could_be_held_by_is_refused(wrong):
    with pytest.raises(ValueError, match=f"a hand's {next(iter(wrong))} is from 0"):
        Hand(**wrong)
