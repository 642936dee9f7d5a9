# SPDX-License-Identifier: GPL-3.0-or-later
"""Profiles: what is to be known of an arm, as data. Ours are profiles/*.toml; a user's own are TOML files like them.

A profile says how the arm is built, what its motors stand, where it must not go, and over which links (a controller and
its firmware) it can be driven. One with ``driven = false`` is only recognised: it has a message for its owner, nothing
is ever written to it.

Every file is taken as written by a stranger: a wrong one is refused with the field and the reason.
"""

from __future__ import annotations

import json
import stat
import tomllib
from collections.abc import Iterable
from dataclasses import MISSING, asdict, dataclass, fields
from functools import cache, cached_property
from math import pi, tau
from pathlib import Path
from typing import Any

from . import kinematics
from .fields import FieldError, choice, flag, integer, listed, number, shown, table, text, within, word

Triple = tuple[float, float, float]
Range = tuple[float, float]

FOLDER = Path(__file__).parent / "profiles"
LINKS_FILE = "links.toml"
LARGEST_FILE = 65536
"""Bytes: several times the longest of ours."""
MOST_FILES = 256
"""Of a user's folder."""

_ZERO: Triple = (0.0, 0.0, 0.0)


class ProfileError(ValueError):
    """A profile is refused: one line, ``file: field: reason``."""


@dataclass(frozen=True)
class Link:
    """A controller and its firmware: how an arm is found among HID devices, and what can be said to it.

    ``vendor``, ``product``, ``usage_page`` and ``usage`` as USB tells them. ``layout`` names the reports (reports.py),
    which have ``report_length`` bytes without a report number; "none": no public protocol. ``lock_step``: it sends one
    report for each that it is sent, so a period takes two frames. ``firmware_watchdog_ms``: after how long without a
    report it switches its motors off. ``firmware_current_limit`` (A): above it, it does what nobody wants (see the
    link's ``source``). ``encoder_sign`` -1: it counts the other way round than the profile's signs say. ``counted``:
    each report has a number, so that lost ones are known.
    """

    name: str
    source: str
    vendor: int
    product: int
    layout: str
    usage_page: int = 0
    usage: int = 0
    report_length: int = 0
    lock_step: bool = False
    firmware_watchdog_ms: float = 0.0
    firmware_current_limit: float = 0.0
    encoder_sign: int = 1
    counted: bool = False


@dataclass(frozen=True)
class EmulatedPlant:
    """How the arm moves by itself, for the arm in software, in the body angles of kinematics.py.

    Its mass matrix, without motors and hand, in kg m^2 (symmetric, the rest of it is zero):
    M_aa = ``base_inertia`` + ``yaw_inertia[0]`` sin^2 tB + ``yaw_inertia[1]`` sin^2 tC + 2 ``coupling`` sin tB sin tC,
    M_bb = ``link_inertia[0]``, M_cc = ``link_inertia[1]``, M_bc = ``coupling`` cos(tB + tC). A motor adds
    ``rotor_inertia`` (kg m^2, of one rotor) times its transmission squared to its own joint.

    ``viscous`` (N m s/rad) and ``coulomb`` (N m) friction act at the joints. ``gravity`` (N m): the arm's potential
    energy is gravity[0] cos tB - gravity[1] cos tC.
    """

    source: str
    base_inertia: float
    yaw_inertia: tuple[float, float]
    link_inertia: tuple[float, float]
    coupling: float
    rotor_inertia: float
    viscous: Triple
    coulomb: Triple
    gravity: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class DeviceProfile:
    """An arm. Lengths in m, angles in rad, forces in N, currents in A, for the frame of kinematics.py.

    ``lengths``: Ln, Lb, Lc. Body angle i = ``sign[i]`` x motor angle x ``capstan[i]`` / ``body[i]`` (diameters) +
    ``angle_offset[i]``; the motor's angle is 2 pi counts / ``counts_per_turn[i]`` (quadrupled counts). ``origin`` is
    what kinematics takes off the position. In the pose that ``home_pose`` describes the counts are ``home_counts``.

    ``torque_constant`` in N m/A; ``max_current`` is what a motor stands for moments and ``continuous_current`` for
    ever, its winding warming with ``winding_time`` (s). ``max_force``, ``max_stiffness`` (N/m), ``max_damping``
    (N s/m), ``max_velocity`` (m/s) and ``max_slew`` (N/ms) bound what is rendered; ``device_damping`` and
    ``hand_damping`` (N s/m) are what is counted on to hold the loop stable. Poses are within ``workspace_radius`` of
    ``workspace_centre``, ``joint_limits`` and ``difference_limits``, which bound the PHANToM's q2 - q3, that is
    pi/2 - tB - tC (kinematics.elbow_difference).

    A profile that is not ``driven`` has only ``message`` and links of layout "none".
    """

    key: str
    name: str
    source: str
    driven: bool
    links: tuple[Link, ...]
    message: str = ""
    home_pose: str = ""
    lengths: Triple = _ZERO
    capstan: Triple = _ZERO
    body: Triple = _ZERO
    sign: tuple[int, int, int] = (1, 1, 1)
    angle_offset: Triple = _ZERO
    counts_per_turn: Triple = _ZERO
    origin: Triple = _ZERO
    home_counts: tuple[int, int, int] = (0, 0, 0)
    torque_constant: Triple = _ZERO
    max_current: float = 0.0
    continuous_current: float = 0.0
    winding_time: float = 0.0
    max_force: float = 0.0
    max_stiffness: float = 0.0
    max_damping: float = 0.0
    max_velocity: float = 0.0
    max_slew: float = 0.0
    workspace_centre: Triple = _ZERO
    workspace_radius: float = 0.0
    joint_limits: tuple[Range, Range, Range] = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    difference_limits: Range = (0.0, 0.0)
    device_damping: float = 0.005
    hand_damping: float = 1.5
    buttons: int = 0
    emulated: EmulatedPlant | None = None

    @cached_property
    def radians_per_count(self) -> Triple:
        """By how much a body turns for one count, with its sign."""
        a, b, c = (
            sign * tau / counts * capstan / body
            for sign, counts, capstan, body in zip(self.sign, self.counts_per_turn, self.capstan, self.body)
        )
        return a, b, c

    @cached_property
    def amperes_per_torque(self) -> Triple:
        """What a motor takes for one N m at its body, with its sign."""
        a, b, c = (
            sign * capstan / body / constant
            for sign, capstan, body, constant in zip(self.sign, self.capstan, self.body, self.torque_constant)
        )
        return a, b, c

    @cached_property
    def transmission(self) -> Triple:
        """Turns of a motor for one of its body."""
        a, b, c = (body / capstan for capstan, body in zip(self.capstan, self.body))
        return a, b, c


