# SPDX-License-Identifier: GPL-3.0-or-later
"""The arms that are plugged in, looked for by the real subprocess with a hidapi of ours, and the preferences."""

import json
import os
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from repousse.device import child, profile
from repousse.device.hid_bus import Found
from repousse.operators import arm_devices
from repousse.operators.arm_devices import (
    EMULATED,
    EMULATED_DEVICE,
    NO_PERMISSION,
    READY,
    RULES_FILE,
    UNKNOWN,
    VENDOR_DRIVER,
    Device,
    Listing,
    catalogue,
    chosen,
    is_looking,
    listing,
    parse_devices,
    rule_of,
)
from repousse.ui import preferences as ui
from repousse.ui.words import draw_text

from .paper import Paper

WOODY = {
    "path": "/dev/hidraw3",
    "vendor": 0x1234,
    "product": 0x0006,
    "name": "HID DEVICE",
    "usage_page": 0xFFAB,
    "report_length": 14,
    "state": READY,
    "message": "",
    "candidates": [["woodenhaptics-2015", "mbed-14"], ["woodenhaptics-2019", "mbed-14"]],
}
WOODY_ID, TOUCH_ID = "1234:0006", "2988:0304"
HID = """
import os, time
folder = {folder!r}
def enumerate(vendor=0, product=0):
    with open(folder + "/asked", "a") as file:
        file.write(str(os.getpid()) + "\\n")
    {body}
def device():
    open(folder + "/opened", "w").close()
    raise OSError("nobody asked for this")
"""
PLUGGED = [
    {"path": b"/dev/null", "vendor_id": 0x1234, "product_id": 0x0006, "product_string": "HID DEVICE"},
    {"path": b"/dev/repousse-none", "vendor_id": 0x16C0, "product_id": 0x0486, "product_string": "Teensy\x1b[31m\n"},
    {"path": b"/dev/null", "vendor_id": 0x2988, "product_id": 0x0304, "product_string": "Touch"},
    {"path": b"/dev/null", "vendor_id": 0x046D, "product_id": 0xC52B, "product_string": "A mouse"},
]


@pytest.fixture
def preferences():
    """The add-on's preferences, all at their defaults before and after."""
    told = arm_devices.preferences_of(bpy.context)

    def unset():
        for name in type(told).__annotations__:
            told.property_unset(name)

    unset()
    yield told
    unset()


@pytest.fixture(autouse=True)
def nothing_found():
    yield
    arm_devices.end_look()
    arm_devices._listing = arm_devices._NOTHING
    catalogue.cache_clear()


@pytest.fixture
def hidapi(tmp_path, monkeypatch):
    """A function that puts a module of ours in hidapi's place, whose ``enumerate`` is a body."""

    def put(body=f"return {PLUGGED!r}"):
        (tmp_path / "hid.py").write_text(HID.format(folder=str(tmp_path), body=body), encoding="utf-8")
        monkeypatch.setattr(child, "find_hidapi", lambda: ["hid", str(tmp_path / "hid.py")])
        return tmp_path

    return put


@pytest.fixture
def own_profiles(tmp_path, monkeypatch):
    """The folder of the artist's own profiles."""
    folder = tmp_path / "profiles"
    monkeypatch.setattr(arm_devices, "profiles_folder", lambda: folder)
    folder.mkdir()
    return folder


def found(*devices):
    """Let the last look have found these."""
    arm_devices._listing = Listing((*arm_devices._NOTHING.devices, *devices), looked=True)


def until(condition, what):
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.005)


def woody(state=READY, message=""):
    return Device(WOODY_ID, "HID DEVICE", state, message, "/dev/hidraw3", tuple(map(tuple, WOODY["candidates"])))


def shown(preferences):
    paper = Paper()
    drawn = SimpleNamespace(layout=paper)
    wide = SimpleNamespace(region=SimpleNamespace(width=4000), preferences=bpy.context.preferences)
    for name in (*type(preferences).__annotations__, "bl_rna"):
        setattr(drawn, name, getattr(preferences, name))
    type(preferences).draw(drawn, wide)
    return paper


