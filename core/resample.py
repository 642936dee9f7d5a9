# SPDX-License-Identifier: GPL-3.0-or-later
"""Resample: the same volume on finer or coarser voxels, its mass kept."""

from __future__ import annotations

from math import ceil, isfinite

import numpy as np

from .formats.base import MAX_VOXELS
from .grid import DensityGrid

SAME_SIZE = 1e-6
"""Share by which voxel sizes may differ and be the same: more than the rounding of a file's float32."""


def resampled_shape(grid: DensityGrid, voxel_size: float) -> tuple[int, int, int]:
    """Voxels along each axis when ``grid`` is resampled to ``voxel_size`` (world units), four bytes each in memory.

    Raises
    ------
    ValueError
        When the size is not a positive number.
    """
    if not (isfinite(voxel_size) and voxel_size > 0.0):
        raise ValueError(f"a voxel size is a positive length, not {voxel_size:g}")
    ratio = grid.voxel_size / voxel_size
    nx, ny, nz = (_count(n, ratio) for n in grid.shape)
    return nx, ny, nz


def resample(grid: DensityGrid, voxel_size: float) -> DensityGrid:
    """A new grid with voxels of ``voxel_size`` (world units) that holds what ``grid`` does.

    The integral of density over the world is kept, to rounding; densities stay in [0, 1]; the outer faces of the first
    voxels stay where they are, those of the last unless the size does not divide the side: then there is one partly
    filled voxel more. Coarser voxels hold the mean of what they cover. For finer ones the old voxels are laid over one
    another as smooth bells, so that they are not seen any more; what would lie outside is folded back in. The same size
    gives the same densities, bit for bit.

    Raises
    ------
    ValueError
        When the size is not a positive number, or asks for more than ``MAX_VOXELS`` voxels.
    """
    shape = resampled_shape(grid, voxel_size)
    ratio = grid.voxel_size / voxel_size
    if abs(ratio - 1.0) <= SAME_SIZE:
        return DensityGrid(grid.density, grid.transform, grid.name, dict(grid.metadata), list(grid.notes))
    if np.prod(shape, dtype=float) > MAX_VOXELS:
        by = " x ".join(f"{n:.3g}" if n > 10**6 else str(n) for n in shape)
        raise ValueError(f"voxels of {voxel_size:g} would be {by}, more than {MAX_VOXELS} in all: take larger ones")
    shares = [_shares(n, count, ratio) for n, count in zip(grid.shape, shape, strict=True)]
    density = np.empty(shape, np.float32)
    for i, (first, weights) in enumerate(zip(*shares[0], strict=True)):
        plane = sum(w * grid.density[first + k] for k, w in enumerate(weights) if w)
        density[i] = _along(_along(plane, 0, *shares[1]), 1, *shares[2])
    np.clip(density, 0.0, 1.0, out=density)
    shrink = np.diag([1.0 / ratio] * 3 + [1.0])
    shrink[:3, 3] = 0.5 / ratio - 0.5
    note = f"resampled from voxels of {grid.voxel_size:g} to {voxel_size:g}, mass kept"
    return DensityGrid(
        density, grid.transform @ shrink, grid.name, dict(grid.metadata), [*grid.notes, note], copy=False
    )


def _count(n: int, ratio: float) -> int:
    """How many new voxels cover ``n`` old ones that are ``ratio`` times as long."""
    length = n * ratio
    return max(1, round(length) if abs(length - round(length)) <= SAME_SIZE * length else ceil(length))


def _shares(n: int, count: int, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """What ``count`` new voxels take from ``n`` old ones that are ``ratio`` times as long.

    New voxel i is the sum of ``weights[i, k]`` x old voxel ``first[i] + k``: (first (count,), weights (count, width)).
    """
    ends = np.arange(count + 1) / ratio  # of the new voxels, old ones being [j, j + 1]
    ends[-1] = n  # beyond it there is nothing
    below = _bell_below if ratio > 1.0 else _box_below
    share = np.diff(below(ends[:, None] - (np.arange(-1, n + 1) + 0.5)), axis=0) * ratio
    share[:, 1] += share[:, 0]  # the mirror images of the outermost voxels bring back what leaves through the faces
    share[:, -2] += share[:, -1]
    share = share[:, 1:-1]
    width = int(np.count_nonzero(share, axis=1).max())
    first = np.minimum((share > 0.0).argmax(axis=1), n - width)
    return first, np.take_along_axis(share, first[:, None] + np.arange(width), axis=1).astype(np.float32)


def _box_below(x: np.ndarray) -> np.ndarray:
    """The part below ``x`` of a box of width 1 around 0."""
    return np.clip(x + 0.5, 0.0, 1.0)


def _bell_below(x: np.ndarray) -> np.ndarray:
    """The part below ``x`` of the quadratic B-spline, a box of width 1 smoothed by itself twice."""
    parts = [c * np.clip(x + 1.5 - k, 0.0, 3.0 - k) ** 3 for k, c in enumerate((1.0, -3.0, 3.0, -1.0))]
    return np.sum(parts, axis=0) / 6.0


def _along(plane: np.ndarray, axis: int, first: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """A plane with new voxels along one of its axes."""
    if axis == 0:
        weights = weights[:, :, None]
    return sum(weights[:, k] * plane.take(first + k, axis) for k in range(weights.shape[1]))
