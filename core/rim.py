# SPDX-License-Identifier: GPL-3.0-or-later
"""The rim: what the band turns back rises to the free surface around the contact (facts/rim.md).

The paper assumes a reflecting plane across the push (3.3), and the finite elements that it cites turn the flow sideways
and back up. This is our surrogate for that flow, calibrated on von Mises finite elements: the surplus is laid on the
surface around the emptied points, by weight support x (a hat of radius ``rim`` x contact radius).

A surface that rises voxel by voxel shows each of them as a terrace: where one voxel in a column is partly full, the
d = 1/2 surface leaves the column's height by up to .09 voxel, and where full sides count too, steps outgrow what is
between them. So a voxel carries the next one as soon as it is half full, and the two share what comes: the profile
across a risen surface is a ramp of 1/2 a voxel, on which d = 1/2 lies exactly at the column's height.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import byref, c_double
from math import ceil, floor

import numpy as np

from .native.state import LIST_FULL, ORDERS, Workspace
from .native.structures import CLUSTERS, LATTICE, MAX_POINTS, SIGHT_CELL

PASSES = 6
"""Searches for free surface before the rest goes back into the tool's voxels."""
WIDENING_PASS, WIDENING = 2, 1.6
"""From this pass on (counted from 0) each search looks farther by this factor."""
WAKELESS_PASS = 4
"""From this pass on the tool's wake is no longer spared."""
ENOUGH = 1e-3
"""Share of what was emptied that may be left over without another search."""
PLACINGS = 3
"""Rounds in which the surplus is laid on the voxels of one search."""
SHORTEST_HAT = 3.0
"""Least radius of the hats, in voxels."""

CLUSTERS_IN_RADIUS = 2.5
NEARLY_FULL, LITTLE_ROOM = np.float32(1e-3), 0.02
RISING, RISEN = np.float32(0.4), np.float32(0.6)
NEAR = 2.6
NODES_IN_HAT, FAINT = 6.0, 0.01
PLACE_BITS = 19
SIGHT_INSET, SIGHT_STEP, SIGHT_SAMPLES, SIGHT_AIR = 1.51, 1.5, 16.0, 0.25
_NEIGHBOURS = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
_FIRST_CAPACITY = 1 << 15


def raise_rim(
    work: Workspace,
    direction: np.ndarray,
    surplus: float,
    rim: float,
    wake: float,
    make_room: Callable[[list[int], list[int]], None],
) -> float:
    """Lay ``surplus`` on the free surface around the contact; return what found no place.

    ``rim`` is the hats' radius in contact radii, ``wake`` the length in voxels that is kept clear behind the tool: a
    shaft that counts as the tool itself. Where the first search finds no surface the next one looks farther.
    ``make_room(low, high)`` is asked before each search to let the grid reach beyond that box where material does.
    """
    find_sources(work, direction)
    if not work.rim.capacity:
        work.reserve_rim(_FIRST_CAPACITY)
    length = max(SHORTEST_HAT, rim * work.sources.contact_radius)
    left = surplus
    for attempt in range(PASSES):
        if attempt >= WIDENING_PASS or (attempt and not work.rim.count):
            length *= WIDENING
        make_room(*_box_of_hats(work, length))
        gather(work, direction, length, wake if attempt < WAKELESS_PASS else 0.0)
        left = place(work, left)
        if left <= ENOUGH * work.emptied.mass:
            break
    return left


def _box_of_hats(work: Workspace, length: float) -> tuple[list[int], list[int]]:
    sources = work.sources
    points = [axis[: sources.count] for axis in (sources.x, sources.y, sources.z)]
    return [floor(min(p) - length) for p in points], [ceil(max(p) + length) + 1 for p in points]


