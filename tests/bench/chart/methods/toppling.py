# SPDX-License-Identifier: GPL-3.0-or-later
"""The limit of "what exceeds its room goes in equal shares to the six neighbours", found without toppling for ages.

Toppling is abelian: whatever the order, it ends in the same field (arXiv 1903.06263). With u the mass that a voxel
hands to each neighbour in all, and L the Laplacian of the voxels that are open, that field is d - L u for the least
u >= 0 with d - L u <= capacity: an obstacle problem, solved here by over-relaxed projected Gauss-Seidel in two colours.
In a packed block literal toppling needs some N^2 sweeps for N voxels of depth, this some N: the time is kinder to the
rivals than theirs was. No flow crosses the array's border or enters a closed voxel.
"""

from __future__ import annotations

from math import pi, sin

import numpy as np
from numba import njit

from tests.bench.chart.method import Scene, Vector
from tests.bench.chart.methods.ousting import Advance, tool_in

RESIDUAL = 1e-3
"""Toppling stops when what is too much or too little, summed over all voxels, is this share of what was ousted."""
MOST_SWEEPS = 4000
SWEEPS_A_CHECK = 20


@njit(cache=True)
def _sweep(excess, handed, degree, relaxation):
    """One projected Gauss-Seidel sweep, red voxels then black: u = max(0, u + relaxation * over / degree).

    All arrays have a frame of one closed voxel; ``degree`` is the number of open neighbours, 0 where a voxel is closed.
    """
    for colour in range(2):
        for i in range(1, excess.shape[0] - 1):
            for j in range(1, excess.shape[1] - 1):
                for k in range(1 + (i + j + colour) % 2, excess.shape[2] - 1, 2):
                    edges = degree[i, j, k]
                    if edges == 0.0:
                        continue
                    given = handed[i - 1, j, k] + handed[i + 1, j, k] + handed[i, j - 1, k] + handed[i, j + 1, k]
                    given += handed[i, j, k - 1] + handed[i, j, k + 1]
                    own = handed[i, j, k]
                    over = excess[i, j, k] + given - edges * own
                    if own > 0.0 or over > 0.0:
                        handed[i, j, k] = max(0.0, own + relaxation * over / edges)


def _after(excess: np.ndarray, handed: np.ndarray, degree: np.ndarray) -> np.ndarray:
    """How far each voxel is over its capacity once all has been handed on: excess - L u."""
    over = excess - degree * handed
    for axis in range(3):
        for step in (-1, 1):
            over += np.roll(handed, step, axis)  # the frame is closed, so nothing comes round
    return np.where(degree > 0.0, over, excess)


def topple(density: np.ndarray, capacity: np.ndarray, is_open: np.ndarray, handed: np.ndarray, wrong: float) -> int:
    """Topple ``density`` (nx, ny, nz) float64 in place until it breaks the rule by no more than ``wrong`` in all.

    ``handed`` (nx + 2, ny + 2, nz + 2) is the first guess of u, with its frame, and becomes u. Returns the number of
    sweeps. What is left over ``capacity`` is the caller's to treat.

    Raises
    ------
    RuntimeError
        Where ``MOST_SWEEPS`` do not suffice: there is less room than mass.
    """
    open_ = np.pad(is_open, 1)
    degree = sum(np.roll(open_, step, axis).astype(float) for axis in range(3) for step in (-1, 1)) * open_
    excess = np.pad(density - capacity, 1)
    handed[degree == 0.0] = 0.0
    relaxation = 2.0 / (1.0 + sin(pi / (2.0 * max(density.shape))))  # of walls and one free side: twice the depth
    for sweeps in range(0, MOST_SWEEPS, SWEEPS_A_CHECK):
        over = _after(excess, handed, degree)
        if np.where(handed > 0.0, np.abs(over), np.maximum(over, 0.0)).sum() <= wrong:
            np.add(capacity, over[1:-1, 1:-1, 1:-1], out=density)
            return sweeps
        for _ in range(SWEEPS_A_CHECK):
            _sweep(excess, handed, degree, relaxation)
    raise RuntimeError(f"toppling breaks its rule by more than {wrong:g} voxels' worth after {MOST_SWEEPS} sweeps")


class Toppled:
    """A tool that leaves each voxel the room 1 - w, and material that topples until it fits.

    ``obstacle``: the tool's wholly covered voxels take nothing; those that it has just covered still give. ``oust``
    (density, position, radius) may move what is in the tool before that. ``carry`` is what the residual left over or
    under the density shown, of either sign: density + carry keeps the mass to rounding.
    """

    def __init__(self, scene: Scene, obstacle: bool, oust=None) -> None:
        self.density = scene.density.copy()
        self.carry = np.zeros(self.density.shape)
        self.sweeps = 0
        self._radius, self._obstacle, self._oust = scene.radius, obstacle, oust
        self._handed = np.zeros([n + 2 for n in self.density.shape])
        self._advance = Advance(scene)
        _sweep(*np.zeros((3, 3, 3, 3)), 1.0)  # compiled now, not in the first step

    def move_to(self, position: Vector) -> float:
        box, covered = tool_in(self.density.shape, position, self._radius)
        capacity = np.ones(self.density.shape)
        capacity[box] = 1.0 - covered
        exact = self.density + self.carry
        ousted = float(np.maximum(self.density[box] - capacity[box], 0.0).sum())
        if ousted > 0.0:
            is_open = np.ones(exact.shape, np.bool_)
            if self._obstacle:
                is_open[box] = (covered < 1.0) | (self.density[box] > 0.0)
            if self._oust is not None:
                self._oust(exact, capacity, position, self._radius)
            self.sweeps = topple(exact, capacity, is_open, self._handed, RESIDUAL * ousted)
            self.density = np.clip(exact, 0.0, capacity).astype(np.float32)
            self.carry = exact - self.density
        return self._advance.to(position, ousted)