# What fields may hold. Bounds are of arms that stand on a desk; they are there to catch wrong units and wrong files.
_KEY = word(r"[a-z0-9][a-z0-9.-]{0,47}", "a name of small letters, digits, dots and dashes")
_NAME = text(64)
_PROSE = text(2000)
_ID = integer(1, 0xFFFF)


def _triple(low: float, high: float) -> Any:
    return listed(number(low, high), 3, 3)


def _range(low: float, high: float) -> Any:
    pair = listed(number(low, high), 2, 2)

    def read(value: object) -> Range:
        first, last = pair(value)
        if not first < last:
            raise FieldError("", f"{first:g} is not below {last:g}")
        return first, last

    return read


def _check_link(link: Link) -> None:
    if link.layout == "none":
        for field in fields(link):
            if field.default is not MISSING and getattr(link, field.name) != field.default:
                raise FieldError(field.name, 'a link of layout "none" has none')
        return
    lengths = {"protocol-1": (8,), "protocol-2": (14, 64)}[link.layout]
    if link.report_length not in lengths:
        raise FieldError("report_length", f"{link.layout} has {' or '.join(map(str, lengths))} bytes")
    for name in ("usage_page", "usage", "firmware_watchdog_ms", "firmware_current_limit"):
        if not getattr(link, name):
            raise FieldError(name, "is missing")


_LINK = table(
    Link,
    {
        "name": _KEY,
        "source": _PROSE,
        "vendor": _ID,
        "product": _ID,
        "layout": choice("protocol-1", "protocol-2", "none"),
        "usage_page": integer(0, 0xFFFF),
        "usage": integer(0, 0xFFFF),
        "report_length": integer(0, 64),
        "lock_step": flag,
        "firmware_watchdog_ms": number(0.0, 60000.0),
        "firmware_current_limit": number(0.0, 30.0),
        "encoder_sign": choice(1, -1),
        "counted": flag,
    },
    _check_link,
)


def _read_link(value: object) -> Link:
    """A link of ours by its name, or a table."""
    if not isinstance(value, str):
        return _LINK(value)
    if value not in builtin_links():
        raise FieldError("", f"there is no link {shown(value)}; there are {', '.join(builtin_links())}")
    return builtin_links()[value]