def test_a_look_asks_hidapi_in_another_process_and_opens_nothing(hidapi):
    folder = hidapi()
    assert bpy.ops.repousse.arm_refresh() == {"FINISHED"}
    [process] = {int(line) for line in (folder / "asked").read_text().split()}
    assert process != os.getpid()
    assert not (folder / "opened").exists()
    assert not {"hid", "hidraw"} & set(sys.modules)
    emulated, woody, touch, teensy = listing().devices
    assert (emulated.identifier, emulated.state) == (EMULATED_DEVICE, EMULATED)
    assert (woody.identifier, woody.name, woody.state, woody.path) == (WOODY_ID, "HID DEVICE", READY, "/dev/null")
    assert {key for key, _ in woody.candidates} >= {"woodenhaptics-2015", "woodenhaptics-2019"}
    assert (touch.identifier, touch.state, touch.candidates) == (TOUCH_ID, VENDOR_DRIVER, ())
    assert (teensy.name, teensy.state) == ("Teensy [31m", NO_PERMISSION)
    assert listing().looked and not listing().error


def test_blender_does_not_wait_for_a_look(hidapi, preferences):
    waiting = f"while not os.path.exists(folder + '/go'): time.sleep(0.005)\n    return {PLUGGED!r}"
    folder = hidapi(waiting)
    button = SimpleNamespace()
    assert arm_devices.REPOUSSE_OT_arm_refresh.invoke(button, bpy.context, None) == {"FINISHED"}
    assert is_looking() and listing() == arm_devices._NOTHING
    assert bpy.app.timers.is_registered(arm_devices.take_look)
    assert arm_devices.take_look() == arm_devices.TICK
    paper = shown(preferences)
    assert "Looking for arms" in paper.texts and "repousse.arm_refresh" not in paper.operators()
    assert not bpy.ops.repousse.arm_refresh.poll()
    bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    assert bpy.app.timers.is_registered(arm_devices.take_look)  # another file changes nothing about it
    (folder / "go").touch()
    until(lambda: arm_devices.take_look() is None, "the end of the look")
    assert len(listing().devices) == 4 and not is_looking()
    assert "repousse.arm_refresh" in shown(preferences).operators()


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("raise OSError('the bus is on fire')", "the devices cannot be listed: the bus is on fire"),
        ("os._exit(3)", "The devices cannot be listed"),
        ("print('nonsense'); return []", "What was found cannot be read"),
        ("time.sleep(60)", "The devices were not listed within 0.5 s: unplug what hangs, and try again"),
    ],
)
def test_a_look_that_fails_is_told_in_one_line_and_the_emulated_arm_stays(hidapi, preferences, monkeypatch, body, told):
    hidapi(body)
    if "60" in body:
        monkeypatch.setattr(arm_devices, "LIMIT", 0.5)
    begun = time.monotonic()
    arm_devices.start_look()
    process = arm_devices._look._process
    arm_devices._look.wait()
    arm_devices.take_look()
    assert time.monotonic() - begun < 40.0  # it is killed, not waited for
    assert listing().error.startswith(told) and listing().devices == arm_devices._NOTHING.devices
    assert process.poll() is not None
    assert any(text.startswith(told) for text in shown(preferences).texts)


def test_without_hidapi_it_is_said_what_to_do(monkeypatch):
    monkeypatch.setattr(child, "find_hidapi", lambda: None)
    bpy.ops.repousse.arm_refresh()
    assert "install Repoussé anew" in listing().error
    assert [device.identifier for device in listing().devices] == [EMULATED_DEVICE]


def test_a_look_ends_with_the_add_on(hidapi):
    folder = hidapi("time.sleep(60)")
    arm_devices.start_look()
    process, thread = arm_devices._look._process, arm_devices._look._thread
    until((folder / "asked").exists, "the subprocess")
    begun = time.monotonic()
    arm_devices.unregister()
    try:
        assert time.monotonic() - begun < arm_devices.LIMIT / 2
        assert process.poll() is not None and not thread.is_alive()
        assert not bpy.app.timers.is_registered(arm_devices.take_look) and not is_looking()
    finally:
        arm_devices.register()


