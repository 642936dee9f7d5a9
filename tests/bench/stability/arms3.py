# SPDX-License-Identifier: GPL-3.0-or-later
"""Arms that move in three dimensions: free of friction, and led along a path whatever the force."""

from __future__ import annotations

from math import floor

from repousse.device.hand import Hand

from .arm import Mechanics, OneAxis, Triple


class ThreeAxes:
    """A tip with the same mechanics along each axis, and a hand that holds it: without friction the hardest case."""

    def __init__(self, mechanics: Mechanics, hand: Hand, start: Triple) -> None:
        self._axes = [OneAxis(mechanics, hand, place) for place in start]

    @property
    def seen(self) -> Triple:
        x, y, z = (axis.seen[2] for axis in self._axes)
        return x, y, z

    @property
    def place(self) -> Triple:
        x, y, z = (axis.height for axis in self._axes)
        return x, y, z

    def step(self, force: Triple, goal: Triple, speed: Triple) -> None:
        for axis, f, g, v in zip(self._axes, force, goal, speed, strict=True):
            axis.step((0.0, 0.0, f), (0.0, 0.0, g), (0.0, 0.0, v))


class Led:
    """A tip that is where it is led, whatever the force: a hand of iron. ``encoder``: metres to a step of each axis."""

    def __init__(self, start: Triple, encoder: float = 0.0) -> None:
        self.place, self._encoder = start, encoder

    @property
    def seen(self) -> Triple:
        step = self._encoder
        if step <= 0.0:
            return self.place
        x, y, z = (floor(p / step) * step for p in self.place)
        return x, y, z

    def step(self, force: Triple, goal: Triple, speed: Triple) -> None:
        self.place = goal