def _check_plant(plant: EmulatedPlant) -> None:
    """No pose of the arm may make its mass matrix anything but positive definite."""
    b, c = plant.yaw_inertia
    if not plant.base_inertia + min(b, 0.0) + min(c, 0.0) - 2.0 * abs(plant.coupling) > 0.0:
        raise FieldError("base_inertia", "is too small for yaw_inertia and coupling: the arm would turn by itself")
    if not plant.link_inertia[0] * plant.link_inertia[1] > plant.coupling**2:
        raise FieldError("coupling", "is too large for link_inertia: the arm would move by itself")


_PLANT = table(
    EmulatedPlant,
    {
        "source": _PROSE,
        "base_inertia": number(1e-7, 1.0),
        "yaw_inertia": listed(number(-1.0, 1.0), 2, 2),
        "link_inertia": listed(number(1e-7, 1.0), 2, 2),
        "coupling": number(-1.0, 1.0),
        "rotor_inertia": number(0.0, 1e-3),
        "viscous": _triple(0.0, 1.0),
        "coulomb": _triple(0.0, 10.0),
        "gravity": listed(number(-10.0, 10.0), 2, 2),
    },
    _check_plant,
)


_GENERAL = {
    "key": _KEY,
    "name": _NAME,
    "source": _PROSE,
    "driven": flag,
    "links": listed(_read_link, 0, 16),
    "message": _PROSE,
}
_ARM = {
    "home_pose": text(200),
    "lengths": _triple(0.0, 1.0),
    "capstan": _triple(1e-3, 0.1),
    "body": _triple(1e-3, 1.0),
    "sign": listed(choice(1, -1), 3, 3),
    "angle_offset": _triple(-tau, tau),
    "counts_per_turn": _triple(16.0, 1e6),
    "origin": _triple(-2.0, 2.0),
    "home_counts": listed(integer(-0x8000, 0x7FFF), 3, 3),
    "torque_constant": _triple(1e-4, 10.0),
    "max_current": number(0.01, 30.0),
    "continuous_current": number(0.01, 30.0),
    "winding_time": number(0.1, 1000.0),
    "max_force": number(0.01, 40.0),
    "max_stiffness": number(1.0, 10000.0),
    "max_damping": number(0.0, 100.0),
    "max_velocity": number(0.01, 5.0),
    "max_slew": number(0.001, 20.0),
    "workspace_centre": _triple(-1.0, 1.0),
    "workspace_radius": number(0.005, 1.0),
    "joint_limits": listed(_range(-tau, tau), 3, 3),
    "difference_limits": _range(-pi, pi),
    "device_damping": number(0.0, 10.0),
    "hand_damping": number(0.0, 10.0),
    "buttons": integer(0, 1),
    "emulated": _PLANT,
}
_OPTIONAL = {"angle_offset", "device_damping", "hand_damping", "buttons", "emulated"}


def _check_profile(profile: DeviceProfile) -> None:
    if not profile.driven:
        if not profile.message:
            raise FieldError("message", "is missing: it tells the owner of an arm that is not driven why")
        for link in profile.links:
            if link.layout != "none":
                raise FieldError("links", f'{link.name}: an arm that is not driven has links of layout "none" alone')
        return
    if not profile.links:
        raise FieldError("links", "is empty: an arm is driven over one at least")
    for link in profile.links:
        if link.layout == "none":
            raise FieldError("links", f"{link.name}: has no protocol, so no arm can be driven over it")
    if min(profile.lengths[1:]) < 0.01:
        raise FieldError("lengths", "bodies B and C are at least 0.01 m long")
    if profile.continuous_current > profile.max_current:
        raise FieldError("continuous_current", "is above max_current")
    home = kinematics.joint_angles(profile, profile.home_counts)
    if kinematics.beyond_limits(profile, home) > 0.0:
        angles = ", ".join(f"{angle:.3f}" for angle in home)
        raise FieldError("home_counts", f"their angles ({angles}) rad are outside of the limits")
    try:
        centre = kinematics.angles_of(profile, profile.workspace_centre)
    except ValueError as error:
        raise FieldError("workspace_centre", str(error)) from None
    if kinematics.beyond_limits(profile, centre) > 0.0:
        raise FieldError("workspace_centre", "is outside of the limits of the joints")


_PROFILE = table(DeviceProfile, {**_GENERAL, **_ARM}, _check_profile)


def _read_profile(value: object) -> DeviceProfile:
    """A table as a profile: one that is driven has every field of an arm, one that is not has none."""
    if isinstance(value, dict) and isinstance(value.get("driven"), bool):
        for name in _ARM:
            if value["driven"] and name not in value and name not in _OPTIONAL:
                raise FieldError(name, "is missing")
            if not value["driven"] and name in value:
                raise FieldError(name, "an arm that is not driven has none")
    return _PROFILE(value)


