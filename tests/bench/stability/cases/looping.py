# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases that need the loop closed: at 1 kHz, with a collision that is late, over the real material."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import pi, sin

import numpy as np

from repousse.core import DensityGrid, Material
from repousse.core.material import largest_yield_ratio
from repousse.device import safety
from repousse.device.limits import PERIOD
from repousse.device.protocol import ForceModel

from ..arm import Mechanics
from ..arms3 import Led, ThreeAxes
from ..closed_loop import ClosedLoop, Goal, Trace, Triple
from ..collision import Timing
from ..contact import FULL_FORCE, RADIUS, SIDE, SURFACE, VOXEL, block, excess, pushed, total
from ..couplings import Coupling
from ..figure import Figure, exactly
from ..scenes import DEVICES, HANDS
from ..worlds import Clay, World, laid_over
from .curl import SHAPES, body
from .moving import JND, MASS, SPEED, THICKNESSES

MS = 1e-3
ARM = next(device for device in DEVICES if device.name == "Omni")
LIMITS = ARM.limits
LEAST_ENERGY = -1e-3
"""Joules that a hand may have got back beyond what it put in: .3 mm against an arm's 3.3 N."""
MOST_RISE = LIMITS.max_slew * PERIOD + 1e-9
"""Newtons a millisecond: the profiles' slew limit, K v/2 at the stiffest and fastest. What falls may fall at once."""
ENOUGH = 1e-3
"""Newtons of a sheet a voxel thick that are still a force against the motion."""


def clay(grid: DensityGrid, sculpts: bool = True, material: Material | None = None, **how) -> Clay:
    """A ball that touches :func:`block`'s surface at height 0 of the arm, in its middle."""
    push = pushed(grid, material=material, **how)
    middle = (np.array(grid.shape) - 1.0) / 2.0
    return Clay(push, laid_over((middle[0], middle[1], SURFACE - 0.5 + RADIUS), 1.0 / VOXEL), sculpts)


def loop(arm: Led | ThreeAxes, world: World, goal: Goal, period: float, latency: float = 0.0) -> ClosedLoop:
    """The default coupling over an arm; period and latency of the collision in ms."""
    return ClosedLoop(arm, world, goal, Timing(period * MS, latency * MS), Coupling.LOCAL, LIMITS)


def rise(trace: Trace) -> float:
    """The most by which the strength of the force rises in a millisecond, N."""
    return float(np.diff(np.linalg.norm(trace.force, axis=1)).max())


def sheets_in_the_loop() -> Iterator[Figure]:
    """Down through a sheet at 1 m/s, in which the ball's middle is 4 ms after the first touch: there is a force from
    when a model can have come until then, and never one along the motion."""
    for thickness in THICKNESSES:
        for period, latency in ((1, 0), (1, 1), (2, 0)):
            case = f"loop: sheet of {thickness} at 1 m/s, collision {period} ms, latency {latency} ms"
            grid = block(0.0)
            grid.density[:, :, int(SURFACE) - thickness : int(SURFACE)] = 1.0
            start = 4e-3

            def goal(now: float, start: float = start) -> tuple[Triple, Triple]:
                return (0.0, 0.0, start - SPEED * (now + PERIOD)), (0.0, 0.0, -SPEED)

            end = 2.0 * RADIUS * VOXEL
            trace = loop(Led((0.0, 0.0, start)), clay(grid), goal, period, latency).run((start + end) / SPEED)
            force = trace.force[:, 2]
            known = (trace.time > start / SPEED + (period + latency) * MS) & (trace.height > -end / 2.0)
            yield Figure(case, "least force against the motion", float(force[known].min()), "N", at_least=ENOUGH)
            yield Figure(case, "least force of all", float(force.min()), "N", at_least=0.0)


TURN = 0.02
"""Seconds from one reversal to the next."""
TREMBLE = 1.5
"""Times the change of force on the same way without encoder steps that there may be with them: the steps of the surface
itself are felt, 55 um of it; those of a velocity over 15 ms are not to be."""


