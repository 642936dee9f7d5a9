# SPDX-License-Identifier: GPL-3.0-or-later
"""Who touches what: three arms, two hands, and a press against a wall or into the material, ready to be run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.device.hand import Hand
from repousse.device.limits import Limits

from .arm import Arm, Mechanics, OneAxis
from .closed_loop import ClosedLoop, Goal, Triple, limits_for
from .collision import Timing
from .couplings import ZERO, Coupled, Coupling
from .worlds import Clay, Wall, World, laid_over

MS = 1e-3
HANDS = {"soft": Hand.soft(), "firm": Hand.firm()}
START = 5e-3
"""Metres above what is touched, where the tip begins."""
SPEED = 0.1
"""Metres per second at which the hand comes down: half a working hand's fastest."""
PRESS = 1.5
"""Newtons that the hand ends with on a wall as stiff as the arm can render; under every arm's 3.3."""


@dataclass(frozen=True)
class Device:
    """An arm that is known by its figures alone (facts: CHAI3D's limits; friction and encoder from its data sheet)."""

    name: str
    stiffness: float
    force: float
    damping: float
    mechanics: Mechanics

    @property
    def ideal(self) -> Mechanics:
        """Without friction and encoder steps: the harder case, for friction takes energy, and the one of theory."""
        return Mechanics(self.mechanics.mass, self.mechanics.damping)

    @property
    def limits(self) -> Limits:
        return limits_for(self.force, self.stiffness, self.damping)


DEVICES = (
    Device("Touch", 400.0, 3.3, 4.0, Mechanics(0.045, 0.005, 0.26, 55e-6)),
    Device("Omni", 700.0, 3.3, 5.0, Mechanics(0.045, 0.005, 0.26, 55e-6)),
    Device("Desktop", 1000.0, 7.9, 5.0, Mechanics(0.045, 0.005, 0.06, 23e-6)),
)


def coming_down(end: float, start: float = START, speed: float = SPEED) -> Goal:
    """A hand that goes straight down from ``start`` to ``end`` (m) at a speed (m/s), and stays."""

    def goal(now: float) -> tuple[Triple, Triple]:
        height = start - speed * now
        return ((0.0, 0.0, height), (0.0, 0.0, -speed)) if height > end else ((0.0, 0.0, end), ZERO)

    return goal


def pressing(stiffness: float, hand: Hand, press: float = PRESS) -> Goal:
    """A hand that comes down on a wall of a stiffness (N/m) until it presses it with so many newtons."""
    return coming_down(-press / stiffness - press / hand.stiffness)


def at_wall(
    device: Device,
    hand: Hand,
    timing: Timing,
    coupling: Coupling,
    guarded: bool = False,
    ideal: bool = True,
    stiffness: float | None = None,
    limits: Limits | None = None,
    coupled: type[Coupled] = Coupled,
) -> ClosedLoop:
    """A press on a wall as stiff as the device can render, or with a ``stiffness`` (N/m) of its own."""
    asked = device.stiffness if stiffness is None else stiffness
    arm = OneAxis(device.ideal if ideal else device.mechanics, hand, START)
    goal = pressing(min(asked, (limits or device.limits).max_stiffness), hand)
    return ClosedLoop(arm, Wall(asked), goal, timing, coupling, limits or device.limits, guarded, coupled)


RADIUS = 8.0
"""Of the tool, in voxels."""
DEPTH = 28
"""Voxels of material under it."""


def block(
    stiffness: float,
    full_force: float = 3.3,
    yield_ratio: float = 0.3,
    density: float = 1.0,
    band: float | None = RADIUS,
    sculpts: bool = True,
) -> Clay:
    """A ball on a block of material, whose steepest elastic slope is ``stiffness`` (N/m).

    That is F_full dV/dx / V = 3 F_full / (4 R) of a ball half inside (facts/physics.md 3), which tells how many metres
    of the arm a voxel is. The ball touches the block at height 0. With ``sculpts`` False it is only felt.
    """
    side = 5 * int(RADIUS)
    values = np.zeros((side, side, DEPTH + 2 * int(RADIUS)), np.float32)
    values[:, :, :DEPTH] = density
    push = Push(DensityGrid(values), SphereTool(RADIUS), Material(full_force, yield_ratio), band=band)
    voxels_per_metre = RADIUS / (3.0 * full_force / (4.0 * stiffness))
    middle = 0.5 * (side - 1)
    return Clay(push, laid_over((middle, middle, DEPTH - 0.5 + RADIUS), voxels_per_metre), sculpts)


def at_block(
    device: Device,
    hand: Hand,
    timing: Timing,
    coupling: Coupling,
    guarded: bool = False,
    arm: Arm | None = None,
    world: World | None = None,
    press: float = 0.5,
) -> ClosedLoop:
    """A press into a block of the real material as steep as the device can render: it yields, and is pressed on. The
    hand wants to be ``press`` newtons' worth of its own spring below the surface."""
    world = world or block(device.stiffness, device.force)
    arm = arm or OneAxis(device.ideal, hand, START)
    return ClosedLoop(arm, world, coming_down(-press / hand.stiffness), timing, coupling, device.limits, guarded)
