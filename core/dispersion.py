# SPDX-License-Identifier: GPL-3.0-or-later
"""Where density goes: it leaves the innermost shells of the tool and is swept forward and to the sides (paper 7).

The paper moves one voxel at a time and recurses; through saturated material that takes 9^L calls for L planes. Here all
that leaves is carried together, plane by plane along the dominant axis of the push from the tool's rear, as a flux
that each plane spreads, and takes from what it has room for.
"""

from __future__ import annotations

from ctypes import byref, c_double, c_int64
from dataclasses import dataclass
from math import copysign, inf

import numpy as np

from .native.state import DONE, GROW, NEEDS_GROWTH, OPEN, ORDERS, Workspace
from .native.structures import Sweep
from .plasticity import box_around
from .tool import Shape, Vector, vector

DISPERSION = 0.3
"""D: variance across the push that one voxel of travel adds to the flux."""

SHELL = 0.5
"""Thickness in voxels of the shells that are emptied one after another."""

FAR = 1.5
"""Where the flux may begin to leap, in half lengths of the tool ahead of its centre: by then it is smooth."""

HOLE = 4
"""Voxels between the taps of the kernel that the flux leaps by."""

LEAP = HOLE**2
"""Planes in a leap: as many as that kernel is wider, squared, for spreading is diffusion."""

NEGLIGIBLE = np.float32(1e-4)
"""Flux below this at an edge of the window is folded inward, never dropped."""

LEAST_GIVEN = 1e-5
"""Density above its level below which a voxel gives nothing to a pull: it is rounding."""

LEAST_BEHIND = 1e-5
"""Share of the mass in the tool and its reach below which what is in the reach alone is rounding."""

_WEIGHT_UNIT = 2.0**-24


@dataclass(frozen=True)
class Spreading:
    """How a plane of flux reaches the next: a whole-voxel shift, then 3x3 weights that sum to exactly 1.

    ``shift`` is along (b, c), the two axes across the sweep in order; ``weights`` are nine float32 values, row by row
    along b. They are multiples of 2^-24, which add up exactly in float32: no sum of weights near 1 makes or loses mass.
    """

    shift: tuple[int, int]
    weights: tuple[float, ...]


def dominant_axis(direction: Vector) -> int:
    """The axis along which ``direction`` is largest: the one that is swept along."""
    lengths = [abs(d) for d in direction]
    return lengths.index(max(lengths))


def spreading(direction: Vector, axis: int, hole: int = 1) -> Spreading:
    """The spreading kernel for unit direction u: mean s = (u_b, u_c)/|u_a|, covariance (D/|u_a|)(I + s s^T).

    With a ``hole`` of h voxels from tap to tap it is that of h^2 planes at once: both are h^2 times as large, so that
    but for the mean its weights are the same.
    """
    per_plane, planes = 1.0 / abs(direction[axis]), hole * hole
    shear = [direction[across] * per_plane for across in ORDERS[axis][1:]]
    shift = [int(planes * s + copysign(0.5, s)) for s in shear]  # symmetric at ties, as round-half-even is not
    (b_low, b_here, b_high), (c_low, c_here, c_high) = (
        _three_weights((planes * s - m) / hole, DISPERSION * per_plane * (1.0 + s * s))
        for s, m in zip(shear, shift, strict=True)
    )
    # The covariance of b and c goes on the corners, as far as none of them becomes negative.
    corner = DISPERSION * per_plane * shear[0] * shear[1] / 4.0
    most = min(b_low * c_high, b_high * c_low) if corner > 0.0 else min(b_low * c_low, b_high * c_high)
    corner = copysign(min(abs(corner), most), corner)
    around = [
        *(b_low * c_low + corner, b_low * c_here, b_low * c_high - corner, b_here * c_low),
        *(b_here * c_high, b_high * c_low - corner, b_high * c_here, b_high * c_high + corner),
    ]
    around = [max(round(w / _WEIGHT_UNIT), 0) * _WEIGHT_UNIT for w in around]
    return Spreading((shift[0], shift[1]), (*around[:4], 1.0 - sum(around), *around[4:]))


def _three_weights(rest: float, variance: float) -> tuple[float, float, float]:
    """Weights of -1, 0, +1 with mean ``rest`` and the given variance, clamped so that none is negative."""
    variance = max(abs(rest) - rest * rest, min(variance, 0.9, 1.0 - rest * rest))
    square = variance + rest * rest
    return (square - rest) / 2.0, 1.0 - square, (square + rest) / 2.0