def test_nothing_is_looked_for_unasked(preferences, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("nobody has asked")

    shown(preferences)
    monkeypatch.setattr(child, "start", refuse)
    monkeypatch.setattr(child, "find_hidapi", refuse)
    monkeypatch.setattr("builtins.open", refuse)
    monkeypatch.setattr(Path, "open", refuse)
    found(woody(NO_PERMISSION, "no"))
    preferences.device = WOODY_ID
    threads = threading.active_count()
    for _ in range(2):
        shown(preferences)
    arm_devices.unregister(), arm_devices.register()
    with pytest.raises(ValueError, match="press Refresh"):
        chosen(preferences)
    assert threading.active_count() == threads


def test_what_the_subprocess_tells_is_what_is_expected_here():
    assert set(WOODY) == set(Found.__dataclass_fields__)
    assert parse_devices(json.dumps([WOODY])) == (woody(),)


def test_two_arms_of_a_kind_are_told_apart_in_the_same_order_however_they_are_listed():
    second = WOODY | {"path": "/dev/hidraw4"}
    for entries in [WOODY, second], [second, WOODY]:
        devices = parse_devices(json.dumps(entries))
        assert [(d.identifier, d.path) for d in devices] == [
            (WOODY_ID, "/dev/hidraw3"),
            (f"{WOODY_ID} #2", "/dev/hidraw4"),
        ]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[1]",
        "[" * 100_000,
        json.dumps([WOODY] * 65),
        *(json.dumps([{key: WOODY[key] for key in WOODY if key != left}]) for left in ("path", "vendor", "candidates")),
        *(
            json.dumps([WOODY | changed])
            for changed in (
                {"vendor": "1234"},
                {"name": 7},
                {"message": None},
                {"state": "emulated"},
                {"candidates": [["one"]]},
                {"candidates": 3},
            )
        ),
        json.dumps([WOODY, WOODY | {"path": 3}]),
    ],
)
def test_a_list_that_makes_no_sense_is_refused_in_one_line(text):
    with pytest.raises(ValueError, match="What was found cannot be read") as error:
        parse_devices(text)
    assert "\n" not in str(error.value)


def test_a_name_from_a_device_is_shown_as_one_short_line():
    [device] = parse_devices(json.dumps([WOODY | {"name": "\x00\u202e\r\n" + "n" * 5000}]))
    assert device.name.isprintable() and set(device.name) <= {"n"} and len(device.name) <= arm_devices.MOST_TEXT
    [device] = parse_devices(json.dumps([WOODY | {"name": "\n"}]))
    assert device.name == WOODY_ID


def test_preferences_are_those_of_the_add_on_itself(addon, preferences):
    kind = bpy.types.RepoussePreferences if hasattr(bpy.types, "RepoussePreferences") else type(preferences)
    assert kind.bl_idname == addon.__package__
    assert (preferences.device, preferences.profile) == (EMULATED_DEVICE, "phantom-premium-1.5")
    assert (preferences.axes, preferences.stroke_on) == ("VIEW", "BUTTON")
    assert (preferences.force_scale, preferences.workspace_scale) == (1.0, 1.0)
    assert preferences.emulated_script == ""
    preferences.force_scale = 7.0
    assert preferences.force_scale == 1.0


def test_every_preference_can_be_reached_and_is_explained(preferences):
    paper = shown(preferences)
    reached = {name for _, name in paper.shown("prop")} | {"device"}
    assert reached == set(type(preferences).__annotations__)
    described = [preferences.bl_rna.properties[name] for name in type(preferences).__annotations__]
    assert [one.identifier for one in described if not one.description] == []
    chosen_from = [item for one in described if one.type == "ENUM" for item in one.enum_items_static]
    assert [item.identifier for item in chosen_from if not item.description] == []
    found(woody())
    preferences.device = WOODY_ID
    assert "emulated_script" not in {name for _, name in shown(preferences).shown("prop")}