def find_sources(work: Workspace, direction: np.ndarray) -> None:
    """Cluster what was emptied into points of mean position and mass, and measure the contact radius a across
    ``direction``: a = sqrt(2 x variance), that of the disc which spreads as far."""
    if work.library:
        along = (c_double * 3)(*direction)
        work.library.repousse_rim_sources(
            byref(work.grid), byref(work.tool), byref(work.emptied), along, byref(work.sources)
        )
    else:
        _find_sources_numpy(work, direction)


def gather(work: Workspace, direction: np.ndarray, length: float, wake: float) -> None:
    """List the voxels that can take material around the sources, with their weights."""
    work.rim.direction[:] = direction
    work.rim.wake = wake
    if not work.library:
        _gather_numpy(work, length)
        return
    while (
        work.library.repousse_rim_gather(
            byref(work.grid), byref(work.tool), byref(work.sources), c_double(length), byref(work.rim)
        )
        == LIST_FULL
    ):
        work.reserve_rim(2 * work.rim.capacity)


def place(work: Workspace, amount: float) -> float:
    """Lay ``amount`` on the listed voxels by weight; what one cannot hold goes once, in equal shares, to its neighbours
    with room outside the wake. Returns what is left."""
    if work.library:
        return float(
            work.library.repousse_rim_place(byref(work.grid), byref(work.tool), byref(work.rim), c_double(amount))
        )
    return _place_numpy(work, amount)