def empty(work: Workspace, axis: int, wanted: float, packed: bool) -> None:
    """Take mass from the tool, innermost shells first, until M_t has fallen by ``wanted`` (paper 7, steps 2 and 4).

    A histogram of the tool's mass by depth tells the shell above which all is emptied, and which part of that shell.
    ``packed`` material first fills the part of its voxel that the tool leaves free (facts/rim.md, EMPTY).
    """
    work.lay_box(axis)
    if work.library:
        work.library.repousse_empty(
            byref(work.grid), byref(work.tool), c_double(wanted), c_int64(packed), byref(work.emptied)
        )
    else:
        _empty_numpy(work, wanted, packed)


def density_behind(work: Workspace, direction: Vector) -> float:
    """The density that the mass behind the tool has along unit vector ``direction``; 0 where there is none.

    It is sum of w d^2 over sum of w d in the reach, with the weights (1 - p.u / front)^16: air does not count, and what
    is beside or ahead of the tool counts where nothing is behind it. So neither what has been pulled out already nor
    what it has left behind in a drag changes what a pull goes by.
    """
    front = _front(work.surroundings, direction) + 0.5
    sums = (c_double * 4)()
    if work.library:
        along = (c_double * 3)(*direction)
        work.library.repousse_behind(
            byref(work.grid), byref(work.tool), along, c_double(front), work.sweep.row, byref(sums)
        )
    else:
        sums = (c_double * 4)(*_behind_numpy(work, direction, front))
    both, both_squared, tool, tool_squared = sums
    if both - tool <= LEAST_BEHIND * both:
        return 0.0
    return min((both_squared - tool_squared) / (both - tool), 1.0)


def loosen(work: Workspace, axis: int, dense: float, strength: float) -> None:
    """Take from each voxel of the tool what it has above its level, ``dense`` (1 - w ``strength``).

    So it is emptied from the fullest down and nothing is hollowed out: the mirror image of compaction. The level
    follows the coverage w, so a tool that passes a voxel of its skin twice finds nothing more to take.
    """
    work.lay_box(axis)
    if work.library:
        work.library.repousse_loosen(
            byref(work.grid), byref(work.tool), c_double(dense), c_double(strength), byref(work.emptied)
        )
    else:
        _loosen_numpy(work, dense, strength)


def put_back(work: Workspace, amount: float) -> None:
    """Return ``amount`` to the voxels that were emptied last, outermost shells first, alike within a shell."""
    if work.library:
        work.library.repousse_put_back(byref(work.grid), byref(work.tool), c_double(amount), byref(work.emptied))
    else:
        _put_back_numpy(work, amount)


def forget_emptied(work: Workspace) -> None:
    """Clear the record of what was emptied."""
    if work.library:
        work.library.repousse_clear(byref(work.emptied))
    else:
        work.emptied_box[:] = 0.0


def aim(work: Workspace, direction: Vector, axis: int, border: int, band: float | None, leap: bool = False) -> None:
    """Make ready for sweeps along unit vector ``direction``; ``band`` is in voxels ahead of the tool. Where flux may
    ``leap``, it goes through full material far from the tool by :data:`LEAP` planes at once."""
    sweep, kernel = work.sweep, spreading(direction, axis)
    sweep.direction[:] = direction
    sweep.weights[:] = kernel.weights
    sweep.shift[:] = kernel.shift
    sweep.border = border
    sweep.limit = inf if band is None else band + _front(work.volume, direction)
    sweep.hole = HOLE if leap else 0
    if leap:
        kernel = spreading(direction, axis, HOLE)
        sweep.leap_weights[:] = kernel.weights
        sweep.leap_shift[:] = kernel.shift
    sweep.far = FAR * work.volume.extent[axis]


def sweep_emptied(work: Workspace) -> None:
    """Begin a sweep of what `empty` took last; `sweep` carries it on."""
    sweep, emptied = work.sweep, work.emptied
    sweep.window[:] = (0, 0, 0, 0)
    sweep.spread_done = 0
    sweep.plane = emptied.first[0] if sweep.direction[ORDERS[emptied.axis][0]] > 0 else emptied.last[0] - 1
    sweep.laid = sweep.reach_gain = sweep.mass_out = sweep.surplus = 0.0


