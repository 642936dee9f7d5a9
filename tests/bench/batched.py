# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's recursion with its overflow batched: the yardstick between the literal recursion and the sweep.

The weights are the recursion's own, of up to 26 neighbours. All of the tool that has to be emptied is emptied at once,
and overflow goes on in generations: what arrives in a voxel from all its neighbours is added up before any of it is
passed on. Where overflow goes does not depend on the order in which it topples, so this differs from the recursion
only within the tool, where that fills voxels it has emptied before.
"""

import numpy as np

from repousse.core.plasticity import RELAXED
from repousse.core.recursion import forward_neighbours


def disperse_batched(density, emptied, direction, smallest=1e-5, generations=10_000):
    """Empty a part of ``density`` (nx, ny, nz) float64 in place, and carry it along unit vector ``direction`` (3,).

    ``emptied`` (nx, ny, nz) is the share of each voxel that is emptied: of what it holds, and of what it catches before
    its turn comes. Overflow under ``smallest`` voxels' worth stays behind. Returns (mass that left the array, mass that
    stayed behind).

    Raises
    ------
    RuntimeError
        When overflow is still under way after ``generations``.
    """
    offsets, weights = forward_neighbours(np.asarray(direction, float))
    room, flux = 1.0 - density, emptied * density
    density -= flux
    out = aside = 0.0
    for _ in range(generations):
        where = np.argwhere(flux > 0.0)
        if not len(where):
            return out, aside
        low, high = np.maximum(where.min(axis=0) - 1, 0), np.minimum(where.max(axis=0) + 2, flux.shape)
        box = tuple(slice(a, b) for a, b in zip(low, high))
        spread = np.zeros(high - low + 2)
        for offset, weight in zip(offsets, weights):
            spread[tuple(slice(1 + o, n - 1 + o) for o, n in zip(offset, spread.shape))] += weight * flux[box]
        arrived = spread[1:-1, 1:-1, 1:-1]
        out += float(spread.sum() - arrived.sum())  # flux reaches the frame at the array's border alone
        caught = np.minimum(arrived, room[box])
        kept = caught * (1.0 - emptied[box])
        room[box] -= caught
        density[box] += kept
        over = arrived - kept
        aside += float(over[over <= smallest].sum())
        flux[box] = np.where(over > smallest, over, 0.0)
    raise RuntimeError(f"overflow is still under way after {generations} generations")


def push_batched(density, tool, kappa, direction, path):
    """Walk a path of poses through ``density`` float64 in place: at each, empty until sigma = sigma_f, and disperse.

    The innermost voxels go first, as many as take the tool's mass down to kappa times that of its reach, however often
    what they lose comes back into the reach. Returns the mass that left the array.
    """
    axes, gone = np.ogrid[tuple(slice(0, n) for n in density.shape)], 0.0
    for position in path:
        offsets = [axis - x for axis, x in zip(axes, position)]
        covered = tool.volume.coverage(*offsets)
        around = tool.surroundings.coverage(*offsets) - covered
        distance = tool.volume.distance(*offsets)
        for _ in range(20):
            tool_mass, reach_mass = float((covered * density).sum()), float((around * density).sum())
            if tool_mass <= kappa * reach_mass * (1.0 + RELAXED):
                break
            inside = np.flatnonzero((covered > 0.0) & (density > 0.0))
            inside = inside[np.argsort(distance.ravel()[inside], kind="stable")]
            lost = (covered**2 * density).ravel()[inside].cumsum()
            wanted = (tool_mass - kappa * reach_mass) / (1.0 + kappa)
            chosen = inside[: int(np.searchsorted(lost, wanted)) + 1]
            emptied = np.zeros_like(density)
            emptied.ravel()[chosen] = covered.ravel()[chosen]
            gone += disperse_batched(density, emptied, direction)[0]
    return gone