def reversals() -> Iterator[Figure]:
    """Turned round every 20 ms at 0.1 m/s in what yields: straight, along, and aslant; read exactly and in steps."""
    for name, way in {"in and out": (0.0, 0.0, 1.0), "along": (1.0, 0.0, 0.0), "aslant": (0.8, 0.0, 0.6)}.items():
        traces = [_reversed(way, encoder) for encoder in (0.0, 55e-6)]
        changes = [np.abs(np.diff(trace.force[200:], axis=0)).sum() for trace in traces]
        case = f"loop: reversed every {TURN * 1e3:g} ms, {name}"
        yield Figure(
            case, "change of force, over that without encoder steps", float(changes[1] / changes[0]), "", TREMBLE
        )
        yield Figure(case, "greatest rise", rise(traces[1]), "N/ms", MOST_RISE)
        yield Figure(case, "least energy", traces[1].lowest_energy * 1e3, "mJ", at_least=LEAST_ENERGY * 1e3)
        yield Figure(case, "greatest force", float(np.linalg.norm(traces[1].force, axis=1).max()), "N", at_least=0.1)


def _reversed(way: Triple, encoder: float) -> Trace:
    deep, in_time = 2e-3, 0.1

    def goal(now: float) -> tuple[Triple, Triple]:
        into = min(now / in_time, 1.0)
        phase = max(now - in_time, 0.0) / TURN % 2.0
        along = 0.1 * TURN * (min(phase, 2.0 - phase))
        return (way[0] * along, 0.0, 1e-3 - into * (deep + 1e-3) + way[2] * along), (0.0, 0.0, 0.0)

    return loop(Led((0.0, 0.0, 1e-3), encoder), clay(block(1.0), band=float(RADIUS)), goal, 1).run(0.6)


class Stalling:
    """A world whose collision thread stands still for a while, and says again what it said last."""

    def __init__(self, world: World, begin: float, seconds: float) -> None:
        self._world, self._begin, self._end = world, begin, begin + seconds
        self._last: ForceModel | None = None

    def collide(self, place: Triple, now: float) -> ForceModel:
        if self._last is None or not self._begin <= now < self._end:
            self._last = self._world.collide(place, now)
        return self._last

    def feel(self, place: Triple, now: float) -> ForceModel:
        return self._world.feel(place, now)


STALLS = (5, 20, 100)
"""Milliseconds."""
ROUNDING = 1e-9
"""Newtons."""


def stalls() -> Iterator[Figure]:
    """The collision stands still: at the first touch, in the steepest slope, at the yield, on the way out; the hand is
    stopped there, goes on at 0.5 m/s, or is soft."""
    for stall in STALLS:
        moments = {"first touch": 0.2e-3, "in the slope": 1.0e-3, "deep": 3.0e-3}
        held, out, gone, left, on, energies, slews = [], [], [], [], [], [], []
        for depth in moments.values():
            stopped, _ = _stalled(stall, depth, then=0.0)
            during = _during(stopped, depth, stall)
            held.append(_rise(during))
            left.append(float(during[-1]))
            back, _ = _stalled(stall, depth, then=-1.0)
            during = _during(back, depth, stall)
            out.append(_rise(during))
            if stall * MS * COMING > depth + (3 * PERIOD) * COMING:
                gone.append(float(during[-1]))
            moved, bound = _stalled(stall, depth, then=1.0)
            on.append(float((np.linalg.norm(moved.force, axis=1)).max()) / bound)
            slews.append(rise(moved))
            energies.append(_soft(stall, depth))
        case = f"loop: collision stalled for {stall} ms"
        yield Figure(case, "rise of the force on a held arm", max(held), "N", ROUNDING)
        yield Figure(case, "rise of the force on an arm that goes out", max(out), "N", ROUNDING)
        yield exactly(case, "force on an arm that has come out", max(gone), 0.0, "N")
        if stall >= safety.FADE_TO / MS:
            yield Figure(case, "force on a held arm at its end", max(left), "N", ENOUGH)
        yield Figure(case, "force on a hand that goes on, over sigma_f", max(on), "", 1.0 + JND)
        yield Figure(case, "greatest rise", max(slews), "N/ms", MOST_RISE)
        yield Figure(case, "least energy of a soft hand", min(energies) * 1e3, "mJ", at_least=LEAST_ENERGY * 1e3)


COMING = 0.5
"""Metres a second."""
ABOVE = 2e-3


def _stalled(stall: int, depth: float, then: float) -> tuple[Trace, float]:
    """The trace, and the greatest yield stress that any model told. ``then`` the hand goes on (1), stops (0), or turns
    back (-1)."""
    begin = (ABOVE + depth) / COMING

    def goal(now: float) -> tuple[Triple, Triple]:
        way = COMING * (min(now + PERIOD, begin) + then * max(0.0, now + PERIOD - begin))
        return (0.0, 0.0, max(ABOVE - way, -6e-3)), (0.0, 0.0, 0.0)

    world = Stalling(clay(block(1.0), band=float(RADIUS)), begin, stall * MS)
    told = _Told(world)
    trace = loop(Led((0.0, 0.0, ABOVE)), told, goal, 1).run(begin + stall * MS + 0.05)
    return trace, told.most