def sweep(work: Workspace) -> int:
    """Carry the emptied mass on. Returns DONE, or NEEDS_GROWTH: then grow the grid as ``work.sweep.needs`` says, and
    call again."""
    state, emptied = work.sweep, work.emptied
    if work.library:
        status = int(work.library.repousse_sweep(byref(work.grid), byref(work.tool), byref(emptied), byref(state)))
    else:
        status = _sweep_numpy(work)
    if status == DONE:
        emptied.carry += emptied.mass - state.laid - state.mass_out - state.surplus
    return status


def _front(shape: Shape, direction: Vector) -> float:
    """How far a shape reaches along a direction from its centre (its support function), in voxels."""
    box = sum(h * abs(u) for h, u in zip(shape.half_size, direction, strict=True))
    return box + abs(sum(a * u for a, u in zip(shape.half_axis, direction, strict=True))) + shape.radius


def _cut(mass: np.ndarray, wanted: float) -> tuple[int, float]:
    """The shell of which a part is taken, all deeper ones being emptied, and that part."""
    taken = 0.0
    for shell in range(len(mass) - 1, -1, -1):
        if mass[shell] <= 0.0:
            continue
        if taken + mass[shell] >= wanted:
            return shell, (wanted - taken) / mass[shell]
        taken += mass[shell]
    return 0, 1.0


def _shells(work: Workspace, distance: np.ndarray) -> tuple[np.ndarray, int]:
    """The shell of each voxel, counted inward from the tool's skin, and how many there are."""
    count = int((min(work.volume.extent) + 0.5) / SHELL) + 2
    return np.clip(np.floor((0.5 - distance) / SHELL), 0, count - 1).astype(np.int64), count


def _empty_numpy(work: Workspace, wanted: float, packed: bool) -> None:
    box, offsets = box_around(work.volume, work.tool.centre[:], work.density.shape)
    density = work.density[box].astype(np.float64)
    distance = work.volume.distance(*offsets)
    covered = np.clip(0.5 - distance, 0.0, 1.0)
    available = np.maximum(density - (1.0 - covered), 0.0) if packed else covered * density
    shell, count = _shells(work, distance)
    last, part = _cut(np.bincount(shell.ravel(), (covered * available).ravel(), count), wanted)
    taken = (np.where(shell > last, 1.0, np.where(shell == last, part, 0.0)) * available).astype(np.float32)
    _take_numpy(work, taken)


def _behind_numpy(work: Workspace, direction: Vector, front: float) -> list[float]:
    sums = []
    for shape in (work.surroundings, work.volume):
        box, offsets = box_around(shape, work.tool.centre[:], work.density.shape)
        behind = (1.0 - sum(u * offset for u, offset in zip(direction, offsets, strict=True)) / front) ** 16
        weighed = shape.coverage(*offsets) * behind * work.density[box]
        sums += [float(weighed.sum()), float((weighed * work.density[box]).sum())]
    return sums


def _loosen_numpy(work: Workspace, dense: float, strength: float) -> None:
    box, offsets = box_around(work.volume, work.tool.centre[:], work.density.shape)
    covered = work.volume.coverage(*offsets)
    above = work.density[box].astype(np.float64) - dense * (1.0 - covered * strength)
    _take_numpy(work, np.where((covered > 0.0) & (above > LEAST_GIVEN), above, 0.0).astype(np.float32))


def _take_numpy(work: Workspace, taken: np.ndarray) -> None:
    """Take mass from the voxels around the tool (those of `box_around`) into the record."""
    emptied, order = work.emptied, ORDERS[work.emptied.axis]
    box, offsets = box_around(work.volume, work.tool.centre[:], work.density.shape)
    density, covered = work.density[box].astype(np.float64), work.volume.coverage(*offsets)
    emptied.tool_loss = float((covered * taken).sum())
    emptied.reach_loss = float(((work.surroundings.coverage(*offsets) - covered) * taken).sum())
    touched = np.nonzero(taken)
    if not len(touched[0]):
        emptied.first[:], emptied.last[:] = (0, 0, 0), (0, 0, 0)
        emptied.mass = 0.0
        return
    low = [int(index.min()) + s.start for index, s in zip(touched, box, strict=True)]
    high = [int(index.max()) + s.start + 1 for index, s in zip(touched, box, strict=True)]
    work.keep(low, high)
    work.density[box] = remaining = (density - taken).astype(np.float32)
    carry = emptied.carry + float((density - remaining - taken).sum())
    largest = np.unravel_index(taken.argmax(), taken.shape)
    former = float(taken[largest])
    taken[largest] = max(former + carry, 0.0)
    emptied.carry = carry - (float(taken[largest]) - former)
    emptied.mass = float(taken.sum(dtype=np.float64))
    inside = tuple(slice(box[a].start - emptied.low[s], box[a].stop - emptied.low[s]) for s, a in enumerate(order))
    work.emptied_box[inside] = np.transpose(taken, order)
    emptied.first[:], emptied.last[:] = [low[a] for a in order], [high[a] for a in order]


