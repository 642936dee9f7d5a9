# SPDX-License-Identifier: GPL-3.0-or-later
"""Profiles: what ours say, and that a stranger's file is taken whole or refused with its name, the field and why."""

import copy
import json
import os
import subprocess
import sys
import tomllib
from contextlib import suppress
from dataclasses import fields
from math import inf, isfinite, nan, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.device import kinematics, profile
from repousse.device.profile import (
    DeviceProfile,
    EmulatedPlant,
    Link,
    ProfileError,
    builtin_links,
    builtin_profiles,
    from_json,
    load_profile,
    load_profiles,
    recognise,
    to_json,
)

OURS = list(builtin_profiles().values())
PREMIUM = tomllib.loads((profile.FOLDER / "phantom-premium-1.5.toml").read_text(encoding="utf-8"))
PREMIUM["links"] = [json.loads(to_json(builtin_profiles()["phantom-premium-1.5"]))["links"][0]]
TOUCH = tomllib.loads((profile.FOLDER / "touch-hid.toml").read_text(encoding="utf-8"))

HOSTILE = [
    *(nan, inf, -inf, 1e308, -1e308, 5e-324, -0.0, 10**4000, -(10**4000), 2**63, 0, -1, 1, 1.5, True, False, None),
    *(
        "",
        " ",
        "x" * 5000,
        "a\x00b",
        "a\x1b[2J",
        "\u202e",
        "\ud800",
        "1",
        "none",
        "../../etc/passwd",
        "phantom-vintage",
    ),
    *(
        [],
        [[]],
        [1],
        [1, 2],
        [1, 2, 3],
        [1, 2, 3, 4],
        [nan] * 3,
        [[1, 2]] * 3,
        [[2, 1]] * 3,
        ["own-64"] * 17,
        {},
        {"a": 1},
    ),
    *([0] * 5000, {str(n): n for n in range(2000)}),
]


def places(entry, here=()):
    """The way to every value inside, tables and lists among them."""
    for name, value in entry.items() if isinstance(entry, dict) else enumerate(entry):
        yield (*here, name)
        if isinstance(value, dict | list):
            yield from places(value, (*here, name))


def put(entry, place, value):
    """A copy with another value at a place."""
    made = copy.deepcopy(entry)
    inner = made
    for name in place[:-1]:
        inner = inner[name]
    inner[place[-1]] = value
    return made


def without(entry, place):
    made = copy.deepcopy(entry)
    inner = made
    for name in place[:-1]:
        inner = inner[name]
    del inner[place[-1]]
    return made


def dotted(place):
    return ".".join(map(str, place))


def finite(value):
    if isinstance(value, tuple):
        return all(map(finite, value))
    return not isinstance(value, float) or isfinite(value)


def toml(entry):
    """A profile's entry as TOML: JSON's lists, numbers and texts are TOML's too."""
    tables = {name: value for name, value in entry.items() if isinstance(value, dict)}
    lines = []
    for name, value in entry.items():
        if name == "links":
            links = (value[0] | {"source": "mine"}).items()
            value = "[{" + ", ".join(f"{n} = {json.dumps(v)}" for n, v in links) + "}]"
            lines.append(f"{name} = {value}")
        elif name not in tables:
            lines.append(f"{name} = {json.dumps(value)}")
    for name, value in tables.items():
        lines += [f"[{name}]", *(f"{n} = {json.dumps(v)}" for n, v in value.items())]
    return "\n".join(lines)


def taken_or_refused(entry):
    """The profile, checked to be one that a loop can run on; or what was said against it, checked to be a line."""
    try:
        made = from_json(json.dumps(entry))
    except ProfileError as error:
        said = str(error)
        assert said.startswith("profile: ")
        assert said.isprintable()
        assert len(said) < 300
        return said
    for part in (made, *made.links, *filter(None, [made.emulated])):
        assert all(finite(getattr(part, field.name)) for field in fields(part))
    if made.driven:
        home = kinematics.joint_angles(made, made.home_counts)
        centre = kinematics.angles_of(made, made.workspace_centre)
        for angles in (home, centre):
            assert kinematics.beyond_limits(made, angles) <= 0.0
            assert finite(kinematics.position(made, angles))
            assert finite(kinematics.currents(made, angles, (made.max_force, 0.0, made.max_force)))
            assert finite(kinematics.motor_torques(made, (made.max_current,) * 3))
    return made


