# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand for an arm in software: a mass, a damper and a spring that pull the tip to where the hand wants to be.

What it wants is an :class:`Intention`: positions at times. A script of one is JSON lines: first
``{"intention": 1, "interpolation": "minimum-jerk", "loop": true}``, then for each position
``{"time": seconds, "position": [x, y, z], "button": false}``, in metres of the device's frame from the centre of the
workspace, in the order of time.
"""

from __future__ import annotations

import json
from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from .fields import FieldError, choice, flag, integer, listed, number, table

Triple = tuple[float, float, float]

LARGEST_SCRIPT = 1 << 20
"""Bytes of a script."""
MOST_KEYFRAMES = 10000
MINIMUM_JERK, LINEAR = "minimum-jerk", "linear"


class IntentionError(ValueError):
    """A script is refused: one line, ``file: line: field: reason``."""


@dataclass(frozen=True)
class Keyframe:
    """Where the hand wants the tip at a time (s): m from the centre of the workspace, and whether it holds the button
    from then on."""

    time: float
    position: Triple
    button: bool = False


@dataclass(frozen=True)
class Intention:
    """Where the hand wants the tip, over time.

    Between keyframes the position goes along a straight line, by a minimum-jerk profile (Flash and Hogan 1985: at rest
    at each keyframe) or at constant speed. With ``loop`` it goes back to the first keyframe's position in as long as
    the first one's time, and on from there; else it stays at the last. Raises ValueError for keyframes out of order.
    """

    keyframes: tuple[Keyframe, ...]
    interpolation: str = MINIMUM_JERK
    loop: bool = False

    def __post_init__(self) -> None:
        if not self.keyframes:
            raise ValueError("an intention has one position at least")
        if self.keyframes[0].time < 0.0:
            raise ValueError("time: begins before 0")
        for before, after in zip(self.keyframes, self.keyframes[1:]):
            if not after.time > before.time:
                raise ValueError(f"time: {after.time:g} does not come after {before.time:g}")
        if self.loop and not self.keyframes[-1].time > 0.0:
            raise ValueError("time: an intention that loops takes some time")

    @cached_property
    def _times(self) -> list[float]:
        return [key.time for key in self.keyframes]

    def at(self, time: float) -> tuple[Triple, Triple, bool]:
        """Position (m), velocity (m/s) and button at a time in seconds from 0."""
        first, last = self.keyframes[0], self.keyframes[-1]
        before = first
        if self.loop and time > last.time:
            time %= last.time
            before = last
        index = bisect_right(self._times, time)
        if index == len(self.keyframes):
            return last.position, (0.0, 0.0, 0.0), last.button
        after = self.keyframes[index]
        start = 0.0
        if index:
            before = self.keyframes[index - 1]
            start = before.time
        duration = after.time - start
        share, pace = _progress((time - start) / duration, self.interpolation)
        (x0, y0, z0), (x1, y1, z1) = before.position, after.position
        dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
        pace /= duration
        return (x0 + share * dx, y0 + share * dy, z0 + share * dz), (pace * dx, pace * dy, pace * dz), before.button


def _progress(share: float, interpolation: str) -> tuple[float, float]:
    """How much of the way is gone at a share of the time, and its derivative."""
    if interpolation == LINEAR:
        return share, 1.0
    left = 1.0 - share
    return share**3 * (10.0 - 15.0 * share + 6.0 * share * share), 30.0 * share * share * left * left


def built_in(radius: float) -> Intention:
    """A hand that presses down, draws sideways, lifts and comes back, within a workspace of `radius` m; it loops."""
    keys = [
        (0.5, (0.0, -0.35, 0.3), False),
        (1.5, (0.0, -0.35, -0.05), True),
        (3.0, (0.0, -0.35, -0.35), True),
        (4.0, (0.0, -0.35, -0.35), True),
        (6.0, (0.0, 0.35, -0.35), True),
        (6.5, (0.0, 0.35, -0.35), True),
        (7.5, (0.0, 0.35, 0.3), False),
        (8.5, (0.0, -0.35, 0.3), False),
    ]
    return Intention(
        tuple(Keyframe(time, (x * radius, y * radius, z * radius), button) for time, (x, y, z), button in keys),
        loop=True,
    )


@dataclass(frozen=True)
class Hand:
    """A hand at the tip: kg, N s/m, N/m, and what it wants; None is :func:`built_in` for the arm that it holds.

    The presets are a soft and a firm grip of a stylus; ranges and sources are in DESIGN 4's facts on stability.
    """

    mass: float = 0.10
    damping: float = 1.5
    stiffness: float = 200.0
    intention: Intention | None = None

    def __post_init__(self) -> None:
        for name, highest in (("mass", 2.0), ("damping", 50.0), ("stiffness", 5000.0)):
            value = getattr(self, name)
            if not 0.0 <= value <= highest:  # written so that NaN fails too
                raise ValueError(f"a hand's {name} is from 0 to {highest:g}, not {value:g}")

    @classmethod
    def soft(cls, intention: Intention | None = None) -> Hand:
        """A soft grip."""
        return cls(0.10, 1.5, 200.0, intention)

    @classmethod
    def firm(cls, intention: Intention | None = None) -> Hand:
        """A firm grip."""
        return cls(0.15, 4.5, 500.0, intention)


@dataclass(frozen=True)
class _Header:
    intention: int
    interpolation: str = MINIMUM_JERK
    loop: bool = False


_HEADER = table(_Header, {"intention": integer(1, 1), "interpolation": choice(MINIMUM_JERK, LINEAR), "loop": flag})
_KEYFRAME = table(
    Keyframe,
    {"time": number(0.0, 1e5), "position": listed(number(-1.0, 1.0), 3, 3), "button": flag},
)


def load_intention(path: Path) -> Intention:
    """The intention that a script holds. Raises IntentionError."""
    try:
        if not path.is_file():  # to open a pipe would wait for ever
            raise IntentionError(f"{path.name}: is no file")
        with path.open("rb") as file:
            content = file.read(LARGEST_SCRIPT + 1)
    except OSError as error:
        raise IntentionError(f"{path.name}: cannot be read: {error.strerror}") from None
    if len(content) > LARGEST_SCRIPT:
        raise IntentionError(f"{path.name}: has more than {LARGEST_SCRIPT} bytes")
    lines = [(number, line) for number, line in enumerate(content.splitlines(), 1) if line.strip()]
    if len(lines) > MOST_KEYFRAMES:
        raise IntentionError(f"{path.name}: has more than {MOST_KEYFRAMES} positions")
    if len(lines) < 2:
        raise IntentionError(f"{path.name}: has no positions: a header and one of them at least are wanted")
    (at, line), *rest = lines
    header = _read(path, at, line, _HEADER)
    keyframes = tuple(_read(path, at, line, _KEYFRAME) for at, line in rest)
    try:
        return Intention(keyframes, header.interpolation, header.loop)
    except ValueError as error:
        raise IntentionError(f"{path.name}: {error}") from None


def _read(path: Path, at: int, line: bytes, reader: Any) -> Any:
    try:
        return reader(json.loads(line))
    except FieldError as error:
        raise IntentionError(f"{path.name}: line {at}: {error}") from None
    except (ValueError, RecursionError):
        raise IntentionError(f"{path.name}: line {at}: is not JSON") from None