def _put_back_numpy(work: Workspace, amount: float) -> None:
    emptied, order = work.emptied, ORDERS[work.emptied.axis]
    first, last = emptied.first[:], emptied.last[:]
    taken = work.emptied_part
    density = np.transpose(work.density, order)[tuple(slice(f, t) for f, t in zip(first, last, strict=True))]
    offsets = np.ix_(*(np.arange(f, t) - work.tool.centre[a] for f, t, a in zip(first, last, order, strict=True)))
    distance = _permuted(work.volume, order).distance(*offsets)
    covered = np.clip(0.5 - distance, 0.0, 1.0)
    shell, count = _shells(work, distance)
    shell = count - 1 - shell  # outermost first
    # The rim may have used some of the room that the tool left in a voxel of its skin.
    fits = np.where(taken > 0.0, np.minimum(taken.astype(np.float64), 1.0 - density), 0.0)
    last_shell, part = _cut(np.bincount(shell.ravel(), fits.ravel(), count), amount)
    back = np.where(shell > last_shell, 1.0, np.where(shell == last_shell, part, 0.0)) * fits
    former = density.sum(dtype=np.float64)
    density[:] = (density + back).astype(np.float32)
    emptied.carry += amount - float(density.sum(dtype=np.float64) - former)
    emptied.tool_loss -= float((covered * back).sum())
    around = _permuted(work.surroundings, order).coverage(*offsets)
    emptied.reach_loss -= float(((around - covered) * back).sum())


def _permuted(shape: Shape, order: tuple[int, int, int]) -> Shape:
    """The shape with its axes in the order (a, b, c)."""
    half_size, half_axis = (vector(side[a] for a in order) for side in (shape.half_size, shape.half_axis))
    return Shape(half_size, half_axis, shape.radius)


def _sweep_numpy(work: Workspace) -> int:
    state, emptied, order = work.sweep, work.emptied, ORDERS[work.emptied.axis]
    planes = np.transpose(work.density, order)
    step = -1 if state.direction[order[0]] < 0 else 1
    last_source = emptied.last[0] - 1 if step > 0 else emptied.first[0]
    while True:
        if not state.spread_done:
            none_under_way = state.window[0] >= state.window[1]
            if none_under_way and (last_source - state.plane) * step < 0:
                return DONE
            if not 0 <= state.plane < planes.shape[0]:
                left = 0.0 if none_under_way else float(work.flux.sum(dtype=np.float64))
                if state.border == GROW and left > NEGLIGIBLE and _ask_growth(work, order, planes, step):
                    return NEEDS_GROWTH
                if state.border == OPEN:
                    state.mass_out += left
                else:
                    state.surplus += left
                return DONE
            has_sources = emptied.first[0] <= state.plane < emptied.last[0]
            if none_under_way and not has_sources:
                state.plane += step
                continue
            if (last_source - state.plane) * step < 0 and _may_leap(work, order, planes, step):
                _leap(work, step)
                state.plane += step
                continue
            _spread(work, has_sources)
            _trim(work)
            state.spread_done = 1
        if state.border == GROW and _ask_growth(work, order, planes, 0):
            return NEEDS_GROWTH
        _apply_border(work, planes.shape[1:])
        state.spread_done = 0
        state.planes += 1
        if work.flux.size:
            state.visited += work.flux.size
            state.read += work.flux.size
            _stop_at_band(work, order)
            _fill_plane(work, order, planes[state.plane])
        if not work.flux.any():
            state.window[1] = state.window[0]
        state.plane += step


def _leap_window(state: Sweep) -> list[int]:
    """Where a leap may carry the flux."""
    w, shift, hole = state.window, state.leap_shift, state.hole
    return [
        *(w[0] + min(0, shift[0] - hole), w[1] + max(0, shift[0] + hole)),
        *(w[2] + min(0, shift[1] - hole), w[3] + max(0, shift[1] + hole)),
    ]


