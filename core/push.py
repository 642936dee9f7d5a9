# SPDX-License-Identifier: GPL-3.0-or-later
"""Push: one tool in one grid. A position goes in; what the hand feels, and what moved, comes out (paper 5 to 7)."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import ceil, dist, hypot, inf, isfinite, nan
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np

from . import dispersion, rim
from . import smooth as smoothing
from .bricks import BRICK
from .grid import Box, DensityGrid, union
from .history import History
from .material import Material, largest_yield_ratio
from .native.state import BORDERS, NEEDS_GROWTH, ORDERS, Workspace, box_from, no_box
from .plasticity import Regime, contact_normal, estimate, felt_force, overloaded, regime_of, stresses
from .quality import quality_named
from .recursion import disperse_recursively
from .tool import Tool, Vector, unit, vector

if TYPE_CHECKING:
    from .stroke import Sample, Stroke

METHODS = ("sweep", "recursive")
VERBS = ("push", "pull", "smooth")
SAME_DIRECTION = 1e-9
"""Distance of two unit vectors that differ by rounding only."""
TURNING_STEP = 0.25
"""Voxels of travel, since it last told the direction of a dispersion, from which on it tells it again."""
RETREAT = 0.5
"""Component of a way along the outward contact normal above which the tool is drawn back."""
GROWTH_SHARE = 64
"""A side grows by a brick for each so many voxels along it, an eighth: the copy that each growth costs stays rare."""
GIVEN = 0.999
"""Share of what was wanted below which packed material has given all it can."""
NO_ROOM_WITHIN = 4.0
"""Half lengths of the tool ahead of its centre: flux that goes on beyond them has met full material."""
BLOCKED = 1e-3
"""Share of what was emptied that has to come back before the tool counts as blocked."""


@dataclass(frozen=True)
class Contact:
    """What a move met. All masses are for this move alone, in voxels' worth.

    ``stress`` is sigma after dispersion and ``yield_stress`` sigma_f, newtons; ``force`` (3,) newtons on the hand, with
    |force| = min(stress, yield_stress); ``residual`` the newtons by which the stress still exceeds the yield stress;
    ``dirty`` a half-open box around all voxels that changed, in the frame of the poses, or None; ``tool_mass`` is M_t
    after dispersion.
    """

    regime: Regime
    stress: float
    yield_stress: float
    force: np.ndarray
    moved_mass: float = 0.0
    mass_out: float = 0.0
    blocked: bool = False
    sweeps: int = 0
    residual: float = 0.0
    dirty: Box | None = None
    tool_mass: float = 0.0


class Push:
    """One tool pushed through one grid.

    Parameters
    ----------
    grid
        Changed in place; :attr:`grid` is the live grid.
    tool, material
        Lengths in voxels, forces in newtons.
    method
        "sweep", or "recursive": the paper's recursion, literally, for small grids.
    border
        What happens to density that would leave the grid: "grow" pads the grid in whole bricks, "wall" sends it back
        into the tool's voxels, "open" lets it go and counts it.
    band
        Voxels ahead of the tool beyond which nothing goes: the paper's reflecting plane (3.3). What reaches it rises
        as a rim. None: no plane, the paper's pyramid without end.
    rim
        Radius of the rim's hats in contact radii.
    wake
        Tool radii behind the tool that the rim keeps clear; it keeps clear as far as the tool came since it touched.
    verb
        "push"; "pull": material comes out of the tool along the direction that a move gives, until what is left has a
        density lower than that around it by the move's strength, always by sweeps and without a band; "smooth": density
        evens out inside the tool, once for each quarter radius of travel.
    quality
        "exact", "balanced" or "draft": what a step may cost (core/quality.py), where a move does not say.

    Poses and dirty boxes stay in the index frame that the grid had when the push was made; :attr:`origin` is where the
    first voxel of the grid lies in that frame. Several pushes may share a grid: each follows when
    another makes it grow.

    :attr:`epoch` is odd exactly while mass is in flight, and only ever rises: what was estimated while it was odd, or
    across a change of it, is worth nothing.

    Raises
    ------
    ValueError
        For an empty grid, or an option that is not one of those above.
    """

    def __init__(
        self,
        grid: DensityGrid,
        tool: Tool,
        material: Material,
        method: str = "sweep",
        border: str = "grow",
        band: float | None = None,
        rim: float = 2.0,
        wake: float = 1.0,
        verb: str = "push",
        quality: str = "exact",
    ) -> None:
        if method not in METHODS:
            raise ValueError(f'there is no method "{method}": choose from {", ".join(METHODS)}')
        if border not in BORDERS:
            raise ValueError(f'there is no border "{border}": choose from {", ".join(BORDERS)}')
        if verb not in VERBS:
            raise ValueError(f'there is no verb "{verb}": choose from {", ".join(VERBS)}')
        for what, value in (("band", 0.0 if band is None else band), ("rim", rim), ("wake", wake)):
            if not _is_length(value):
                raise ValueError(f"{what} is a number from 0 up, not {value!r}")
        if grid.bricks.empty:
            raise ValueError("the grid is empty: no voxel has any density to push")
        self.grid, self.material, self.verb = grid, material, verb
        self.method, self.border, self.rim, self.wake = method, border, rim, wake
        self.band = band if verb == "push" else None
        self.quality = self._quality = quality_named(quality)
        self.epoch = 0
        self._frame = self._grown = grid.grown
        self._strength = 1.0
        self._given: Vector | None = None  # direction of the present move
        self._aimed: tuple | None = None  # what the sweeps are made ready for
        self._work = Workspace(grid.density, grid.bricks)
        self._take_up(tool)
        self._warn_if_unyielding()
        self.lift()

    @property
    def origin(self) -> tuple[int, int, int]:
        """Where the grid's first voxel lies in the frame of the poses."""
        (x, y, z), (i, j, k) = self._frame, self.grid.grown
        return x - i, y - j, z - k

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """The last contact of each tool: of this one."""
        return (self._contact,)

    @property
    def position(self) -> Vector | None:
        """Where the tool is, in the frame of the poses; None when it is out."""
        return self._position

    def _take_up(self, tool: Tool) -> None:
        self.tool = tool
        self.k_t, self.k_s = self.material.stiffness(tool)
        self._work.take_up(tool)

    def _warn_if_unyielding(self) -> None:
        bound = largest_yield_ratio(self.tool)
        if self.verb == "push" and self.material.yield_ratio >= bound:
            warnings.warn(
                f"this material may never yield: yield_ratio {self.material.yield_ratio:g} is not below {bound:.3g}, "
                "the bound of this tool and reach in uniform material",
                stacklevel=3,
            )

    def lift(self) -> None:
        """Take the tool out: the next position is a new contact, not a move."""
        self._position: Vector | None = None
        self._solved: Vector | None = None  # where the last estimate was made; None asks for a new one
        self._turned_at: Vector | None = None  # where density moved last, or where the contact began
        self._direction: Vector | None = None
        self._entered: Vector | None = None  # where the contact began
        self._heading: Vector | None = None  # which way the last step went
        # What M_s gains for each voxel's worth that leaves the tool, as the last sweeps found it: all, until some of it
        # leaves the reach. It rises at once and falls slowly, so that no step moves more than it should; with it one
        # sweep mostly meets sigma_f, without it 1.7 do.
        self._gain = 1.0
        self._unsmoothed = inf  # voxels of travel since the last smoothing
        self._went_far = False  # the flux of the last sweep
        self._contact = Contact(Regime.NONE, 0.0, 0.0, np.zeros(3))

    def move_to(
        self,
        position: Iterable[float],
        radius: float | None = None,
        continuous: bool = False,
        direction: Iterable[float] | None = None,
        strength: float | None = None,
        quality: str | None = None,
    ) -> Contact:
        """Move the tool to ``position`` (x, y, z) in voxels, in solves of at most half a voxel (draft: a whole one).

        ``radius`` is the tool's from here on, its reach in proportion. A jump of more than a tool's diameter lifts the
        tool, unless ``continuous``. ``direction`` (unit vector) is where material flows; None: along the displacement.
        ``strength`` (0 to 1, None: 1) is what pulling and smoothing work with; ``quality`` None is the push's.

        Raises
        ------
        ValueError
            When position, direction or radius is not finite, the radius under one voxel, the direction not of unit
            length, the strength outside 0 to 1 or the quality unknown; the grid is untouched.
        """
        target = _checked(position)
        given = None if direction is None else unit(direction)
        strength = 1.0 if strength is None else _checked_strength(strength)
        self._quality = self.quality if quality is None else quality_named(quality)
        if radius is not None and radius != self.tool.radius:
            self._take_up(self.tool.scaled(radius))
            self._solved = None
        if strength != self._strength:
            self._strength, self._solved = strength, None
        self._given = given
        self._notice_growth()
        if self._position is not None and not continuous and dist(target, self._position) > 2.0 * self.tool.radius:
            self.lift()
        self._contact = self._joined([self._solve(step) for step in self._steps_to(target)])
        return self._contact

    def follow(self, stroke: Stroke) -> list[Contact]:
        """Move through every sample of a Stroke."""
        return [self.walk(sample, stroke.continuous) for sample in stroke.samples]

    def walk(self, sample: Sample, continuous: bool = False) -> Contact:
        """Move to one sample of a Stroke."""
        return self.move_to(
            sample.position, sample.radius, continuous, sample.direction, sample.strength, sample.quality
        )

    def remember(self) -> History:
        """Keep before-images of all that changes from here on."""
        self._notice_growth()
        history = History(self.grid, self.carry)
        history.attach(self._work)
        return history

    def restore(self, history: History) -> None:
        """Make the grid what it was when ``history`` began, bit for bit, and lift the tool."""
        shrunk = history.origin_in((0, 0, 0))
        x, y, z = self.grid.grown
        history.restore(self.grid)
        self.grid.grown = (x - shrunk[0], y - shrunk[1], z - shrunk[2])
        self.forget(history, history.carry)

    def join(self, history: History) -> None:
        """Keep the before-images of what this push changes with those of another push through the same grid."""
        self._notice_growth()
        history.attach(self._work)

    def forget(self, history: History, carry: float) -> None:
        """Keep no more before-images in ``history``, which has been restored; owe ``carry`` of mass, as then; lift."""
        history.detach(self._work)
        dispersion.forget_emptied(self._work)  # an error may have left mass in flight
        self.epoch += 2 - self.epoch % 2
        self.carry = carry
        self._notice_growth()
        self.lift()

    @property
    def carry(self) -> float:
        """Mass in voxels' worth that rounding to float32 has kept back so far; it travels with the next flux."""
        return float(self._work.emptied.carry)

    @carry.setter
    def carry(self, mass: float) -> None:
        self._work.emptied.carry = mass

    @property
    def voxels_visited(self) -> int:
        """Voxels of flux that all sweeps so far have looked at: the cost of a push, counted."""
        return int(self._work.sweep.visited)

    @property
    def flow(self) -> str:
        """How density moves here, one of `quality.FLOWS`: with a band it rises; else the last sweep tells whether it
        found room near the tool."""
        if self.band is not None:
            return "rim"
        return "saturated" if self._went_far else "compressible"

    def _steps_to(self, target: Vector) -> list[Vector]:
        if self._position is None:
            return [target]
        start = self._position
        longest = self._quality.longest_step
        steps = max(1, ceil(dist(target, start) / longest - 1e-9))  # half a voxel is one step, however it rounds
        if steps == 1:
            return [target]
        first, last = self._near_grid(start, target)
        near = range(max(1, int(first * steps)), min(steps - 1, ceil(last * steps)) + 1)
        return [_between(start, target, step / steps) for step in near] + [target]

    def _near_grid(self, start: Vector, target: Vector) -> tuple[float, float]:
        """The part of a way, from 0 to 1, on which the tool may touch the grid; a jump through empty space is free."""
        first, last = 0.0, 1.0
        for begin, end, low, n, extent in zip(
            start, target, self.origin, self.grid.shape, self._work.volume.extent, strict=True
        ):
            if abs(end - begin) < 1e-9:
                continue
            enter, leave = ((edge - begin) / (end - begin) for edge in (low - extent - 1.0, low + n + extent + 1.0))
            first, last = max(first, min(enter, leave)), min(last, max(enter, leave))
        return first, last

    def _solve(self, position: Vector) -> Contact:
        """One step: estimate, disperse what overloads the material, and say what is felt."""
        work, former = self._work, self._contact
        if position == self._solved:  # at rest nothing creeps
            rests = (former.regime, former.stress, former.yield_stress, former.force)
            return Contact(*rests, residual=former.residual, tool_mass=former.tool_mass)
        work.tool.centre[:] = [p - o for p, o in zip(position, self.origin, strict=True)]
        travel = dist(position, self._position) if self._position is not None else 0.0
        if self._position is not None and travel > 0.0:
            self._heading = _scaled(position, self._position, 1.0 / travel)
        self._position = self._solved = position
        estimate(work)
        masses = work.estimate
        stress, yield_stress = self._stresses()
        if stress <= 0.0 or self._turned_at is None:
            self._turned_at = self._entered = position
        normal = contact_normal((masses.gradient[0], masses.gradient[1], masses.gradient[2]))
        if self.verb == "smooth":
            moved = self._smooth(travel)
        elif self.verb == "pull" or overloaded(masses.tool_mass, self.material.yield_ratio * masses.reach_mass):
            moved = self._move_density(position, self._turned_at, normal)
        else:
            moved = None
        if moved is not None:
            stress, yield_stress = self._stresses()
        regime = regime_of(stress, moved is not None, former.stress, former.regime)
        force = felt_force(stress, yield_stress, normal, self._direction)
        residual = max(0.0, stress - yield_stress) if moved is not None else 0.0
        moved = moved or _Moved()
        self._contact = Contact(
            regime,
            stress,
            yield_stress,
            force,
            moved.mass,
            moved.out,
            moved.blocked,
            moved.sweeps,
            residual,
            moved.dirty,
            masses.tool_mass,
        )
        return self._contact

    def _stresses(self) -> tuple[float, float]:
        """sigma and sigma_f in newtons."""
        return stresses(self._work.estimate, self.material, self.k_t, self.k_s, self.verb == "push")

    def _move_density(self, position: Vector, turned_at: Vector, normal: Vector) -> _Moved | None:
        """Disperse or draw out what is too much in the tool, if it is known whither."""
        direction, turned = self._push_direction(position, turned_at, normal)
        if direction is None:
            return None
        moved = self._draw_out(direction) if self.verb == "pull" else self._relax(direction)
        if moved is not None:
            self._direction = direction
            if turned:
                self._turned_at = position
        return moved

    def _push_direction(self, position: Vector, turned_at: Vector, normal: Vector) -> tuple[Vector | None, bool]:
        """u: the direction given; else the displacement since it last told u, the previous u, or into the contact
        (DESIGN 2). And whether this is where u was told anew: were it each dispersion, a path of small steps would
        never turn."""
        if self._given is not None:
            return self._given, True
        former, way = self._direction, dist(position, turned_at)
        if way < TURNING_STEP:
            if former is not None:
                return former, False
            return (_scaled((0.0, 0.0, 0.0), normal, 1.0) if hypot(*normal) >= 1.0 - 1e-9 else None), True
        direction = _scaled(position, turned_at, 1.0 / way)
        if former is None:
            return direction, True
        # A straight path keeps its direction to the last bit, and with it all that was made ready for it.
        if dist(direction, former) < SAME_DIRECTION:
            return former, True
        # What is drawn back pushes nothing that way, also where the material is so full that it stays overloaded.
        if sum(n * d for n, d in zip(normal, direction, strict=True)) > RETREAT:
            return former, False
        return direction, True

    def _relax(self, direction: Vector) -> _Moved:
        """Move density until sigma = sigma_f: k_t (M_t - x) = k_s (M_s + x - L(x))."""
        if self.method == "recursive":
            return self._relax_recursively(direction)
        work, kappa, moved = self._work, self.material.yield_ratio, _Moved()
        masses, axis, packed = work.estimate, dispersion.dominant_axis(direction), self.band is not None
        self._aim(direction, axis)
        gain = self._gain
        while moved.sweeps < self._quality.most_sweeps:
            excess = masses.tool_mass - kappa * masses.reach_mass
            wanted = excess / (1.0 + kappa * gain)
            tool_mass, reach_mass = masses.tool_mass, masses.reach_mass
            with self._in_flight():
                dispersion.empty(work, axis, wanted, packed)
                if work.emptied.mass <= 0.0:
                    break
                all_given = packed and work.emptied.tool_loss < GIVEN * wanted  # its voxels' free parts hold the rest
                self._disperse(direction, axis, moved)
            lost = tool_mass - masses.tool_mass
            if all_given or lost <= 1e-6 * tool_mass:
                break
            gain = min(max((masses.reach_mass - reach_mass) / lost, 0.0), 1.0)
            self._gain = max(gain, (self._gain + gain) / 2.0)
            if not overloaded(masses.tool_mass, kappa * masses.reach_mass):
                break
        return moved

    def _aim(self, direction: Vector, axis: int) -> None:
        aimed = (direction, self.tool, self.border, self.band, self._quality.leap)
        if self._aimed != aimed:
            dispersion.aim(self._work, direction, axis, BORDERS.index(self.border), self.band, self._quality.leap)
            self._aimed = aimed

    def _draw_out(self, direction: Vector) -> _Moved | None:
        """Pull: what the tool's voxels hold above their level goes along ``direction``, out of the material."""
        work, moved, axis = self._work, _Moved(), dispersion.dominant_axis(direction)
        dense = dispersion.density_behind(work, direction)
        if self._strength <= 0.0 or dense <= 0.0:
            return None
        self._aim(direction, axis)
        with self._in_flight():
            dispersion.loosen(work, axis, dense, self._strength)
            if work.emptied.mass <= 0.0:
                return None
            self._disperse(direction, axis, moved)
        return moved

    def _smooth(self, travel: float) -> _Moved | None:
        """Smooth once for each `smooth.TRAVEL` radii of travel, and once where the contact begins."""
        work, step = self._work, smoothing.TRAVEL * self.tool.radius
        begins = self._unsmoothed == inf
        self._unsmoothed += min(travel, self._quality.longest_step)  # a jump through air smooths nothing
        times = 1 if begins else int(self._unsmoothed / step)
        if not times or self._strength <= 0.0 or work.estimate.tool_mass <= 0.0:
            return None
        self._unsmoothed = 0.0 if begins else self._unsmoothed - times * step
        with self._in_flight():
            mass = smoothing.smooth(work, self._strength, times * smoothing.passes_of(self.tool))
        estimate(work)
        return _Moved(mass, dirty=self._in_pose_frame(box_from(work.sweep.dirty)))

    @contextmanager
    def _in_flight(self) -> Iterator[None]:
        """While mass is in flight, the epoch is odd; it stays so when an error leaves it there, until a restore."""
        self.epoch += 1 + self.epoch % 2
        yield
        self.epoch += 1

    def _disperse(self, direction: Vector, axis: int, moved: _Moved) -> None:
        """Sweep what was emptied, raise what the band turns back, return what finds no room; M_t and M_s follow."""
        work = self._work
        masses, emptied, sweep = work.estimate, work.emptied, work.sweep
        sweep.dirty[:] = work.rim.dirty[:] = no_box()
        work.rim.tool_gain = work.rim.reach_gain = 0.0
        dispersion.sweep_emptied(work)
        while dispersion.sweep(work) == NEEDS_GROWTH:
            self._grow(sweep.needs[0::2], sweep.needs[1::2])
        self._went_far = abs(sweep.plane - work.tool.centre[axis]) > NO_ROOM_WITHIN * work.volume.extent[axis]
        left = sweep.surplus
        if left > 0.0 and self.band is not None:
            # Pressed one way while it goes another, the tool leaves its wake where it came from: its groove stays open.
            behind = direction if self._given is None or self._heading is None else self._heading
            left = rim.raise_rim(work, np.array(behind), left, self.rim, self._shaft(behind), self._make_room)
        if left > 0.0:
            dispersion.put_back(work, left)
        # What was moved is known, so nothing is summed anew.
        masses.tool_mass += work.rim.tool_gain - emptied.tool_loss
        masses.reach_mass += work.rim.reach_gain + sweep.reach_gain - emptied.reach_loss
        moved.out += sweep.mass_out
        dirty = union(union(self._emptied_box(axis), box_from(sweep.dirty)), box_from(work.rim.dirty))
        work.settle(dirty)
        moved.dirty = union(moved.dirty, self._in_pose_frame(dirty))
        moved.sweeps += 1
        moved.mass += emptied.mass - left
        moved.blocked |= left > BLOCKED * emptied.mass
        dispersion.forget_emptied(work)

    def _shaft(self, behind: Vector) -> float:
        """How far back the tool's wake is kept clear: as far as it has come since it touched, or the hole closes."""
        way = 0.0
        if self._entered is not None and self._position is not None:
            way = sum((p - e) * u for p, e, u in zip(self._position, self._entered, behind, strict=True))
        return max(way, self.wake * self.tool.radius)

    def _relax_recursively(self, direction: Vector) -> _Moved:
        work, outside = self._work, "keep" if self.border == "wall" else "leave"
        with self._in_flight():
            while True:
                outcome = disperse_recursively(work, np.array(direction), self.material.yield_ratio, outside)
                if self.border != "grow" or not outcome.mass_out:
                    break
                work.density[:] = outcome.before  # it ran over the border: make the grid larger, and run again
                self._grow((1, 1, 1), (1, 1, 1))
                estimate(work)
        blocked = outcome.kept > BLOCKED * outcome.emptied
        return _Moved(outcome.emptied - outcome.kept, outcome.mass_out, blocked, 1, self._in_pose_frame(outcome.dirty))

    def _emptied_box(self, axis: int) -> Box:
        order, emptied = ORDERS[axis], self._work.emptied
        low, high = ([end[order.index(a)] for a in range(3)] for end in (emptied.first, emptied.last))
        return (low[0], low[1], low[2]), (high[0], high[1], high[2])

    def _make_room(self, low: list[int], high: list[int]) -> None:
        """Before the rim rises: let the grid reach beyond a box on every side where material stands at its border."""
        if self.border != "grow":
            return
        below, above = [0, 0, 0], [0, 0, 0]
        inside = tuple(slice(max(0, a), max(0, b)) for a, b in zip(low, high, strict=True))
        for a in range(3):
            face = list(inside)
            if low[a] <= 0:
                face[a] = slice(0, 1)
                below[a] = int(self.grid.density[tuple(face)].any())
            if high[a] >= self.grid.shape[a]:
                face[a] = slice(-1, None)
                above[a] = int(self.grid.density[tuple(face)].any())
        if any(below) or any(above):
            self._grow(below, above)

    def _grow(self, below: Sequence[int], above: Sequence[int]) -> None:
        """Pad the grid in whole bricks on the sides that are asked for; everything that is under way follows."""
        work = self._work
        bricks = [BRICK * max(1, n // GROWTH_SHARE) for n in self.grid.shape]
        below = (bricks[0] * bool(below[0]), bricks[1] * bool(below[1]), bricks[2] * bool(below[2]))
        self.grid.grow(below, (bricks[0] * bool(above[0]), bricks[1] * bool(above[1]), bricks[2] * bool(above[2])))
        work.attach(self.grid.density, self.grid.bricks, sweeping=True)
        work.moved(below)
        self._follow_grid(below)

    def _notice_growth(self) -> None:
        """Another push may have given the grid another array since this one last looked."""
        if self._work.density is self.grid.density:
            return
        x, y, z = (now - then for now, then in zip(self.grid.grown, self._grown, strict=True))
        self._work.attach(self.grid.density, self.grid.bricks)
        self._solved = None
        self._follow_grid((x, y, z))

    def _follow_grid(self, below: tuple[int, int, int]) -> None:
        history, self._grown = self._work.history, self.grid.grown
        if history is not None:
            history.grew(self.grid.density, below)
            history.attach(self._work)

    def _in_pose_frame(self, box: Box | None) -> Box | None:
        if box is None:
            return None
        (x, y, z), ((i0, j0, k0), (i1, j1, k1)) = self.origin, box
        return (i0 + x, j0 + y, k0 + z), (i1 + x, j1 + y, k1 + z)

    @staticmethod
    def _joined(parts: list[Contact]) -> Contact:
        last, dirty = parts[-1], None
        if len(parts) == 1:
            return last
        for part in parts:
            dirty = union(dirty, part.dirty)
        plastic = any(part.regime is Regime.PLASTIC for part in parts)
        return Contact(
            Regime.PLASTIC if plastic and last.regime is Regime.ELASTIC else last.regime,
            last.stress,
            last.yield_stress,
            last.force,
            sum(part.moved_mass for part in parts),
            sum(part.mass_out for part in parts),
            any(part.blocked for part in parts),
            sum(part.sweeps for part in parts),
            last.residual,
            dirty,
            last.tool_mass,
        )


def _is_length(value: object) -> bool:
    return isinstance(value, Real) and 0.0 <= float(value) < inf


def _checked(position: Iterable[float]) -> Vector:
    try:
        checked = vector(position)
    except (TypeError, ValueError):
        checked = (nan, nan, nan)
    if not all(isfinite(v) for v in checked):
        raise ValueError(f"a position is three finite numbers of voxels, not {position}")
    return checked


def _checked_strength(strength: float) -> float:
    if not (_is_length(strength) and strength <= 1.0):
        raise ValueError(f"a strength is a number from 0 to 1, not {strength!r}")
    return float(strength)


def _between(start: Vector, end: Vector, part: float) -> Vector:
    return vector(a + (b - a) * part for a, b in zip(start, end, strict=True))


def _scaled(end: Vector, start: Vector, factor: float) -> Vector:
    """factor x (end - start)"""
    return vector((b - a) * factor for a, b in zip(start, end, strict=True))


@dataclass
class _Moved:
    """What a relaxation did: masses in voxels' worth, the box in the frame of the poses."""

    mass: float = 0.0
    out: float = 0.0
    blocked: bool = False
    sweeps: int = 0
    dirty: Box | None = None