def test_every_arm_is_listed_with_its_state_and_the_chosen_one_marked(preferences):
    devices = [
        woody(),
        Device(
            "16c0:0486", "Teensy", NO_PERMISSION, "You may not", "/dev/hidraw5", (("phantom-vintage", "teensy-64"),)
        ),
        Device(TOUCH_ID, "Touch", VENDOR_DRIVER, "Needs a driver", "/dev/hidraw0"),
    ]
    found(*devices)
    preferences.device = WOODY_ID
    paper = shown(preferences)
    buttons = [call for call in paper.calls if call.given.get("operator") == "repousse.arm_choose"]
    assert [call.asked["device"] for call in buttons] == [EMULATED_DEVICE, WOODY_ID, "16c0:0486", TOUCH_ID]
    assert [call.given["depress"] for call in buttons] == [False, True, False, False]
    words = [ui.STATES[state][0] for state in (EMULATED, READY, NO_PERMISSION, VENDOR_DRIVER)]
    assert [text for text in paper.texts if text in {word for word, _ in ui.STATES.values()}] == words
    preferences.device = "abcd:0001"
    assert ui.STATES[UNKNOWN][0] in shown(preferences).texts
    assert set(ui.STATES) == set(arm_devices.STATES)


def test_an_arm_that_may_not_be_used_comes_with_its_rule_and_a_button_to_copy_it(preferences):
    found(woody(NO_PERMISSION, "/dev/hidraw3: you may not read and write it"))
    preferences.device = WOODY_ID
    paper = shown(preferences)
    rule = rule_of(woody(NO_PERMISSION))
    assert rule.splitlines() == [
        f"# {RULES_FILE}",
        'KERNEL=="hidraw*", ATTRS{idVendor}=="1234", ATTRS{idProduct}=="0006", TAG+="uaccess"',
    ]
    assert Path(RULES_FILE).name < "73"  # where systemd hands devices to who sits there
    assert set(rule.splitlines()) <= set(paper.texts)
    assert any(RULES_FILE in text and text.startswith("Save") for text in paper.texts)
    assert paper.operators()["repousse.arm_copy_rule"] == {"device": WOODY_ID}
    for state in READY, VENDOR_DRIVER:
        found(woody(state, "no"))
        assert rule_of(woody(state)) == "" and "repousse.arm_copy_rule" not in shown(preferences).operators()


def test_the_rule_is_copied(preferences):
    found(woody(NO_PERMISSION, "no"))
    context = SimpleNamespace(window_manager=SimpleNamespace(clipboard=""))
    reports = []
    button = SimpleNamespace(device=WOODY_ID, report=lambda *told: reports.append(told))
    execute = arm_devices.REPOUSSE_OT_arm_copy_rule.execute
    assert execute(button, context) == {"FINISHED"}
    assert context.window_manager.clipboard == rule_of(woody(NO_PERMISSION))
    assert RULES_FILE in reports[0][1]
    context.window_manager.clipboard = "mine"
    button.device = EMULATED_DEVICE
    assert execute(button, context) == {"CANCELLED"} and context.window_manager.clipboard == "mine"


def test_choosing_an_arm_chooses_a_profile_that_fits_it(preferences):
    found(woody())
    bpy.context.preferences.is_dirty = False
    bpy.ops.repousse.arm_choose(device=WOODY_ID)
    assert (preferences.device, preferences.profile) == (WOODY_ID, "woodenhaptics-2015")
    assert bpy.context.preferences.is_dirty  # Blender writes them when it ends
    preferences.profile = "woodenhaptics-2019"
    bpy.ops.repousse.arm_choose(device=EMULATED_DEVICE)
    bpy.ops.repousse.arm_choose(device=WOODY_ID)
    assert preferences.profile == "woodenhaptics-2019"


