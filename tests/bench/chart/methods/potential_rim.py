# SPDX-License-Identifier: GPL-3.0-or-later
"""The sweep to the band, and a rim that potential (Darcy) flow raises, on a lattice twice as coarse.

Rule: what the tool ousts is swept forward, and fills room up to the band; what is then left over is a source of flow in
the tool's emptied voxels, through material, around the tool, to the free surface at potential 0. It is laid there in
proportion to the flow that arrives: on each voxel with room, the potential of its full neighbours (facts/rim.md).
Gets wrong: one solve of a Poisson equation a step, so it is slow; the rim is flat and wide, for the flow knows no yield
and reaches all of the surface; the coarse lattice blurs the tool by a voxel, and is symmetric only about the middle of
an even number of voxels; material appears at the surface at once, and what lies between does not move. Mass is kept to
rounding: what finds no room goes back where it came from.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from repousse.core.dispersion import dominant_axis, spreading
from tests.bench.chart.method import Method, Scene, Vector
from tests.bench.chart.methods.ousting import Advance, tool_in

ROOM = 1e-3
"""Room below which a voxel counts as full."""
BLOCKED, CONDUCTS = 0.25, 0.5
"""Of a coarse voxel: capacity below which it is the tool's; density over capacity from which flow goes through it."""
RESIDUAL = 1e-4
PASSES = 8
_SIDES = [(axis, step) for axis in range(3) for step in (-1, 1)]


def shifted(values: np.ndarray, axis: int, step: int) -> np.ndarray:
    """The neighbours' ``values``: result[i] = values[i - step], 0 (False) beyond the border."""
    result = np.zeros_like(values)
    to, from_ = [slice(None)] * values.ndim, [slice(None)] * values.ndim
    to[axis], from_[axis] = (slice(1, None), slice(None, -1)) if step > 0 else (slice(None, -1), slice(1, None))
    result[tuple(to)] = values[tuple(from_)]
    return result