# ours


def test_ours():
    driven = {p.key for p in OURS if p.driven}
    assert driven == {
        "woodenhaptics-2015",
        "woodenhaptics-2019",
        "aluhaptics",
        "phantom-vintage",
        "phantom-premium-1.5",
    }
    assert {p.key for p in OURS} - driven == {"touch-hid", "touch-usb", "omni"}
    assert {path.stem for path in profile.FOLDER.glob("*.toml")} == {p.key for p in OURS} | {"links"}


@pytest.mark.parametrize("ours", OURS, ids=lambda p: p.key)
def test_each_of_ours_is_the_same_on_the_other_side(ours):
    line = to_json(ours)
    assert "\n" not in line
    assert from_json(line) == ours


@pytest.mark.parametrize("ours", [p for p in OURS if p.driven], ids=lambda p: p.key)
def test_each_of_ours_says_what_an_owner_must_know(ours):
    assert ours.home_pose
    assert not ours.message
    centre = kinematics.angles_of(ours, ours.workspace_centre)
    strengths = [
        ours.max_current / max(map(abs, kinematics.currents(ours, centre, axis)))
        for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    ]
    assert ours.max_force < 1.1 * max(strengths), "a force that its motors can give, or a little more"


def test_what_is_read_is_what_the_file_says():
    """One of each: from degrees and signs to links by name."""
    premium = builtin_profiles()["phantom-premium-1.5"]
    assert premium.lengths == (0.0, 0.20955, 0.169545)
    assert premium.transmission == pytest.approx((13.3, 11.2, 11.2))
    assert premium.joint_limits[2] == pytest.approx((-29 * pi / 180, 214 * pi / 180), abs=1e-4)
    assert premium.joint_limits[1] == pytest.approx((pi / 2 - 119 * pi / 180, pi / 2 + 124 * pi / 180), abs=1e-4)
    assert premium.difference_limits == pytest.approx((-55 * pi / 180, 65 * pi / 180), abs=1e-4)
    assert premium.links == (builtin_links()["own-64"],)
    vintage = builtin_profiles()["phantom-vintage"]
    assert vintage.sign == (-1, 1, -1)
    assert [link.name for link in vintage.links] == ["mbed-14", "teensy-64"]
    assert builtin_links()["mbed-14"] == Link(
        name="mbed-14",
        source=builtin_links()["mbed-14"].source,
        vendor=0x1234,
        product=6,
        layout="protocol-2",
        usage_page=0xFFAB,
        usage=0x200,
        report_length=14,
        lock_step=True,
        firmware_watchdog_ms=500.0,
        firmware_current_limit=3.0,
    )