def test_what_is_chosen_is_what_is_driven(preferences):
    told, link, path = chosen(preferences)
    assert (told.key, path) == ("phantom-premium-1.5", EMULATED_DEVICE) and link in told.links
    found(woody())
    preferences.device, preferences.profile = WOODY_ID, "woodenhaptics-2019"
    told, link, path = chosen(preferences)
    assert (told.key, link.name, path) == ("woodenhaptics-2019", "mbed-14", "/dev/hidraw3")


@pytest.mark.parametrize(
    ("device", "key", "told"),
    [
        (None, "woodenhaptics-2019", "has not been seen: plug it in and press Refresh"),
        (woody(NO_PERMISSION, "you may not"), "woodenhaptics-2019", "HID DEVICE: you may not"),
        (woody(VENDOR_DRIVER, "closed driver"), "woodenhaptics-2019", "HID DEVICE: closed driver"),
        (woody(), "phantom-vintage", "does not fit the profile"),
    ],
)
def test_what_cannot_be_driven_says_why_in_the_preferences(preferences, device, key, told):
    if device is not None:
        found(device)
    preferences.device, preferences.profile = WOODY_ID, key
    with pytest.raises(ValueError, match=told) as error:
        chosen(preferences)
    assert str(error.value) in shown(preferences).texts


def test_a_profile_that_cannot_be_emulated_is_not(preferences):
    key = next(key for key, told in catalogue().profiles.items() if told.emulated is None)
    preferences.profile = key
    with pytest.raises(ValueError, match="cannot be emulated"):
        chosen(preferences)


def test_only_arms_that_can_be_driven_are_profiles_to_choose(preferences):
    keys = {item[0] for item in ui._profile_items(preferences, bpy.context)}
    assert keys == {key for key, told in profile.builtin_profiles().items() if told.driven}
    assert "touch-hid" in profile.builtin_profiles() and "touch-hid" not in keys


def test_an_artists_own_profile_is_there_after_a_refresh_and_moves_no_other(preferences, hidapi, own_profiles):
    hidapi("return []")
    preferences.profile = "woodenhaptics-2019"
    text = Path(profile.__file__).with_name("profiles").joinpath("aluhaptics.toml").read_text(encoding="utf-8")
    for key in "aaa", "zzz":
        mine = text.replace('key = "aluhaptics"', f'key = "{key}"')
        (own_profiles / f"{key}.toml").write_text(mine, encoding="utf-8")
    (own_profiles / "wrong.toml").write_text(text.replace("max_force", "most_force"), encoding="utf-8")
    bpy.ops.repousse.arm_refresh()
    assert preferences.profile == "woodenhaptics-2019"
    preferences.profile = "zzz"
    assert {"aaa", "zzz"} <= set(catalogue().profiles)
    (own_profiles / "aaa.toml").unlink()
    bpy.ops.repousse.arm_refresh()
    assert preferences.profile == "zzz"
    [line] = [text for text in shown(preferences).texts if "wrong.toml" in text]
    assert "force" in line
    (own_profiles / "zzz.toml").unlink()
    bpy.ops.repousse.arm_refresh()
    with pytest.raises(ValueError, match="no such profile"):
        chosen(preferences)


@pytest.mark.parametrize(("width", "most"), [(200, 24), (4000, 1000), (0, 24)])
def test_a_long_text_is_all_there_on_lines_that_fit(width, most):
    text = "The arm has stopped reporting: check its cable and power, then home and arm again"
    context = SimpleNamespace(region=SimpleNamespace(width=width), preferences=bpy.context.preferences)
    paper = Paper()
    draw_text(paper, context, text, icon="ERROR")
    assert " ".join(paper.texts) == text and max(map(len, paper.texts)) <= most
    icons = [call.given["icon"] for call in paper.calls if call.name == "label"]
    assert icons == ["ERROR"] + ["BLANK1"] * (len(icons) - 1) and (len(icons) > 1) == (most < 100)