def _find_sources_numpy(work: Workspace, direction: np.ndarray) -> None:
    emptied, order, sources = work.emptied, ORDERS[work.emptied.axis], work.sources
    box = work.emptied_part.transpose(np.argsort(order))
    index = np.nonzero(box > 0.0)
    mass = box[index].astype(np.float64)
    start = [emptied.first[order.index(a)] for a in range(3)]
    at = np.stack([i + s - c for i, s, c in zip(index, start, work.tool.centre, strict=True)])
    # A tool that is not wholly emptied is smaller to the material than it is.
    centre = [work.tool.centre[a] for a in order]
    beyond = [max(c - low, high - 1 - c) for c, low, high in zip(centre, emptied.first, emptied.last, strict=True)]
    side = max(CLUSTERS_IN_RADIUS, *beyond) / CLUSTERS_IN_RADIUS
    steps = np.floor(np.abs(at) / side + 0.5).astype(np.int64)
    cluster = np.clip(CLUSTERS // 2 + np.where(at < 0.0, -steps, steps), 0, CLUSTERS - 1)
    bins = (cluster[0] * CLUSTERS + cluster[1]) * CLUSTERS + cluster[2]
    total = np.bincount(bins, mass, MAX_POINTS)
    used = np.nonzero(total > 0.0)[0]
    sources.count = len(used)
    sources.mass[: len(used)] = total[used].tolist()
    for axis, points in enumerate((sources.x, sources.y, sources.z)):
        mean = work.tool.centre[axis] + np.bincount(bins, mass * at[axis], MAX_POINTS)[used] / total[used]
        points[: len(used)] = mean.tolist()
    across = at - direction[:, None] * (direction @ at)
    mean = (across * mass).sum(axis=1) / mass.sum()
    variance = float((mass * (across**2).sum(axis=0)).sum() / mass.sum() - (mean**2).sum())
    sources.contact_radius = float(np.sqrt(max(2.0 * variance, 0.0)))


def _coverage(work: Workspace, index: np.ndarray) -> np.ndarray:
    return work.volume.coverage(*(index - np.reshape(work.tool.centre[:], (3, 1))))


def _density(work: Workspace, index: np.ndarray) -> np.ndarray:
    """Density at integer indices, shape (3, n); 0 outside the grid."""
    shape = np.reshape(work.density.shape, (3, 1))
    inside = ((index >= 0) & (index < shape)).all(axis=0)
    return np.where(inside, work.density[tuple(np.clip(index, 0, shape - 1))], np.float32(0.0))


def _gather_numpy(work: Workspace, length: float) -> None:
    sources, centre = work.sources, np.reshape(work.tool.centre[:], (3, 1))
    points = np.array([axis[: sources.count] for axis in (sources.x, sources.y, sources.z)])
    low = [max(0, ceil(p - length)) for p in points.min(axis=1)]
    high = [min(n, floor(p + length) + 1) for p, n in zip(points.max(axis=1), work.density.shape, strict=True)]
    if any(a >= b for a, b in zip(low, high, strict=True)):
        work.rim.count = 0
        return
    index = _surface(work, low, high)
    at = index - centre
    distance = work.volume.distance(*at)
    room = 1.0 - np.clip(0.5 - distance, 0.0, 1.0) - _density(work, index)
    carried = _support(work, index, distance < NEAR)
    kept = (room > NEARLY_FULL) & (carried > 0.0) & ~_in_wake(work, at)
    index, carried = index[:, kept], carried[kept]
    weight = _hats(work, points, length, index) * carried * np.minimum(room[kept] / LITTLE_ROOM, 1.0).astype(np.float32)
    index, weight = index[:, weight > 0.0], weight[weight > 0.0]
    mass = np.array(sources.mass[: sources.count])
    kept = _joined(work, (points * mass).sum(axis=1) / mass.sum(), index)
    index, weight = index[:, kept], weight[kept]
    if len(weight) > work.rim.capacity:
        work.reserve_rim(2 * len(weight))
    work.rim.count = len(weight)
    places, weights = work.rim_list
    places[: len(weight)] = (index[0] << PLACE_BITS | index[1]) << PLACE_BITS | index[2]
    weights[: len(weight)] = weight


def _surface(work: Workspace, low: list[int], high: list[int]) -> np.ndarray:
    """Indices, shape (3, n), of the voxels in a box that are not full and have a neighbour that may carry them."""
    framed = np.zeros([b - a + 2 for a, b in zip(low, high, strict=True)], np.float32)
    fetch = [slice(max(0, a - 1), min(n, b + 1)) for a, b, n in zip(low, high, work.density.shape, strict=True)]
    framed[tuple(slice(s.start - a + 1, s.stop - a + 1) for s, a in zip(fetch, low, strict=True))] = work.density[
        tuple(fetch)
    ]
    inner = (slice(1, -1),) * 3
    beside = np.zeros(framed[inner].shape, bool)
    for offset in _NEIGHBOURS:
        beside |= framed[tuple(slice(1 + o, n - 1 + o) for o, n in zip(offset, framed.shape, strict=True))] > RISING
    found = np.nonzero((framed[inner] < np.float32(1.0) - NEARLY_FULL) & beside)
    return np.stack(found) + np.reshape(low, (3, 1))


def _full(work: Workspace, index: np.ndarray, near: np.ndarray) -> np.ndarray:
    capacity = np.where(near, 1.0 - _coverage(work, index), 1.0)
    return (capacity >= 0.5) & (_density(work, index) >= capacity - np.float64(NEARLY_FULL))


def _risen(density: np.ndarray) -> np.ndarray:
    """How far material has come up in voxels that carry the next ones: 0 below RISING, 1 from RISEN on."""
    return np.clip((density - RISING) / (RISEN - RISING), np.float32(0.0), np.float32(1.0))


def _support(work: Workspace, index: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Share of what comes up at voxels that they take: on full material all, and half once they carry the next ones,
    which take the other half."""
    on_full, carried = np.zeros(index.shape[1], bool), np.zeros(index.shape[1], np.float32)
    for offset in _NEIGHBOURS:
        beside = index + np.reshape(offset, (3, 1))
        on_full |= _full(work, beside, near)
        carries = np.where(_full(work, beside + np.reshape(offset, (3, 1)), near), _risen(_density(work, beside)), 0.0)
        carried = np.maximum(carried, carries.astype(np.float32))
    half = np.float32(0.5)
    return np.where(on_full, np.float32(1.0) - half * _risen(_density(work, index)), half * carried)


def _swept_distance(work: Workspace, at: np.ndarray) -> np.ndarray:
    """Signed distance of points relative to the tool's centre, shape (3, n), to all it has gone through in its wake."""
    u = work.rim.direction
    behind = np.clip(-(at[0] * u[0] + at[1] * u[1] + at[2] * u[2]), 0.0, work.rim.wake)
    return work.volume.distance(*(at + behind * np.reshape(u, (3, 1))))


def _in_wake(work: Workspace, at: np.ndarray) -> np.ndarray:
    """Whether points relative to the tool's centre, shape (3, n), lie where it came from."""
    u = work.rim.direction
    ahead = at[0] * u[0] + at[1] * u[1] + at[2] * u[2] >= 0.0
    return (work.rim.wake > 0.0) & ~ahead & (_swept_distance(work, at) < 0.5)


def _hats(work: Workspace, points: np.ndarray, length: float, index: np.ndarray) -> np.ndarray:
    """W at voxels: the sum over the sources of e max(0, 1 - |x - x_s| / L), less FAINT of all that was emptied.

    It is summed on the nodes of a lattice around the tool's centre and interpolated between them: it bends little
    within a sixth of L, and what it costs no longer grows with the tool.
    """
    centre, sources = np.array(work.tool.centre[:]), work.sources
    low, high = points.min(axis=1), points.max(axis=1)
    mass = np.array(sources.mass[: sources.count])
    middle = (points * mass).sum(axis=1) / mass.sum()
    spacing = max(length / NODES_IN_HAT, float((high - low + 2.0 * length).max()) / (LATTICE - 3))
    first = np.floor((low - length - centre) / spacing)
    count = (np.ceil((high + length - centre) / spacing) - first).astype(int) + 1
    start = centre + first * spacing
    axes = [start[a] + np.arange(count[a]) * spacing for a in range(3)]
    x, y, z = np.ix_(*((axis - middle[a]).astype(np.float32) for a, axis in enumerate(axes)))
    value = np.zeros(count, np.float32)
    inverse = np.float32(1.0 / length)
    for point, e in zip((points - middle[:, None]).T.astype(np.float32), mass.astype(np.float32), strict=True):
        across2, dz = (x - point[0]) ** 2 + (y - point[1]) ** 2, z - point[2]
        value += e * np.maximum(np.float32(1.0) - np.sqrt(across2 + dz * dz) * inverse, np.float32(0.0))
    value = (value - np.float32(FAINT * mass.sum())).astype(np.float64)
    place = (index - start[:, None]) / spacing
    cell = np.clip(np.floor(place).astype(np.int64), 0, (count - 2)[:, None])
    part = place - cell
    along = [
        _between(part[2], *(value[cell[0] + a, cell[1] + b, cell[2] + c] for c in (0, 1)))
        for a in (0, 1)
        for b in (0, 1)
    ]
    across = [_between(part[1], *along[:2]), _between(part[1], *along[2:])]
    return _between(part[0], *across).astype(np.float32)


def _between(part: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first + part * (second - first)


def _joined(work: Workspace, to: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Whether material joins voxels of the surface to the sources' mean: the line from just inside it must not cross
    air. The tool and its wake count as material, which flows around them; all voxels of a cell share one line."""
    centre = np.reshape(work.tool.centre[:], (3, 1))
    at = index - centre
    cells = np.copysign(np.floor(np.abs(at) / SIGHT_CELL + 0.5), at)
    _, member, count = np.unique(cells + 0.0, axis=1, return_inverse=True, return_counts=True)
    member = member.ravel()
    inward = [
        _density(work, index + np.reshape(up, (3, 1))).astype(np.float64)
        - _density(work, index + np.reshape(down, (3, 1)))
        for up, down in zip(_NEIGHBOURS[::2], _NEIGHBOURS[1::2], strict=True)
    ]
    sums = [np.bincount(member, values, len(count)) for values in (*index, *inward)]
    norm = np.maximum(np.sqrt(sums[3] ** 2 + sums[4] ** 2 + sums[5] ** 2), 1e-6)
    start = np.stack(sums[:3]) / count + SIGHT_INSET * np.stack(sums[3:]) / norm
    way = to[:, None] - start
    length = np.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
    step = np.maximum(SIGHT_STEP, length / SIGHT_SAMPLES)
    samples, stride = (length / step).astype(np.int64), way * (step / length)
    joined = np.ones(len(count), bool)
    for q in range(int(samples.max(initial=0))):
        asked = np.nonzero(joined & (q < samples))[0]
        x = start[:, asked] + q * stride[:, asked]
        air = _density(work, np.floor(x + 0.5).astype(np.int64)) < SIGHT_AIR
        joined[asked[air & (_swept_distance(work, x - centre) > 1.0)]] = False
    return joined[member]


def _place_numpy(work: Workspace, amount: float) -> float:
    places, weights = (column[: work.rim.count] for column in work.rim_list)
    mask = (1 << PLACE_BITS) - 1
    index = np.stack([places >> 2 * PLACE_BITS, places >> PLACE_BITS & mask, places & mask])
    left = amount
    for round_ in range(PLACINGS):
        if left <= ENOUGH * amount:
            break
        weights[_room(work, index) <= NEARLY_FULL] = 0.0
        total = float(weights.sum(dtype=np.float64))
        if total <= 0.0:
            break
        share = left / total * weights.astype(np.float64)
        room = np.maximum(_room(work, index), 0.0)
        left -= _raise(work, index, np.minimum(share, room))
        if round_ == 0:
            spilling = share > room
            left -= _spill_over(
                work, index[:, spilling], (share - room)[spilling].astype(np.float32).astype(np.float64)
            )
    return left


def _spill_over(work: Workspace, index: np.ndarray, spilt: np.ndarray) -> float:
    """What voxels could not hold goes in equal shares to their neighbours with room. Returns what these gained."""
    beside = [index + np.reshape(offset, (3, 1)) for offset in _NEIGHBOURS]
    shape = np.reshape(work.density.shape, (3, 1))
    inside = [((b >= 0) & (b < shape)).all(axis=0) for b in beside]
    centre = np.reshape(work.tool.centre[:], (3, 1))
    open_ = [  # all, before any moves
        i & (_room(work, b) > NEARLY_FULL) & ~_in_wake(work, b - centre) for b, i in zip(beside, inside, strict=True)
    ]
    ways = sum(o.astype(np.int64) for o in open_)
    gained = 0.0
    for b, o in zip(beside, open_, strict=True):  # in one direction's turn each neighbour is asked by one voxel only
        gained += _raise(work, b[:, o], np.minimum(spilt[o] / ways[o], np.maximum(_room(work, b[:, o]), 0.0)))
    return gained


def _room(work: Workspace, index: np.ndarray) -> np.ndarray:
    return 1.0 - _coverage(work, index) - _density(work, index)


def _raise(work: Workspace, index: np.ndarray, laid: np.ndarray) -> float:
    """Raise voxels; returns what they gained, rounding included."""
    if not len(laid):
        return 0.0
    low, high = index.min(axis=1), index.max(axis=1) + 1
    work.keep(low.tolist(), high.tolist())
    for a in range(3):
        work.rim.dirty[a] = min(work.rim.dirty[a], int(low[a]))
        work.rim.dirty[3 + a] = max(work.rim.dirty[3 + a], int(high[a]))
    at = tuple(index)
    former = work.density[at].astype(np.float64)
    work.density[at] = raised = (former + laid).astype(np.float32)
    gained, inside = raised - former, _coverage(work, index)
    around = work.surroundings.coverage(*(index - np.reshape(work.tool.centre[:], (3, 1))))
    work.rim.tool_gain += float((inside * gained).sum())
    work.rim.reach_gain += float(((around - inside) * gained).sum())
    return float(gained.sum())