def _named(path: Path) -> str:
    """A file's name as a message shows it: on one line, whatever somebody called it."""
    name = path.name if path.name.isprintable() else ascii(path.name)[1:-1]
    return name if len(name) <= 80 else f"{name[:80]}..."


def _parsed(path: Path) -> dict[str, Any]:
    """What a TOML file holds; ProfileError where it cannot be read."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # to open a pipe would wait for ever
            raise ProfileError(f"{_named(path)}: is no file")
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            raise ProfileError(f"{_named(path)}: has more than {LARGEST_FILE} bytes, which no profile needs")
        return tomllib.loads(content.decode())
    except ProfileError:
        raise
    except OSError as error:
        raise ProfileError(f"{_named(path)}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ProfileError(f"{_named(path)}: is not TOML: {_one_line(error)}") from None


def _one_line(error: Exception) -> str:
    """A parser's complaint, which may quote the file."""
    return " ".join(ascii(str(error))[1:-1].replace("\\n", " ").split())[:200]


def _checked(name: str, value: object) -> DeviceProfile:
    try:
        return _read_profile(value)
    except FieldError as error:
        raise ProfileError(f"{name}: {error}") from None


def load_profile(path: str | Path) -> DeviceProfile:
    """The profile that a TOML file holds; ProfileError says what is wrong with it."""
    path = Path(path)
    return _checked(_named(path), _parsed(path))


def load_profiles(folder: str | Path) -> tuple[dict[str, DeviceProfile], list[str]]:
    """A user's own profiles by key, and a line for each file that is refused. A folder that is not there holds none."""
    found: dict[str, DeviceProfile] = {}
    errors: list[str] = []
    try:
        paths = sorted(path for path in Path(folder).iterdir() if path.suffix == ".toml")
    except FileNotFoundError:
        return found, errors
    except OSError as error:
        return found, [f"{_named(Path(folder))}: cannot be read: {error.strerror}"]
    if len(paths) > MOST_FILES:
        errors.append(f"{_named(Path(folder))}: holds {len(paths)} profiles, only the first {MOST_FILES} are read")
    for path in paths[:MOST_FILES]:
        try:
            profile = load_profile(path)
            if profile.key in builtin_profiles() or profile.key in found:
                raise ProfileError(f"{_named(path)}: key: another profile is called {profile.key}; choose another")
            found[profile.key] = profile
        except ProfileError as error:
            errors.append(str(error))
    return found, errors


@cache
def _builtin_links() -> dict[str, Link]:
    path = FOLDER / LINKS_FILE
    try:
        return {
            name: within(name, _LINK, {"name": name, **entry} if isinstance(entry, dict) else entry)
            for name, entry in _parsed(path).items()
        }
    except FieldError as error:
        raise ProfileError(f"{_named(path)}: {error}") from None


@cache
def _builtin_profiles() -> dict[str, DeviceProfile]:
    profiles = [load_profile(path) for path in sorted(FOLDER.glob("*.toml")) if path.name != LINKS_FILE]
    return {profile.key: profile for profile in profiles}


def builtin_links() -> dict[str, Link]:
    """Our links by name, read when first asked for."""
    return dict(_builtin_links())


def builtin_profiles() -> dict[str, DeviceProfile]:
    """Our profiles by key, read when first asked for."""
    return dict(_builtin_profiles())


def to_json(profile: DeviceProfile) -> str:
    """A profile on one line, to hand to another process."""
    entries = asdict(profile)
    if profile.emulated is None:
        del entries["emulated"]
    known = {**_GENERAL, **(_ARM if profile.driven else {})}
    return json.dumps({name: entry for name, entry in entries.items() if name in known and entry != ""})


def from_json(line: str) -> DeviceProfile:
    """The inverse of to_json, checked as a file is; ProfileError where it is wrong."""
    if len(line) > LARGEST_FILE:
        raise ProfileError(f"profile: has more than {LARGEST_FILE} characters, which none needs")
    try:
        value = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ProfileError(f"profile: is not JSON: {_one_line(error)}") from None
    return _checked("profile", value)


def recognise(
    profiles: Iterable[DeviceProfile], vendor: int, product: int, usage_page: int | None, report_length: int | None
) -> list[tuple[DeviceProfile, Link]]:
    """Which of the profiles a HID device can be, and over which of their links.

    What is not known of the device (hidapi over libusb tells neither the usage page nor the report's length) fits all.
    """
    return [
        (profile, link)
        for profile in profiles
        for link in profile.links
        if (link.vendor, link.product) == (vendor, product)
        and (not link.usage_page or not usage_page or link.usage_page == usage_page)
        and (not link.report_length or not report_length or link.report_length == report_length)
    ]