def _may_leap(work: Workspace, order: tuple[int, int, int], planes: np.ndarray, step: int) -> bool:
    """Whether the flux may leap from the plane before this one: far from the tool, through full material inside the
    grid. A band may lie on the way: nothing is laid there, and all that is over it is surplus in the next plane."""
    state = work.sweep
    end = state.plane + step * (state.hole**2 - 1)
    if not state.hole or step * (state.plane - work.tool.centre[order[0]]) < state.far:
        return False
    b0, b1, c0, c1 = _leap_window(state)
    inside = min(end, b0, c0) >= 0 and end < planes.shape[0] and b1 <= planes.shape[1] and c1 <= planes.shape[2]
    if not inside:
        return False
    return bool((planes[min(state.plane, end) : max(state.plane, end) + 1, b0:b1, c0:c1] == np.float32(1.0)).all())


def _leap(work: Workspace, step: int) -> None:
    """The flux on the plane to which it leaps."""
    state, hole = work.sweep, work.sweep.hole
    rows, columns = work.flux.shape
    weights = np.array(state.leap_weights[:], np.float32).reshape(3, 3)
    grown = np.zeros((rows + 2 * hole, columns + 2 * hole), np.float32)
    for i in range(3):
        for j in range(3):
            if weights[i, j]:
                grown[i * hole : i * hole + rows, j * hole : j * hole + columns] += weights[i, j] * work.flux
    work.flux = grown
    for side, shift in enumerate(state.leap_shift):
        state.window[2 * side] += shift - hole
        state.window[2 * side + 1] += shift + hole
    _trim(work)
    state.plane += step * (hole**2 - 1)
    state.planes += 1
    state.visited += work.flux.size


def _spread(work: Workspace, has_sources: bool) -> None:
    state, emptied = work.sweep, work.emptied
    b0, b1, c0, c1 = state.window
    weights = np.array(state.weights[:], np.float32).reshape(3, 3)
    under_way = b0 < b1
    at_b, at_c = b0 + state.shift[0] - 1, c0 + state.shift[1] - 1
    reached = [(at_b, at_b + b1 - b0 + 2, at_c, at_c + c1 - c0 + 2)] if under_way else []
    if has_sources:
        reached.append((emptied.first[1], emptied.last[1], emptied.first[2], emptied.last[2]))
    b_low, c_low = min(r[0] for r in reached), min(r[2] for r in reached)
    b_high, c_high = max(r[1] for r in reached), max(r[3] for r in reached)
    grown = np.zeros((b_high - b_low, c_high - c_low), np.float32)
    if under_way:
        at_b, at_c = at_b - b_low, at_c - c_low
        for i in range(3):
            for j in range(3):
                if weights[i, j]:
                    grown[at_b + i : at_b + i + b1 - b0, at_c + j : at_c + j + c1 - c0] += weights[i, j] * work.flux
    if has_sources:
        source = work.emptied_part[state.plane - emptied.first[0]]
        grown[
            emptied.first[1] - b_low : emptied.last[1] - b_low, emptied.first[2] - c_low : emptied.last[2] - c_low
        ] += source
    work.flux = grown
    state.window[:] = (b_low, b_high, c_low, c_high)


def _trim(work: Workspace) -> None:
    """Fold faint edges inward; all four are judged before any is moved, so that mirrors stay mirrors."""
    while True:
        flux = work.flux
        faint = [not (edge >= NEGLIGIBLE).any() for edge in (flux[0], flux[-1], flux[:, 0], flux[:, -1])]
        fold_b, fold_c = (flux.shape[i] > faint[2 * i] + faint[2 * i + 1] for i in range(2))
        if not (fold_b and any(faint[:2])) and not (fold_c and any(faint[2:])):
            return
        for side, (fold, at_low, at_high) in enumerate(((fold_b, *faint[:2]), (fold_c, *faint[2:]))):
            if fold and at_low:
                _fold(work, side, at_high=False)
            if fold and at_high:
                _fold(work, side, at_high=True)


def _fold(work: Workspace, side: int, at_high: bool) -> None:
    """Add an edge row (side 0) or column (side 1) of the flux to its neighbour, and shrink the window."""
    flux = work.flux if side == 0 else work.flux.T
    flux[-2 if at_high else 1] += flux[-1 if at_high else 0]
    _drop_edge(work, side, at_high)