def test_the_premiums_plant_is_that_of_its_published_bodies():
    """Rigid bodies on a parallel linkage: mass, centre of mass (m) and inertia about it (kg m^2: xx, yy, zz) from
    PhantomModel.hpp. x and y are along and across the body in the arm's plane (DF and C: across and along); z is across
    the plane."""
    l1, l3 = 0.20955, 0.03175
    a, c = (0.026220, -0.05237892, 6.029e-5, 5.7e-7, 6.004e-5), (0.026146, 0.10477739, 1.3177e-4, 8.9e-7, 1.3138e-4)
    be_mass, be_x, be_z, be = 0.267840, -0.03518875, 0.00232416, (1.133e-4, 9.1667e-4, 8.2222e-4)
    df_mass, df_x, df_y, df_z, df = 0.215420, -0.05153541, 6.0903e-4, 0.00402873, (1.214e-4, 2.6133e-4, 1.5823e-4)
    g_mass, g_x, g_y, g_zz = 0.361590, -0.01048563, 0.01396387, 9.3887e-4
    plant = builtin_profiles()["phantom-premium-1.5"].emulated
    link_b = c[4] + c[0] * c[1] ** 2 + be[2] + be_mass * be_x**2 + a[0] * l1**2
    link_c = a[4] + a[0] * a[1] ** 2 + df[2] + df_mass * (df_x**2 + df_y**2) + c[0] * l3**2
    coupling = a[0] * l1 * -a[1] + c[0] * l3 * c[1]
    assert plant.link_inertia == pytest.approx((link_b, link_c), rel=1e-3)
    assert plant.coupling == pytest.approx(coupling, rel=1e-3)
    # About the vertical, in the poses where link B stands (tB = 0) or lies (pi/2), and link C hangs (tC = 0) or lies.
    standing = g_zz + g_mass * (g_x**2 + g_y**2) + be[0] + be_mass * be_z**2 + c[3]
    lying = (
        g_zz
        + g_mass * (g_x**2 + g_y**2)
        + be[1]
        + be_mass * (be_x**2 + be_z**2)
        + c[2]
        + c[0] * c[1] ** 2
        + a[0] * l1**2
    )
    hanging = a[3] + df[0] + df_mass * (df_y**2 + df_z**2)
    level = a[2] + a[0] * a[1] ** 2 + df[1] + df_mass * (df_x**2 + df_z**2) + c[0] * l3**2
    assert plant.base_inertia == pytest.approx(standing + hanging, rel=1e-3)
    assert plant.yaw_inertia == pytest.approx((lying - standing, level - hanging), rel=1e-3)