@dataclass
class _Told:
    """A world, and the greatest yield stress (N) that it told."""

    world: World
    most: float = 0.0

    def collide(self, place: Triple, now: float) -> ForceModel:
        model = self.world.collide(place, now)
        self.most = max(self.most, model.yield_stress)
        return model

    def feel(self, place: Triple, now: float) -> ForceModel:
        return self.world.feel(place, now)


def _during(trace: Trace, depth: float, stall: int) -> np.ndarray:
    """How strong the force is in the stall, N, from when the arm has stopped and the slew limit has let it there."""
    begin = (ABOVE + depth) / COMING
    within = (trace.time >= begin + 3 * PERIOD) & (trace.time < begin - 0.5 * PERIOD + stall * MS)
    return np.linalg.norm(trace.force[within], axis=1)


def _rise(strength: np.ndarray) -> float:
    return max(0.0, float(np.diff(strength).max(initial=0.0)))


def _soft(stall: int, depth: float) -> float:
    """The least energy of a hand that wants to be 3 mm under the surface, and half a second later above it."""

    def goal(now: float) -> tuple[Triple, Triple]:
        return ((0.0, 0.0, -8e-3), (0.0, 0.0, 0.0)) if now < 0.5 else ((0.0, 0.0, 4e-3), (0.0, 0.0, 0.0))

    arm = ThreeAxes(ARM.ideal, HANDS["soft"], (0.0, 0.0, ABOVE))
    world = Stalling(clay(block(1.0), band=float(RADIUS)), 0.02 + depth * 10.0, stall * MS)
    return loop(arm, world, goal, 1).run(1.0).lowest_energy


DESKTOP = next(device for device in DEVICES if device.name == "Desktop")
COUNT = 0.055
"""Millimetres of an Omni's encoder step: what moves by less is at rest."""
WITHOUT_FRICTION = {1: COUNT, 8: 0.4, 16: 0.75}
"""Collision (ms), and mm that a tip without any friction may go on moving. Late collisions leave a small motion to and
fro; where the normal stood still between two models, a soft hand went round by 2 to 5 mm and got 5 to 50 mJ."""
SLOWEST = 33
"""Milliseconds of collision at which the least friction that an arm here has, .06 N, brings all to rest. Without any, a
soft hand in a pit goes to and fro by 2 mm after some seconds."""


def held_from_the_side() -> Iterator[Figure]:
    """Pressed with up to a newton into a pit of its own making, and into the mouth of a hole narrower than the ball,
    that does not yield and has the greatest curl of all: off the middle, and a second later off to the other side."""
    for name, hand in product(("pit", "hole"), HANDS):
        arms = [(period, ARM.ideal, most) for period, most in WITHOUT_FRICTION.items()]
        for period, mechanics, most in (*arms, (SLOWEST, DESKTOP.mechanics, COUNT)):
            case = f"loop: in a {name}, {hand} hand, friction {mechanics.friction} N, collision {period} ms"
            trace = held(held_in(name), hand, period, mechanics)
            yield Figure(case, "least energy", trace.lowest_energy * 1e3, "mJ", at_least=LEAST_ENERGY * 1e3)
            yield Figure(case, "motion in the third second", trace.peak_to_peak(2.0) * 1e3, "mm", most)
            yield Figure(case, "force", float(np.linalg.norm(trace.force[-1])), "N", at_least=0.1)


def held_in(name: str) -> Clay:
    """A block that yields into a pit, or a hole that does not."""
    if name == "pit":
        return clay(block(1.0), band=float(RADIUS))
    rigid = Material(FULL_FORCE, 0.999 * largest_yield_ratio(pushed(block()).tool))
    return clay(body(SHAPES["hole"]), sculpts=False, material=rigid)


def held(world: World, hand: str, period: float, mechanics: Mechanics = ARM.ideal) -> Trace:
    end = -1.0 / HANDS[hand].stiffness - 3e-3

    def goal(now: float) -> tuple[Triple, Triple]:
        return (3e-4 if now < 1.0 else -3e-4, 1e-4, max(2e-3 - 0.05 * now, end)), (0.0, 0.0, 0.0)

    return loop(ThreeAxes(mechanics, HANDS[hand], (0.0, 0.0, 2e-3)), world, goal, period).run(3.0)