def _drop_edge(work: Workspace, side: int, at_high: bool) -> None:
    keep = slice(None, -1) if at_high else slice(1, None)
    work.flux = work.flux[keep] if side == 0 else work.flux[:, keep]
    work.sweep.window[2 * side + at_high] += -1 if at_high else 1


def _apply_border(work: Workspace, limits: tuple[int, int]) -> None:
    """Bring the window back into the plane: flux leaves and is counted, or a wall turns it back."""
    window = work.sweep.window
    for side in range(2):
        while work.flux.size and window[2 * side] < 0:
            _bring_back(work, side, at_high=False)
        while work.flux.size and window[2 * side + 1] > limits[side]:
            _bring_back(work, side, at_high=True)


def _bring_back(work: Workspace, side: int, at_high: bool) -> None:
    state = work.sweep
    if state.border == OPEN:
        edge = (work.flux if side == 0 else work.flux.T)[-1 if at_high else 0]
        state.mass_out += float(edge.sum(dtype=np.float64))
        _drop_edge(work, side, at_high)
    elif work.flux.shape[side] == 1:  # no neighbour to fold onto: the window is moved as a whole
        for end in range(2):
            state.window[2 * side + end] += -1 if at_high else 1
    else:
        _fold(work, side, at_high)


def _ask_growth(work: Workspace, order: tuple[int, int, int], planes: np.ndarray, step: int) -> bool:
    b0, b1, c0, c1 = work.sweep.window
    asked = (step < 0, step > 0, b0 < 0, b1 > planes.shape[1], c0 < 0, c1 > planes.shape[2])
    for slot, axis in enumerate(order):
        for end in range(2):
            work.sweep.needs[2 * axis + end] = asked[2 * slot + end]
    return any(asked)


def _stop_at_band(work: Workspace, order: tuple[int, int, int]) -> None:
    """What has gone farther along u than the band lets it is surplus."""
    state = work.sweep
    if state.limit == inf:
        return
    ua, ub, uc = (state.direction[a] for a in order)
    centre = [work.tool.centre[a] for a in order]
    b0, b1, c0, c1 = state.window
    along = ua * (state.plane - centre[0]) + ub * (np.arange(b0, b1) - centre[1])
    beyond = along[:, None] + uc * (np.arange(c0, c1) - centre[2])[None, :] > state.limit
    state.surplus += float(work.flux[beyond].sum(dtype=np.float64))
    work.flux[beyond] = 0.0


def _fill_plane(work: Workspace, order: tuple[int, int, int], plane: np.ndarray) -> None:
    """Fill what room this plane has outside the tool: deposit = min(flux, 1 - d)."""
    state = work.sweep
    b0, b1, c0, c1 = state.window
    density = plane[b0:b1, c0:c1]
    at = (
        np.full((1, 1), state.plane - work.tool.centre[order[0]]),
        (np.arange(b0, b1) - work.tool.centre[order[1]])[:, None],
        (np.arange(c0, c1) - work.tool.centre[order[2]])[None, :],
    )
    laid = np.minimum(work.flux, np.float32(1.0) - density)
    if abs(at[0][0, 0]) < work.volume.extent[order[0]] + 0.5:
        laid[_permuted(work.volume, order).distance(*at) < 0.5] = 0.0
    rows, columns = np.nonzero(laid.any(axis=1))[0], np.nonzero(laid.any(axis=0))[0]
    if not len(rows):
        return
    box = (
        (state.plane, b0 + int(rows[0]), c0 + int(columns[0])),
        (state.plane, b0 + int(rows[-1]), c0 + int(columns[-1])),
    )
    low, high = ([end[order.index(a)] for a in range(3)] for end in box)
    work.keep(low, [h + 1 for h in high])
    for a in range(3):
        state.dirty[a] = min(state.dirty[a], low[a])
        state.dirty[3 + a] = max(state.dirty[3 + a], high[a] + 1)
    former = density.sum(dtype=np.float64)
    density += laid
    state.laid += float(density.sum(dtype=np.float64) - former)
    work.flux -= laid
    if abs(at[0][0, 0]) < work.surroundings.extent[order[0]] + 0.5:
        state.reach_gain += float((_permuted(work.surroundings, order).coverage(*at) * laid).sum())
