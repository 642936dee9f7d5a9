# SPDX-License-Identifier: GPL-3.0-or-later
"""The rim: what the band turns back rises to the free surface around the contact (facts/rim.md).

The paper assumes a reflecting plane across the push (3.3), and the finite elements that it cites turn the flow sideways
and back up. This is our surrogate for that flow, calibrated on von Mises finite elements: the surplus is laid on the
surface around the emptied points, by weight (full neighbours) x (a hat of radius ``rim`` x contact radius).
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import byref, c_double
from math import ceil, floor

import numpy as np

from .native.state import LIST_FULL, ORDERS, Workspace
from .native.structures import CLUSTERS, MAX_POINTS
from .tool import Shape

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

    ``rim`` is the hats' radius in contact radii, ``wake`` the length in voxels that is kept clear behind the tool, and
    ``make_room(low, high)`` is asked before each search to let the grid reach beyond that box where material does.
    """
    find_sources(work, direction)
    if not work.rim.capacity:
        work.reserve_rim(_FIRST_CAPACITY)
    length = max(SHORTEST_HAT, rim * work.sources.contact_radius)
    left = surplus
    for attempt in range(PASSES):
        if attempt >= WIDENING_PASS:
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
        _gather_numpy(work, direction, length, wake)
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
    with room. Returns what is left."""
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
    side = max(work.volume.extent) / CLUSTERS_IN_RADIUS
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


def _gather_numpy(work: Workspace, direction: np.ndarray, length: float, wake: float) -> None:
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
    full = _full_neighbours(work, index, distance < 1.6)
    kept = (room > NEARLY_FULL) & (full > 0) & ~_in_wake(work.volume, direction, wake, at)
    index, full = index[:, kept], full[kept] * np.minimum(room[kept] / LITTLE_ROOM, 1.0).astype(np.float32)
    mass = np.array(sources.mass[: sources.count])
    middle = ((points * mass).sum(axis=1) / mass.sum())[:, None]
    weight = _hat_sum(points - middle, mass, length, index - middle)
    kept = weight > 0.0
    index, weight = index[:, kept], weight[kept] * full[kept]
    kept = _joined(work, middle[:, 0], index)
    index, weight = index[:, kept], weight[kept]
    if len(weight) > work.rim.capacity:
        work.reserve_rim(2 * len(weight))
    work.rim.count = len(weight)
    places, weights = work.rim_list
    places[: len(weight)] = np.ravel_multi_index(tuple(index), work.density.shape)
    weights[: len(weight)] = weight


def _surface(work: Workspace, low: list[int], high: list[int]) -> np.ndarray:
    """Indices, shape (3, n), of the voxels in a box that are not full and have a neighbour that may be."""
    framed = np.zeros([b - a + 2 for a, b in zip(low, high, strict=True)], np.float32)
    fetch = [slice(max(0, a - 1), min(n, b + 1)) for a, b, n in zip(low, high, work.density.shape, strict=True)]
    framed[tuple(slice(s.start - a + 1, s.stop - a + 1) for s, a in zip(fetch, low, strict=True))] = work.density[
        tuple(fetch)
    ]
    inner = (slice(1, -1),) * 3
    beside = np.zeros(framed[inner].shape, bool)
    for offset in _NEIGHBOURS:
        beside |= framed[
            tuple(slice(1 + o, n - 1 + o) for o, n in zip(offset, framed.shape, strict=True))
        ] >= np.float32(0.49)
    found = np.nonzero((framed[inner] < np.float32(1.0) - NEARLY_FULL) & beside)
    return np.stack(found) + np.reshape(low, (3, 1))


def _full_neighbours(work: Workspace, index: np.ndarray, near: np.ndarray) -> np.ndarray:
    full = np.zeros(index.shape[1], np.int64)
    for offset in _NEIGHBOURS:
        beside = index + np.reshape(offset, (3, 1))
        capacity = np.where(near, 1.0 - _coverage(work, beside), 1.0)
        full += (capacity >= 0.5) & (_density(work, beside) >= capacity - np.float64(NEARLY_FULL))
    return full


def _in_wake(volume: Shape, direction: np.ndarray, wake: float, at: np.ndarray) -> np.ndarray:
    """Whether points relative to the tool's centre, shape (3, n), lie where it came from."""
    behind = np.minimum(-(at[0] * direction[0] + at[1] * direction[1] + at[2] * direction[2]), wake)
    return (behind > 0.0) & (volume.distance(*(at + behind * direction[:, None])) < 0.5)


def _hat_sum(points: np.ndarray, mass: np.ndarray, length: float, at: np.ndarray) -> np.ndarray:
    inverse = np.float32(1.0 / length)
    total = np.zeros(at.shape[1], np.float32)
    at = at.astype(np.float32)
    for point, e in zip(points.T.astype(np.float32), mass.astype(np.float32), strict=True):
        dx, dy, dz = (at[a] - point[a] for a in range(3))
        total += e * np.maximum(np.float32(1.0) - np.sqrt(dx * dx + dy * dy + dz * dz) * inverse, np.float32(0.0))
    return total


def _joined(work: Workspace, to: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Whether material joins each voxel of the surface to the sources' mean: the line from just inside it must not
    cross air."""
    inward = np.stack(
        [
            _density(work, index + np.reshape(up, (3, 1))).astype(np.float64)
            - _density(work, index + np.reshape(down, (3, 1)))
            for up, down in zip(_NEIGHBOURS[::2], _NEIGHBOURS[1::2], strict=True)
        ]
    )
    norm = np.maximum(np.sqrt(inward[0] ** 2 + inward[1] ** 2 + inward[2] ** 2), 1e-6)
    start = index + SIGHT_INSET * inward / norm
    way = to[:, None] - start
    length = np.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
    step = np.maximum(SIGHT_STEP, length / SIGHT_SAMPLES)
    samples, stride = (length / step).astype(np.int64), way * (step / length)
    joined = np.ones(index.shape[1], bool)
    centre = np.reshape(work.tool.centre[:], (3, 1))
    for q in range(int(samples.max(initial=0))):
        asked = np.nonzero(joined & (q < samples))[0]
        x = start[:, asked] + q * stride[:, asked]
        air = _density(work, np.floor(x + 0.5).astype(np.int64)) < SIGHT_AIR
        joined[asked[air & (work.volume.distance(*(x - centre)) > 1.0)]] = False
    return joined


def _place_numpy(work: Workspace, amount: float) -> float:
    places, weights = (column[: work.rim.count] for column in work.rim_list)
    index = np.stack(np.unravel_index(places, work.density.shape))
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
    open_ = [i & (_room(work, b) > NEARLY_FULL) for b, i in zip(beside, inside, strict=True)]  # all, before any moves
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
