# SPDX-License-Identifier: GPL-3.0-or-later
"""Arms for a loop without a clock: one axis that theory can follow, and the product's own mechanics in three."""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, floor
from typing import Protocol

import numpy as np
from scipy.linalg import expm

from repousse.device import kinematics
from repousse.device.hand import Hand
from repousse.device.limits import PERIOD
from repousse.device.plant import Plant
from repousse.device.profile import DeviceProfile

Triple = tuple[float, float, float]

PIECES = 4
"""Parts of a period in which friction is found anew: where the arm stops within a period it sticks at once."""


class Arm(Protocol):
    """A tip in the grip of a hand. Lengths in m, forces in N, the device's frame."""

    @property
    def seen(self) -> Triple:
        """Where the encoders say that the tip is."""
        ...

    @property
    def place(self) -> Triple:
        """Where it is."""
        ...

    def step(self, force: Triple, goal: Triple, speed: Triple) -> None:
        """Live through a period of the loop with a ``force`` on the tip, while the hand wants to be at ``goal`` and to
        move at ``speed`` (m/s)."""
        ...


@dataclass(frozen=True)
class Mechanics:
    """What one axis of an arm is: kg, N s/m, N of Coulomb friction, and m from one encoder step to the next."""

    mass: float = 0.045
    damping: float = 0.005
    friction: float = 0.0
    encoder: float = 0.0


def transition(mass: float, damping: float, stiffness: float, time: float) -> np.ndarray:
    """(2, 3): place and speed after ``time`` seconds, from place, speed and a constant force; exact (matrix
    exponential of the held input)."""
    motion = np.array([[0.0, 1.0, 0.0], [-stiffness / mass, -damping / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
    return expm(motion * time)[:2]


class OneAxis:
    """A tip that moves up and down: mass, damping, Coulomb friction and encoder steps, and a hand that holds it.

    Without friction each period is exact. With it, a period has :data:`PIECES` parts, in each of which friction takes
    what speed it can; what has stopped stays where it is.
    """

    def __init__(self, mechanics: Mechanics, hand: Hand, height: float) -> None:
        self.height, self.speed = height, 0.0
        self._mechanics, self._hand = mechanics, hand
        self.mass = mechanics.mass + hand.mass
        self._pieces = PIECES if mechanics.friction > 0.0 else 1
        damping = mechanics.damping + hand.damping
        self._rubbed = mechanics.friction * PERIOD / self._pieces / self.mass
        self._half = 0.5 * PERIOD / self._pieces
        self._rows = transition(self.mass, damping, hand.stiffness, PERIOD / self._pieces).tolist()

    @property
    def seen(self) -> Triple:
        step = self._mechanics.encoder
        return (0.0, 0.0, floor(self.height / step) * step if step > 0.0 else self.height)

    @property
    def place(self) -> Triple:
        return (0.0, 0.0, self.height)

    def step(self, force: Triple, goal: Triple, speed: Triple) -> None:
        (a, b, c), (d, e, f) = self._rows
        wanted, push = goal[2], force[2] + self._hand.damping * speed[2]
        for _ in range(self._pieces):
            z, v = self.height - wanted, self.speed
            free = d * z + e * v + f * push
            if self._rubbed == 0.0:
                self.height, self.speed = wanted + a * z + b * v + c * push, free
                continue
            left = copysign(max(abs(free) - self._rubbed, 0.0), free)
            if v == 0.0 and left == 0.0:
                continue
            self.height = wanted + a * z + b * v + c * push + (left - free) * self._half
            self.speed = left


class InSoftware:
    """The product's arm in software (device/plant.py): rigid bodies in three dimensions, their friction, whole encoder
    counts and motor currents, at the middle of its workspace and above."""

    def __init__(self, profile: DeviceProfile, hand: Hand, height: float) -> None:
        self._profile = profile
        self._plant = Plant(profile, hand.mass, hand.damping, hand.stiffness)
        x, y, z = self._middle = profile.workspace_centre
        self._plant.angles = kinematics.angles_of(profile, (x, y, z + height))
        self._time = 0.0

    @property
    def seen(self) -> Triple:
        a, b, c = kinematics.counts_of(self._profile, self._plant.angles)
        angles = kinematics.joint_angles(self._profile, (floor(a), floor(b), floor(c)))
        return self._from_middle(kinematics.position(self._profile, angles))

    @property
    def place(self) -> Triple:
        return self._from_middle(self._plant.position())

    def _from_middle(self, place: Triple) -> Triple:
        (x, y, z), (u, v, w) = place, self._middle
        return x - u, y - v, z - w

    def step(self, force: Triple, goal: Triple, speed: Triple) -> None:
        currents = kinematics.currents(self._profile, self._plant.angles, force)
        torques = kinematics.motor_torques(self._profile, currents)
        (x, y, z), (u, v, w) = goal, self._middle
        wanted = (x + u, y + v, z + w), speed
        self._plant.step(PERIOD, torques, lambda _: wanted, self._time)
        self._time += PERIOD
