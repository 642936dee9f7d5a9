# SPDX-License-Identifier: GPL-3.0-or-later
"""Guide: what a mouse or a pen means. Pixels go in, poses of a tool come out.

A mouse has no depth. So the tool rides the surface as it was when the stroke began, pressed in by strength x radius x
pressure: a drag ploughs an even groove, and holding still does not dig. An arm has its own position and needs no guide.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil, hypot, isfinite, sqrt
from typing import NamedTuple

import numpy as np

from .stroke import Sample
from .surface import Hit, Surface
from .tool import Vector, vector

VERBS = ("push", "pull", "smooth")
PRESSES = ("view", "normal", "stroke")
SMALLEST_RADIUS = 1.5
"""Voxels to which a light pen may shrink a tool: with less it would slip between voxel centres."""
FINEST_STEP = 0.25
"""Voxels between two poses, at least; a drill goes ahead by so much at a time."""
MOST_POSES = 64
"""Poses to a move of the mouse, at most: a faster move has them farther apart."""
SAME_STEP = 2e-3
"""Voxels by which the way between two poses may differ from what was asked."""
PULL_SHARE = 0.5
"""Of the strength: what a pull takes raises a ridge about as high as a push of that strength is deep."""

_MOST_TRIALS = 12  # rays to find one pose; on the edge of a step in the surface there is none to find
_FLATTEST = 0.05  # cosine between two lines of sight, at least

Ray = tuple[Vector, Vector]


@dataclass(frozen=True)
class Brush:
    """What the tool is to do, from press to release.

    Parameters
    ----------
    radius
        Of the tool, in voxels.
    strength
        0 to 1: how deep a push is pressed in, in radii; how much a pull takes, or how much a smoothing smooths.
    verb
        "push", "pull" or "smooth".
    press
        Which way it is pressed: "view" away from the viewer, "normal" into the surface, "stroke" into the surface as
        well, but material flows the way the tool goes.
    drill
        Go on in that direction by strength x radius a second while it is held.
    spacing
        Way on the surface from one pose to the next, in radii.
    stabiliser
        Pixels of string by which the mouse drags the tool; 0 is none.
    pressure_radius, pressure_strength
        Whether a pen's pressure, 0 to 1, scales them.
    """

    radius: float
    strength: float = 0.5
    verb: str = "push"
    press: str = "normal"
    drill: bool = False
    spacing: float = 0.15
    stabiliser: float = 0.0
    pressure_radius: bool = False
    pressure_strength: bool = False

    def __post_init__(self) -> None:
        if self.verb not in VERBS:
            raise ValueError(f'there is no verb "{self.verb}": choose from {", ".join(VERBS)}')
        if self.press not in PRESSES:
            raise ValueError(f'a brush is not pressed along "{self.press}": choose from {", ".join(PRESSES)}')
        if not (isfinite(self.radius) and self.radius >= 1.0):
            raise ValueError(f"the brush's radius must be at least one voxel, not {self.radius:g}")
        if not 0.0 <= self.strength <= 1.0:
            raise ValueError(f"the brush's strength is a number from 0 to 1, not {self.strength:g}")
        if not (isfinite(self.spacing) and self.spacing > 0.0):
            raise ValueError(f"the brush's spacing is a positive share of its radius, not {self.spacing:g}")
        if not (isfinite(self.stabiliser) and self.stabiliser >= 0.0):
            raise ValueError(f"the stabiliser is a number of pixels from 0 up, not {self.stabiliser:g}")

    def radius_at(self, pressure: float) -> float:
        """Radius in voxels under a pressure."""
        return max(self.radius * pressure, SMALLEST_RADIUS) if self.pressure_radius else self.radius

    def strength_at(self, pressure: float) -> float:
        """Strength, 0 to 1, under a pressure."""
        return self.strength * pressure if self.pressure_strength else self.strength


@dataclass(frozen=True)
class _Pen:
    """A mouse or pen: pixels, pressure 0 to 1, seconds."""

    x: float
    y: float
    pressure: float
    time: float

    def towards(self, other: _Pen, part: float) -> _Pen:
        a, b = (self.x, self.y, self.pressure, self.time), (other.x, other.y, other.pressure, other.time)
        return _Pen(*(p + part * (q - p) for p, q in zip(a, b, strict=True)))

    def away_from(self, other: _Pen) -> float:
        return hypot(self.x - other.x, self.y - other.y)


class _Aimed(NamedTuple):
    """Where a line of sight ends, on the surface or on the glide plane: all (3,) in voxels."""

    position: np.ndarray
    origin: np.ndarray
    way: np.ndarray
    on_surface: bool


class Guide:
    """The poses of one stroke.

    Parameters
    ----------
    surface
        As it was when the stroke began: a Surface with the stroke's history.
    brush
        Lengths in voxels.
    ray
        Pixels (x, y) to a line of sight in voxels: where it begins, and its unit direction.

    All methods return the poses that are due, in order; their times are seconds since the stroke began.
    """

    def __init__(self, surface: Surface, brush: Brush, ray: Callable[[float, float], Ray]) -> None:
        self.surface, self.brush, self.ray = surface, brush, ray
        self._pen: _Pen | None = None  # the end of the string that drags the tool
        self._mouse: _Pen | None = None  # the other
        self._began = 0.0
        self._here: _Aimed | None = None  # what the pen is over
        self._posed = np.zeros(3)  # where on the surface the last pose was
        self._centre: np.ndarray | None = None  # the tool's there
        self._plane: _Aimed | None = None  # the last pose on the surface: the glide plane goes through it
        self._outward = np.zeros(3)  # the normal there
        self._ahead = 0.0  # voxels that a drill has gone
        self._ahead_posed = 0.0  # and had at the last pose

    @property
    def hit(self) -> Hit | None:
        """What the tool is over now, on the surface or beside it; None before `begin`."""
        return Hit(vector(self._here.position), vector(self._normal(self._here))) if self._here else None

    @property
    def radius(self) -> float:
        """The tool's now, in voxels."""
        return self.brush.radius_at(self._pen.pressure if self._pen else 1.0)

    def begin(self, x: float, y: float, pressure: float = 1.0, time: float = 0.0) -> list[Sample]:
        """The button goes down at pixel (x, y): the tool comes down on the surface and is pressed in."""
        self._began = time
        self._pen = self._mouse = _Pen(x, y, _share(pressure), time)
        return self._pose(self._pen, self._aim(self._pen))

    def move(self, x: float, y: float, pressure: float = 1.0, time: float = 0.0) -> list[Sample]:
        """The mouse has moved: a pose for every ``spacing`` of its way on the surface."""
        if self._pen is None or self._mouse is None:
            return self.begin(x, y, pressure, time)
        mouse = _Pen(x, y, _share(pressure), max(time, self._mouse.time))
        poses: list[Sample] = []
        left = MOST_POSES
        for pen in self._pulled(self._pen, self._mouse, mouse):
            found = self._drag(self._pen, pen, left)
            poses += [sample for samples in found for sample in samples]
            left -= len(found)
            self._pen = pen
        self._mouse = mouse
        return poses

    def hold(self, time: float) -> list[Sample]:
        """The button is still down: nothing, but a drill goes ahead."""
        if self._pen is None or self._here is None or not self.brush.drill or self.brush.verb == "smooth":
            return []
        start, end = self._pen, replace(self._pen, time=max(time, self._pen.time))
        begin, gained = self._ahead, self._drilled(start, end)
        poses: list[Sample] = []
        while begin + gained - self._ahead_posed >= FINEST_STEP:
            self._ahead = self._ahead_posed + FINEST_STEP
            poses += self._pose(start.towards(end, max(0.0, self._ahead - begin) / gained), self._here)
        self._pen, self._ahead = end, begin + gained
        return poses

    def _drilled(self, start: _Pen, end: _Pen) -> float:
        """Voxels that a drill goes ahead from one time to another."""
        if not self.brush.drill:
            return 0.0
        return self.brush.strength_at(end.pressure) * self.brush.radius_at(end.pressure) * (end.time - start.time)

    def _pulled(self, pen: _Pen, former: _Pen, mouse: _Pen) -> list[_Pen]:
        """Where the string drags ``pen`` while the mouse goes from ``former`` to ``mouse``."""
        string, path = self.brush.stabiliser, []
        if not string:
            return [mouse]
        steps = min(max(1, ceil(4.0 * mouse.away_from(former) / string)), MOST_POSES)
        for step in range(1, steps + 1):
            hand = former.towards(mouse, step / steps)
            away = hand.away_from(pen)
            if away > string:
                end = pen.towards(hand, 1.0 - string / away)
                pen = replace(hand, x=end.x, y=end.y)
                path.append(pen)
        return path

    def _drag(self, start: _Pen, end: _Pen, most: int) -> list[list[Sample]]:
        """The pen goes straight from ``start`` to ``end``: the samples of each pose on its way."""
        poses: list[list[Sample]] = []
        last, part = self._aim(end), 0.0
        ahead, gained = self._ahead, self._drilled(start, end)
        assert self._here is not None
        straight = float(np.linalg.norm(_across(last.origin, last.way, self._here) - self._here.position))
        step = max(self.brush.spacing * self.radius, FINEST_STEP, straight / MOST_POSES)
        while len(poses) < most and (found := self._next(start, end, part, last, step)) is not None:
            part, aimed = found
            self._ahead = ahead + gained * part
            poses.append(self._pose(start.towards(end, part), aimed))
            last = last if last.on_surface else self._glide(last.origin, last.way)  # its plane has moved along
        self._ahead, self._here = ahead + gained, last
        return poses

    def _next(self, start: _Pen, end: _Pen, part: float, last: _Aimed, step: float) -> tuple[float, _Aimed] | None:
        """How far along the way from ``start`` to ``end`` the pointer is one step from the last pose, after ``part``.

        Each trial is a ray of its own. A step in the surface may hold no such place: then the far side of it is.
        """
        assert self._here is not None
        low, short = part, self._past(self._here, step)
        if short >= -SAME_STEP:
            return part, self._here
        high = part + (1.0 - part) * self._likely(last, step)
        while True:
            aimed = last if high >= 1.0 else self._aim(start.towards(end, high))
            beyond = self._past(aimed, step)
            if beyond >= -SAME_STEP:
                break
            if high >= 1.0:
                return None
            low, short, high = high, beyond, min(1.0, high + (high - part))
        if beyond <= SAME_STEP:
            return high, aimed
        fall, rise, side = -short, beyond, 0
        for _ in range(_MOST_TRIALS):
            middle = low + (high - low) * fall / (fall + rise)
            trial = self._aim(start.towards(end, middle))
            past = self._past(trial, step)
            if abs(past) <= SAME_STEP:
                return middle, trial
            # The end that stays twice counts half, or the other would only creep towards the place.
            if past > 0.0:
                high, aimed, rise, fall, side = middle, trial, past, fall / 2.0 if side > 0 else fall, 1
            else:
                low, fall, rise, side = middle, -past, rise / 2.0 if side < 0 else rise, -1
        return high, aimed

    def _past(self, aimed: _Aimed, step: float) -> float:
        """Voxels by which a point of the surface is farther than a step from the last pose."""
        return float(np.linalg.norm(aimed.position - self._posed)) - step

    def _likely(self, last: _Aimed, step: float) -> float:
        """The part of the way to ``last`` after which it is a step from the last pose, were the surface flat."""
        assert self._here is not None
        gone = self._here.position - self._posed
        way = _across(last.origin, last.way, self._here) - self._here.position
        a, b, c = float(way @ way), float(way @ gone), float(gone @ gone) - step * step
        if a <= 0.0:
            return 1.0
        return min(max((sqrt(b * b - a * c) - b) / a, 1e-3), 1.0)

    def _aim(self, pen: _Pen) -> _Aimed:
        """Where the line of sight through a pixel meets the surface, or else the glide plane."""
        origin, way = (np.array(v, np.float64) for v in self.ray(pen.x, pen.y))
        met = self.surface.meet(origin, way)
        return self._glide(origin, way) if met is None else _Aimed(np.array(met), origin, way, True)

    def _glide(self, origin: np.ndarray, way: np.ndarray) -> _Aimed:
        """Off the surface: on the plane through the last pose on it, or the volume's middle, that faces the view."""
        if self._plane is not None:
            return _Aimed(_across(origin, way, self._plane), origin, way, False)
        middle = (np.array(self.surface.shape) - 1.0) / 2.0
        return _Aimed(origin + ((middle - origin) @ way) * way, origin, way, False)

    def _normal(self, aimed: _Aimed) -> np.ndarray:
        if aimed.on_surface:
            return np.array(self.surface.normal(aimed.position, aimed.way))
        return -aimed.way if self._plane is None else self._outward

    def _pose(self, pen: _Pen, aimed: _Aimed) -> list[Sample]:
        """The tool over a point of the surface; coming from afar, a push touches it first and is then pressed in."""
        brush, radius, press = self.brush, self.brush.radius_at(pen.pressure), self.brush.strength_at(pen.pressure)
        normal = self._normal(aimed)
        inward = aimed.way if brush.press == "view" else -normal
        touching = aimed.position + radius * normal
        if brush.verb == "push":
            centre = touching + (press * radius + self._ahead) * inward
            flow, strength = None if brush.press == "stroke" else inward, None
        elif brush.verb == "pull":
            centre = aimed.position - radius * normal - self._ahead * inward
            flow, strength = -inward, PULL_SHARE * press
        else:
            centre, flow, strength = aimed.position, None, press
        afar = self._centre is None or float(np.linalg.norm(centre - self._centre)) > 2.0 * radius
        self._here, self._posed, self._centre, self._ahead_posed = aimed, aimed.position, centre, self._ahead
        if aimed.on_surface:
            self._plane, self._outward = aimed, normal
        way = [touching, centre] if afar and brush.verb == "push" else [centre]
        return [
            Sample(
                pen.time - self._began,
                vector(place),
                radius=radius,
                direction=None if flow is None else vector(flow),
                strength=strength,
            )
            for place in way
        ]


def _share(pressure: float) -> float:
    return min(max(pressure, 0.0), 1.0)


def _across(origin: np.ndarray, way: np.ndarray, plane: _Aimed) -> np.ndarray:
    """Where a line of sight cuts the plane through another's end that faces that other."""
    slope = max(float(way @ plane.way), _FLATTEST)
    return origin + (float((plane.position - origin) @ plane.way) / slope) * way