def coarse_sum(values: np.ndarray) -> np.ndarray:
    """Sums over blocks of 2x2x2; the far border is padded with 0."""
    even = np.pad(values, [(0, n % 2) for n in values.shape])
    a, b, c = (n // 2 for n in even.shape)
    return even.reshape(a, 2, b, 2, c, 2).sum(axis=(1, 3, 5))


def sweep_to_band(
    density: np.ndarray, capacity: np.ndarray, ousted: np.ndarray, direction: Vector, centre: Vector, reach: float
) -> float:
    """Carry ``ousted`` forward plane by plane, in place, into what ``capacity`` leaves; return what is left over.

    The spreading is the product's own (`repousse.core.dispersion`); ``reach`` is the band's distance from ``centre``.
    """
    axis = dominant_axis(direction)
    forward = direction[axis] > 0.0
    kernel = spreading(direction, axis)
    planes = [np.moveaxis(field, axis, 0) for field in (density, capacity, ousted)]
    count = len(planes[0])
    across = np.delete(np.arange(3), axis)
    grids = np.meshgrid(*(np.arange(density.shape[a]) - centre[a] for a in across), indexing="ij")
    beside = sum(direction[a] * g for a, g in zip(across, grids))
    flux, surplus = np.zeros(planes[0].shape[1:]), 0.0
    margin = 1 + max(abs(s) for s in kernel.shift)
    for plane in range(count) if forward else range(count - 1, -1, -1):
        if not flux.any() and not planes[2][plane].any():
            continue
        spread = np.zeros([n + 2 * margin for n in flux.shape])
        for index, weight in enumerate(kernel.weights):
            b, c = (margin + s + o for s, o in zip(kernel.shift, (index // 3 - 1, index % 3 - 1)))
            spread[b : b + flux.shape[0], c : c + flux.shape[1]] += weight * flux
        arrived = spread[margin:-margin, margin:-margin]
        surplus += spread.sum() - arrived.sum()
        flux = arrived + planes[2][plane]
        beyond = direction[axis] * (plane - centre[axis]) + beside > reach
        surplus += flux[beyond].sum()
        flux[beyond] = 0.0
        kept = np.minimum(flux, np.maximum(planes[1][plane] - planes[0][plane], 0.0))
        kept[planes[1][plane] < 1.0] = 0.0  # the tool's own voxels take nothing
        planes[0][plane] += kept
        flux -= kept
    return max(float(surplus + flux.sum()), 0.0)


def potential(density: np.ndarray, capacity: np.ndarray, source: np.ndarray, guess: np.ndarray | None) -> np.ndarray:
    """The potential of the flow from ``source`` through material to the air around it; all four of coarse voxels."""
    conducts = ((density >= CONDUCTS * capacity) & (capacity >= BLOCKED)) | (source > 0.0)
    is_open = conducts | (capacity >= BLOCKED)
    number = np.full(density.shape, -1)
    number[conducts] = np.arange(conducts.sum())
    rows, columns, degree = [], [], np.zeros(density.shape)
    for axis, step in _SIDES:
        degree += shifted(is_open, axis, step)
        beside = np.where(shifted(conducts, axis, step), shifted(number, axis, step), -1)
        joined = conducts & (beside >= 0)
        rows.append(number[joined])
        columns.append(beside[joined])
    row, column = np.concatenate(rows), np.concatenate(columns)
    links = sparse.coo_matrix((np.ones(len(row)), (row, column)), shape=(conducts.sum(),) * 2).tocsr()
    diagonal = degree[conducts] + 1e-9
    matrix = sparse.diags(diagonal) - links
    start = None if guess is None else guess[conducts]
    solved, _ = linalg.cg(matrix, source[conducts], x0=start, rtol=RESIDUAL, M=sparse.diags(1.0 / diagonal))
    result = np.zeros(density.shape)
    result[conducts] = np.maximum(solved, 0.0)
    return result


class PotentialRim:
    """The tool is emptied down to the room that it leaves, 1 - w. ``returned``: what the last step had to put back."""

    def __init__(self, scene: Scene) -> None:
        self.density = scene.density.astype(np.float64)
        self.returned = 0.0
        self._scene, self._advance = scene, Advance(scene)
        self._potential: np.ndarray | None = None

    def move_to(self, position: Vector) -> float:
        scene, d = self._scene, self.density
        box, covered = tool_in(d.shape, position, scene.radius)
        capacity = np.ones(d.shape)
        capacity[box] = 1.0 - covered
        ousted = np.maximum(d - capacity, 0.0)
        mass = float(ousted.sum())
        if mass > 0.0:
            np.minimum(d, capacity, out=d)
            reach = np.inf if scene.band is None else scene.radius + scene.band
            left = sweep_to_band(d, capacity, ousted, scene.direction, position, reach)
            if left > 0.0:
                left = self._rise(capacity, ousted / mass, left)
            self.returned = left
            d += ousted * (left / mass)
        return self._advance.to(position, mass)

    def _rise(self, capacity: np.ndarray, source: np.ndarray, left: float) -> float:
        """Lay ``left`` on the free surface as the flow from ``source`` arrives there; return what found no room."""
        d = self.density
        room = coarse_sum(capacity) / 8.0
        self._potential = potential(coarse_sum(d) / 8.0, room, coarse_sum(source), self._potential)
        fine = self._potential
        for axis in range(3):
            fine = np.repeat(fine, 2, axis)
        fine = fine[tuple(slice(n) for n in d.shape)]
        for _ in range(PASSES):
            full = (capacity >= 0.5) & (capacity - d <= ROOM)
            arrives = sum(shifted(np.where(full, fine, 0.0), axis, step) for axis, step in _SIDES)
            arrives[capacity - d <= ROOM] = 0.0
            total = float(arrives.sum())
            if total <= 0.0:
                break
            laid = np.minimum(left / total * arrives, capacity - d)
            d += laid
            left = max(left - float(laid.sum()), 0.0)
            if left <= 1e-9:
                break
        return left


METHODS = [Method("sweep + potential rim", "2x coarser flow", PotentialRim)]