@dataclass(frozen=True)
class Wandering:
    """A hand that goes anywhere, in sines of up to 10 Hz (human motion) with random phases: m and m/s at a time."""

    seed: int
    reach: Triple = (6e-3, 6e-3, 7e-3)
    middle: float = 3e-3
    sines: int = 6

    def goal(self) -> Goal:
        random = np.random.default_rng(self.seed)
        rates = 2.0 * pi * np.geomspace(0.2, 10.0, self.sines)
        phases = random.uniform(0.0, 2.0 * pi, (3, self.sines))
        shares = rates**-0.5  # slow ways are long
        sizes = np.array(self.reach)[:, None] * shares / np.sqrt((shares**2).sum())
        rows = [list(zip(rates.tolist(), phases[a].tolist(), sizes[a].tolist(), strict=True)) for a in range(3)]

        def at(now: float) -> tuple[Triple, Triple]:
            x, y, z = (sum(size * sin(rate * now + phase) for rate, phase, size in row) for row in rows)
            u, v, w = (sum(size * rate * sin(rate * now + phase + pi / 2) for rate, phase, size in row) for row in rows)
            return (x, y, z + self.middle), (u, v, w)

        return at


TOUCH = 1e-3
"""Newtons that count as one: what a tool has strewn in the air is less."""


class Wander:
    """Random motion over a block that yields, second by second: the worst of all that is seen, and nothing kept."""

    def __init__(self, hand: str, period: float, seed: int, latency: float = 0.0) -> None:
        self.grid = block(1.0, side=SIDE + 24)
        self.world = clay(self.grid, band=float(RADIUS))
        self.before = total(self.grid)
        goal = Wandering(seed).goal()
        self.loop = loop(ThreeAxes(ARM.ideal, HANDS[hand], (0.0, 0.0, 12e-3)), self.world, goal, period, latency)
        self.energy = self.touch_energy = self.force = self.rise = self.touching = self.visited = 0.0
        self._visited = 0
        self._since = 0.0  # joules when the last touch began

    def second(self) -> None:
        """Live through one."""
        trace = self.loop.trace
        last = trace.moments[-1:]
        trace.moments[:] = last
        self.loop.run(1.0)
        forces = np.linalg.norm(trace.force, axis=1)
        self.force = max(self.force, float(forces.max()))
        self.rise = max(self.rise, rise(trace))
        self.energy = min(self.energy, trace.lowest_energy)
        self.touching += float((forces > TOUCH).mean())
        for moment, force in zip(trace.moments, forces, strict=True):
            if force <= TOUCH:
                self.touch_energy = min(self.touch_energy, moment.energy - self._since)
                self._since = moment.energy
        solves, visited = len(self.world.solved), self.world.push.voxels_visited
        self.visited = max(self.visited, (visited - self._visited) / max(solves, 1))
        self._visited = visited
        self.world.solved[:-1] = []


SECONDS, LONG = 20, 600
"""Of virtual time: in the tests, and in the long run."""


def wandering(seconds: int = SECONDS) -> Iterator[Figure]:
    """Random motion of the hand over and in a block: a soft hand and a firm one, a fast collision and a slow one."""
    for hand, period in (("soft", 1), ("firm", 8)):
        wander = Wander(hand, period, seed=1)
        for _ in range(seconds):
            wander.second()
        yield from wandered(f"loop: {seconds} s of random motion, {hand} hand, collision {period} ms", wander, seconds)


def wandering_long() -> Iterator[Figure]:
    """The same for ten minutes: some minutes of a processor."""
    yield from wandering(LONG)


def wandered(case: str, wander: Wander, seconds: int) -> Iterator[Figure]:
    """What random motion has come to."""
    yield Figure(case, "least energy", wander.energy * 1e3, "mJ", at_least=LEAST_ENERGY * 1e3)
    yield Figure(case, "least energy of one touch", wander.touch_energy * 1e3, "mJ", at_least=LEAST_ENERGY * 1e3)
    yield Figure(case, "greatest force", wander.force, "N", FULL_FORCE)
    yield Figure(case, "greatest rise", wander.rise, "N/ms", MOST_RISE)
    yield Figure(case, "voxels visited a solve, of the grid's", wander.visited / wander.grid.density.size, "", 1.0)
    yield Figure(case, "density out of [0, 1]", excess(wander.grid), "", 0.0)
    yield Figure(case, "mass won or lost", abs(total(wander.grid) / wander.before - 1.0), "of all", MASS)
    yield Figure(case, "time in touch", wander.touching / seconds, "of all", at_least=0.1)


CASES = (sheets_in_the_loop, reversals, stalls, held_from_the_side, wandering)
LONG_CASES = (wandering_long,)
