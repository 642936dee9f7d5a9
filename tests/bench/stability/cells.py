# SPDX-License-Identifier: GPL-3.0-or-later
"""The map: each coupling with and without a guard, over how often, how late and how unevenly the collision tells.

A row is a press on a wall as stiff as an arm can render. It is made twice, by an arm without friction and encoder steps
(what theory knows, and mostly the harder case) and by one with its own, and the worse of both is told. It fails when
the tip still moves by more than one of that arm's encoder steps after two seconds, or more and more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np

from . import theory
from .arm import OneAxis
from .closed_loop import ClosedLoop, Trace, limits_for
from .collision import Timing
from .couplings import Coupling
from .scenes import DEVICES, HANDS, MS, Device, at_wall
from .worlds import Wall

PERIODS = (1.0, 2.0, 5.0, 10.0, 16.7, 20.0, 33.0)
"""Milliseconds from one model to the next."""
LATENCIES = (0.0, 0.5, 1.0)
"""Of a period."""
JITTERS = (0.0, 0.5)
"""Of a period."""
GUARDS = ("none", "passivity")
SETTLED, WHOLE = 2.0, 2.5
"""Seconds after which the hand has to be at rest, and that a press takes."""
STEADY = 0.97
"""Share of a movement's size that is left after a time in which it counts as not getting less."""


class Cell(NamedTuple):
    """Where on the map: milliseconds, a hand by name, N/m that a device can render."""

    coupling: str
    guard: str
    collision_ms: float
    latency_ms: float
    jitter_ms: float
    hand: str
    k_asked: float

    @property
    def timing(self) -> Timing:
        return Timing(self.collision_ms * MS, self.latency_ms * MS, self.jitter_ms * MS)

    @property
    def device(self) -> Device:
        return next(device for device in DEVICES if device.stiffness == self.k_asked)


class Row(NamedTuple):
    """A line of the table. ``k_granted`` is what was rendered of ``k_asked``; ``k_max`` the stiffest wall that comes to
    rest, measured, and ``k_theory`` by eigenvalues, without jitter and guard; all N/m."""

    coupling: str
    guard: str
    collision_ms: float
    latency_ms: float
    jitter_ms: float
    hand: str
    k_asked: float
    k_granted: float
    k_max: float
    k_theory: float
    peak_to_peak_mm: float
    max_slew_n_per_ms: float
    energy_min_j: float

    @property
    def cell(self) -> Cell:
        return Cell(*self[:7])

    @property
    def fails(self) -> bool:
        return bool(self.peak_to_peak_mm * MS > self.cell.device.mechanics.encoder)


def all_cells(
    couplings: Iterable[Coupling] = Coupling,
    guards: Sequence[str] = GUARDS,
    periods: Sequence[float] = PERIODS,
    latencies: Sequence[float] = LATENCIES,
    jitters: Sequence[float] = JITTERS,
) -> list[Cell]:
    """The map, or a part of it; latency and jitter in shares of the period."""
    return [
        Cell(coupling.value, guard, period, latency * period, jitter * period, hand, device.stiffness)
        for coupling, guard, period, latency, jitter, hand, device in product(
            couplings, guards, periods, latencies, jitters, HANDS, DEVICES
        )
    ]


def press(cell: Cell, ideal: bool) -> Trace:
    """The press of a cell, by the arm without friction and encoder steps or by the other."""
    coupling, guarded = Coupling(cell.coupling), cell.guard != "none"
    return at_wall(cell.device, HANDS[cell.hand], cell.timing, coupling, guarded, ideal).run(WHOLE)


def measure(cell: Cell) -> Row:
    """A row of the map."""
    share, *moved = _pressed(_seen_by(cell))
    return Row(*cell, cell.k_asked * share, k_max(cell), k_theory(cell), *moved)


@cache
def _pressed(cell: Cell) -> tuple[float, float, float, float]:
    """The share of the slope that was granted, and what of a row tells of motion, force and energy. Where no slope is
    followed none is softened."""
    traces = [press(cell, ideal) for ideal in (True, False)]
    followed = Coupling(cell.coupling) in (Coupling.LOCAL, Coupling.IN_LOOP)
    return (
        min(trace.granted(SETTLED) for trace in traces) if followed else 1.0,
        1e3 * max(trace.peak_to_peak(SETTLED) for trace in traces),
        max(trace.max_slew for trace in traces),
        min(trace.lowest_energy for trace in traces),
    )


def k_theory(cell: Cell) -> float:
    """N/m by eigenvalues, of arms without friction and encoder steps, without jitter and guard."""
    return _k_theory(*_seen_by(cell)[2:4], cell.coupling, cell.hand)


@cache
def _k_theory(collision_ms: float, latency_ms: float, coupling: str, hand: str) -> float:
    timing = Timing(collision_ms * MS, latency_ms * MS)
    return theory.limit(Coupling(coupling), DEVICES[0].ideal, HANDS[hand], timing)


def k_max(cell: Cell) -> float:
    """N/m of the stiffest wall on which a hand comes to rest, by bisection of the loop itself; whatever is asked of the
    cell. Without a guard it is looked for around what theory says; with one, that a limit cycle within an encoder step
    is rest, up to six times that."""
    return _k_max(_seen_by(cell)._replace(k_asked=0.0))


def _seen_by(cell: Cell) -> Cell:
    """The cell as its coupling sees it: a loop that estimates by itself does not know the collision's timing."""
    if Coupling(cell.coupling) is not Coupling.IN_LOOP:
        return cell
    return cell._replace(collision_ms=PERIODS[0], latency_ms=0.0, jitter_ms=0.0)


@cache
def _k_max(cell: Cell) -> float:
    expected, guarded = k_theory(cell), cell.guard != "none"
    rests = quietens if guarded else settles
    spread = 1.3 if cell.jitter_ms == 0.0 else 2.0
    low, high = expected / spread, expected * (6.0 if guarded else spread)
    for _ in range(6):
        middle = (low * high) ** 0.5
        if rests(cell, middle):
            low = middle
        else:
            high = middle
    return (low * high) ** 0.5


UNLIMITED = limits_for(1e3, 1e7, 5.0, damping=1e4)
"""Neither force nor slope are bounded: so all is linear but for a guard."""


def settles(cell: Cell, stiffness: float) -> bool:
    """Whether a hand that presses a wall of so many N/m with 1 N, and is a hundredth of its depth off rest, moves less
    and less."""
    hand, depth = HANDS[cell.hand], 1.0 / stiffness
    arm = OneAxis(DEVICES[0].ideal, hand, -0.99 * depth)
    goal = (0.0, 0.0, -depth - 1.0 / hand.stiffness), (0.0, 0.0, 0.0)
    loop = ClosedLoop(arm, Wall(stiffness), lambda _: goal, cell.timing, Coupling(cell.coupling), UNLIMITED)
    loop.know((-2.0 * cell.timing.period, -cell.timing.period))
    height = loop.run(2.1).height
    third = len(height) // 3
    before, after = np.ptp(height[third : 2 * third]), np.ptp(height[2 * third :])
    return bool(after < STEADY * before or after < 1e-5 * depth)


def quietens(cell: Cell, stiffness: float) -> bool:
    """Whether a hand that comes down on a wall of so many N/m moves by no more than the coarsest encoder step, after
    two seconds."""
    device, coupling = DEVICES[0], Coupling(cell.coupling)
    loop = at_wall(device, HANDS[cell.hand], cell.timing, coupling, cell.guard != "none", True, stiffness, UNLIMITED)
    return loop.run(WHOLE).peak_to_peak(SETTLED) < device.mechanics.encoder
