# SPDX-License-Identifier: GPL-3.0-or-later
"""The rim on trial: the compiled push into a half space, against finite elements of the same press.

`python -m tests.bench.truths.trial` writes out/chart/rim_trial.csv and rim_trial.png.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from repousse.core import DensityGrid, Material, Push, SphereTool

from .case import DEPTHS

YIELDS_AT_ONCE = 1e-6
"""A yield ratio with which the tool is emptied wholly, as a rigid sphere is."""
HALF_WIDTH, BELOW, ABOVE = 3.0, 2.5, 0.75
"""Extent of the block in radii, beside the sphere, under the surface and over it."""


@dataclass(frozen=True)
class Raised:
    """The surface at each depth, lengths in radii: its height ``z`` (m, k) at radii ``r`` (k,), and its ``rim`` (m,), the
    greatest height over the depth, at ``radius`` (m,)."""

    r: np.ndarray
    z: np.ndarray
    rim: np.ndarray
    radius: np.ndarray


def press(radius: float, density: float, band: float, hats: float, step: float = 0.25) -> Raised:
    """Press a sphere of ``radius`` voxels into a block; ``band`` and depths are in radii, ``step`` in voxels."""
    half, first = int(HALF_WIDTH * radius), int(ABOVE * radius)
    block = np.zeros((2 * half, 2 * half, first + int(BELOW * radius)), np.float32)
    block[:, :, first:] = density
    grid = DensityGrid(block, copy=False)
    push = Push(grid, SphereTool(radius), Material(3.3, YIELDS_AT_ONCE), border="wall", band=band * radius, rim=hats)
    middle, surface = half - 0.5, first - 0.5
    seen, depth = [], -step
    for wanted in DEPTHS:
        while depth < wanted * radius - 1e-9:
            depth = min(depth + step, wanted * radius)
            push.move_to((middle, middle, surface - radius + depth))
        seen.append(profile(grid.density, first) / radius)
    z = np.array(seen)
    r = (np.arange(z.shape[1]) + 0.5) / radius
    peaks = [peak(r, line) for line in z]
    return Raised(r, z, *(np.array(column) for column in zip(*((h / d, at) for (h, at), d in zip(peaks, DEPTHS)))))


def profile(density: np.ndarray, first: int) -> np.ndarray:
    """Mean height in voxels over rings of one voxel about the middle of what filled planes ``first`` and on, (k,).

    The surface lies where density passes half of what it is inside.
    """
    half = density.shape[0] // 2
    top = (density >= 0.5).argmax(axis=2)
    i, j = np.indices(top.shape)
    inside, outside = density[i, j, top].astype(float), density[i, j, np.maximum(top - 1, 0)].astype(float)
    height = (first - 0.5) - (top - (inside - 0.5) / np.maximum(inside - outside, 1e-6))
    ring = np.hypot(i - half + 0.5, j - half + 0.5).astype(int).ravel()
    return (np.bincount(ring, height.ravel()) / np.bincount(ring))[:half]


def peak(r: np.ndarray, z: np.ndarray) -> tuple[float, float]:
    """Height and place of the highest point, by the parabola through it and its neighbours."""
    k = int(np.argmax(z[1:-1])) + 1
    bend = z[k - 1] - 2.0 * z[k] + z[k + 1]
    shift = 0.5 * (z[k - 1] - z[k + 1]) / bend if bend < 0.0 else 0.0
    return float(z[k] - 0.25 * (z[k - 1] - z[k + 1]) * shift), float(r[k] + shift * (r[1] - r[0]))