def test_nothing_is_read_before_it_is_asked_for():
    script = f"""
import sys, types
root = types.ModuleType("repousse")
root.__path__ = [{str(profile.FOLDER.parents[1])!r}]
sys.modules["repousse"] = root
opened = []
sys.addaudithook(lambda event, args: event == "open" and opened.append(str(args[0])))
from repousse.device.profile import builtin_profiles
assert not [name for name in opened if name.endswith(".toml")], opened
builtin_profiles()
assert [name for name in opened if name.endswith(".toml")]
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


def test_ours_cannot_be_changed_by_who_reads_them():
    builtin_profiles().clear()
    builtin_links().clear()
    assert len(builtin_profiles()) == len(OURS)
    assert builtin_links()


# a stranger's


@pytest.mark.parametrize("place", [*places(PREMIUM)], ids=dotted)
def test_hostile_values_in_every_place_of_a_driven_arm(place):
    for value in HOSTILE:
        said = taken_or_refused(put(PREMIUM, place, value))
        if isinstance(said, str) and place[0] not in ("driven", "sign", "lengths", "capstan", "body", "origin"):
            inner = [name for name in place if isinstance(name, str)]
            assert said.startswith(
                (f"profile: {inner[0]}", "profile: home_counts: ", "profile: workspace_centre: ")
            ) or (inner[0] == "max_current" and said.startswith("profile: continuous_current: ")), said


@pytest.mark.parametrize("place", [*places(TOUCH)], ids=dotted)
def test_hostile_values_in_every_place_of_a_recognised_one(place):
    for value in HOSTILE:
        made = taken_or_refused(put(TOUCH, place, value))
        if not isinstance(made, str):
            assert not made.driven
            assert all(link.layout == "none" for link in made.links)


@pytest.mark.parametrize("place", [*places(PREMIUM)], ids=dotted)
def test_every_place_may_be_missing_only_where_it_has_a_default(place):
    said = taken_or_refused(without(PREMIUM, place))
    optional = {
        *(("angle_offset",), ("device_damping",), ("hand_damping",), ("buttons",), ("emulated",)),
        *(("links", 0, "encoder_sign"), ("links", 0, "lock_step"), ("links", 0, "counted")),
        *(("emulated", "gravity"), ("message",)),
    }
    if place == ("angle_offset",):
        assert said.startswith("profile: home_counts: "), "its offset is what puts home within the limits"
    elif place in optional:
        assert isinstance(said, DeviceProfile)
    else:
        assert isinstance(said, str)
        field = dotted(name for name in place if isinstance(name, str))
        assert said.startswith((f"profile: {place[0]}", f"profile: {field}"))


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


@given(entry=anything)
def test_anything_at_all(entry):
    assert isinstance(taken_or_refused(entry), str)


@given(place=st.sampled_from([*places(PREMIUM)]), other=anything, second=st.sampled_from([*places(PREMIUM)]))
def test_anything_in_two_places(place, other, second):
    entry = put(PREMIUM, place, other)
    with suppress(KeyError, IndexError, TypeError):  # the second place was in what the first replaced
        entry = put(entry, second, other)
    taken_or_refused(entry)


@given(
    place=st.sampled_from([place for place in places(PREMIUM) if place[0] != "links"]),
    factor=st.floats(1e-6, 1e6) | st.sampled_from([-1.0, 1000.0, 0.001, 180 / pi]),
)
def test_wrong_units(place, factor):
    """Millimetres, degrees, milliamperes: what is taken is still an arm whose numbers are finite and within bounds."""
    value = PREMIUM
    for name in place:
        value = value[name]
    if type(value) in (int, float):
        taken_or_refused(put(PREMIUM, place, value * factor))


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("lengths",), [0.0, 209.55, 169.545], "lengths.1: 209.55 is not from 0 to 1"),
        (("lengths", 2), 0.001, "lengths: bodies B and C are at least 0.01 m long"),
        (("lengths",), [0.2, 0.2], "lengths: a list of 3 is wanted, not of 2"),
        (("lengths",), 0.2, "lengths: a list of 3 is wanted, not 0.2"),
        (("body", 0), nan, "body.0: nan is not from 0.001 to 1"),
        (("sign", 1), 0, "sign.1: one of 1, -1 is wanted, not 0"),
        (("sign", 1), True, "sign.1: one of 1, -1 is wanted, not True"),
        (("sign", 1), 1.0, "sign.1: one of 1, -1 is wanted, not 1.0"),
        (("max_force",), "8.5", "max_force: a number is wanted, not '8.5'"),
        (("max_force",), True, "max_force: a number is wanted, not True"),
        (("max_force",), 10**400, "max_force: a number far too large is not from 0.01 to 40"),
        (("driven",), 1, "driven: true or false is wanted, not 1"),
        (("driven",), False, "home_pose: an arm that is not driven has none"),
        (("continuous_current",), 6.0, "continuous_current: is above max_current"),
        (("joint_limits", 0), [1.0, -1.0], "joint_limits.0: 1 is not below -1"),
        (("difference_limits",), [0.5, 0.5], "difference_limits: 0.5 is not below 0.5"),
        (("home_counts", 1), 1.5, "home_counts.1: a whole number is wanted, not 1.5"),
        (("home_counts", 0), 32768, "home_counts.0: 32768 is not from -32768 to 32767"),
        (
            ("home_counts",),
            [20000, 0, 0],
            "home_counts: their angles (2.307, 1.571, 0.000) rad are outside of the limits",
        ),
        (("workspace_centre", 0), 0.9, "workspace_centre: the arm cannot reach (0.9, 0, 0.06) m"),
        (("workspace_centre", 2), -0.12, "workspace_centre: is outside of the limits of the joints"),
        (("key",), "A B", "key: a name of small letters, digits, dots and dashes is wanted, not 'A B'"),
        (("name",), "a\x1bb", "name: a text of printable characters is wanted, not 'a\\x1bb'"),
        (("links",), [], "links: is empty: an arm is driven over one at least"),
        (("links",), ["usb"], "links.0: there is no link 'usb'; there are mbed-14, mbed-8, teensy-64, own-64"),
        (("links", 0), TOUCH["links"][0], "links: touch-hid: has no protocol, so no arm can be driven over it"),
        (("links", 0, "vendor"), 0x10000, "links.0.vendor: 65536 is not from 1 to 65535"),
        (("links", 0, "report_length"), 15, "links.0.report_length: protocol-2 has 14 or 64 bytes"),
        (("links", 0, "report_length"), 8, "links.0.report_length: protocol-2 has 14 or 64 bytes"),
        (("links", 0, "layout"), "protocol-1", "links.0.report_length: protocol-1 has 8 bytes"),
        (("links", 0, "layout"), "none", 'links.0.usage_page: a link of layout "none" has none'),
        (("links", 0, "usage_page"), 0, "links.0.usage_page: is missing"),
        (("links", 0, "firmware_current_limit"), 0.0, "links.0.firmware_current_limit: is missing"),
        (("emulated", "viscous", 2), -0.1, "emulated.viscous.2: -0.1 is not from 0 to 1"),
        (
            ("emulated", "coupling"),
            0.0016,
            "emulated.base_inertia: is too small for yaw_inertia and coupling: the arm would turn by itself",
        ),
        (
            ("emulated", "link_inertia"),
            [1e-4, 1e-4],
            "emulated.coupling: is too large for link_inertia: the arm would move by itself",
        ),
        (("lenghts",), [0, 1, 1], "'lenghts': there is no such field, but lengths"),
        (("emulated", "mass"), 1, "emulated.'mass': there is no such field"),
    ],
)
def test_the_field_and_the_reason_are_named(place, value, said):
    assert taken_or_refused(put(PREMIUM, place, value)) == f"profile: {said}"


def test_an_arm_that_is_not_driven_must_say_why_and_has_no_protocol():
    assert taken_or_refused(without(TOUCH, ("message",))).startswith("profile: message: is missing")
    driven_link = put(TOUCH, ("links", 0), "own-64")
    assert taken_or_refused(driven_link).startswith("profile: links: own-64: an arm that is not driven")
    assert taken_or_refused(put(TOUCH, ("links", 0, "report_length"), 14)).startswith(
        "profile: links.0.report_length: "
    )
    assert taken_or_refused(put(TOUCH, ("max_force",), 1.0)) == "profile: max_force: an arm that is not driven has none"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "key: is missing"),
        (b"key = ", "is not TOML: "),
        (b"\xff\xfe", "is not TOML: "),
        (b"a = " + b"[" * 20000, "is not TOML: "),
        (b"a = " + b"9" * 10000, "is not TOML: "),
        (b"\x00", "is not TOML: "),
        (b"# " + b"x" * profile.LARGEST_FILE, "has more than 65536 bytes, which no profile needs"),
        (
            toml(PREMIUM | {"max_force": 0}).replace("max_force = 0", "max_force = 1979-05-27").encode(),
            "max_force: a number",
        ),
        (b'"a\\nb" = 1', "'a\\nb': there is no such field"),
    ],
    ids=["empty", "cut", "utf-16", "deep", "digits", "nul", "large", "date", "newline"],
)
def test_files_that_are_no_profiles(tmp_path, content, said):
    path = tmp_path / "mine.toml"
    path.write_bytes(content)
    with pytest.raises(ProfileError) as refused:
        load_profile(path)
    assert str(refused.value).startswith(f"mine.toml: {said}")
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 300


@given(content=st.binary(max_size=200))
def test_any_bytes(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("any") / "any.toml"
    path.write_bytes(content)
    with pytest.raises(ProfileError, match=r"\Aany\.toml: [ -~]+\Z"):
        load_profile(path)


def test_what_is_no_file_is_not_opened(tmp_path):
    """A pipe would never let go of who opens it."""
    (tmp_path / "folder.toml").mkdir()
    os.symlink(tmp_path / "nowhere", tmp_path / "lost.toml")
    os.symlink("round.toml", tmp_path / "round.toml")
    said = {"folder.toml": "is no file", "lost.toml": "cannot be read: ", "round.toml": "cannot be read: "}
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.toml")
        said["pipe.toml"] = "is no file"
    found, errors = load_profiles(tmp_path)
    assert found == {}
    assert [error.partition(": ")[0] for error in errors] == sorted(said)
    assert all(error.startswith(f"{name}: {said[name]}") for name, error in zip(sorted(said), errors))


def test_a_users_folder(tmp_path):
    """Each file stands for itself: those that are right are there, each of the others has a line."""
    assert load_profiles(tmp_path / "none") == ({}, [])
    (tmp_path / "a.toml").write_text(toml(PREMIUM | {"key": "mine", "name": "Mine"}), encoding="utf-8")
    (tmp_path / "b.toml").write_text(toml(PREMIUM | {"key": "mine"}), encoding="utf-8")
    (tmp_path / "c.toml").write_text(toml(PREMIUM), encoding="utf-8")
    (tmp_path / "d.toml").write_text(toml(PREMIUM | {"key": "other", "max_force": 400}), encoding="utf-8")
    (tmp_path / "e.txt").write_text("not asked for", encoding="utf-8")
    found, errors = load_profiles(tmp_path)
    assert [(key, made.name) for key, made in found.items()] == [("mine", "Mine")]
    assert isinstance(found["mine"].emulated, EmulatedPlant)
    assert errors == [
        "b.toml: key: another profile is called mine; choose another",
        "c.toml: key: another profile is called phantom-premium-1.5; choose another",
        "d.toml: max_force: 400 is not from 0.01 to 40",
    ]
    assert load_profiles(tmp_path / "e.txt")[1][0].startswith("e.txt: cannot be read: ")


def test_a_folder_of_many_files_is_read_in_part(tmp_path):
    for n in range(profile.MOST_FILES + 3):
        (tmp_path / f"{n:04}.toml").write_bytes(b"")
    found, errors = load_profiles(tmp_path)
    assert found == {}
    assert len(errors) == profile.MOST_FILES + 1
    assert f"holds {profile.MOST_FILES + 3} profiles, only the first {profile.MOST_FILES} are read" in errors[0]


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such names")
def test_a_files_name_is_shown_on_one_line(tmp_path):
    (tmp_path / "a\nb\x1b.toml").write_bytes(b"")
    assert load_profiles(tmp_path)[1] == ["a\\nb\\x1b.toml: key: is missing"]


def test_json_that_is_none():
    for line, said in (("{", "is not JSON: "), ("[" * 60000, "is not JSON: "), (" " * 70000, "has more than 65536")):
        with pytest.raises(ProfileError, match=f"profile: {said}"):
            from_json(line)


# recognising


def keys_of(*device):
    return {(found.key, link.name) for found, link in recognise(OURS, *device)}


def test_arms_are_told_apart_by_ids_usage_page_and_report_length():
    wooden = {"woodenhaptics-2015", "woodenhaptics-2019", "aluhaptics", "phantom-vintage"}
    assert keys_of(0x1234, 6, 0xFFAB, 14) == {(key, "mbed-14") for key in wooden}
    assert keys_of(0x1234, 6, 0xFFAB, 8) == {("woodenhaptics-2015", "mbed-8"), ("aluhaptics", "mbed-8")}
    assert keys_of(0x1234, 6, 0xFFAB, 12) == set()
    assert keys_of(0x1234, 6, 0x0001, 14) == set(), "a keyboard on the same microcontroller"
    assert keys_of(0x1234, 7, 0xFFAB, 14) == set()
    assert keys_of(0x2341, 6, 0xFFAB, 14) == set()
    assert ("phantom-premium-1.5", "own-64") in keys_of(0x16C0, 0x0486, 0xFFAB, 64)
    assert keys_of(0x16C0, 0x0486, 0xFFC9, 64) == set(), "the Teensy's other interface"


def test_what_is_not_known_of_a_device_does_not_rule_an_arm_out():
    """hidapi over libusb tells neither."""
    both = keys_of(0x1234, 6, 0xFFAB, 14) | keys_of(0x1234, 6, 0xFFAB, 8)
    assert keys_of(0x1234, 6, None, None) == keys_of(0x1234, 6, 0, None) == both


@pytest.mark.parametrize(
    ("vendor", "product", "key"),
    [(0x2988, 0x304, "touch-hid"), (0x2988, 0x302, "touch-usb"), (0x301, 0x2988, "touch-usb")],
)
def test_closed_arms_are_recognised_and_not_driven(vendor, product, key):
    ((found, link),) = recognise(OURS, vendor, product, 0x1234, 64)
    assert found.key == key
    assert not found.driven
    assert link.layout == "none"
    assert "vendor's closed driver" in found.message
