# SPDX-License-Identifier: GPL-3.0-or-later
"""Every error of the chart, defined once. Shares are of 1, lengths in voxels; 0 is perfect in all of them.

A density is float (nx, ny, nz) in [0, 1]; ``before`` is the scene's, ``truth`` what should have come of it, ``found``
what a method made of it. All sums are taken in float64.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def net_moved(before: np.ndarray, after: np.ndarray) -> float:
    """Mass that is elsewhere than before, voxels' worth: half the sum of all changes."""
    return float(np.abs(after.astype(np.float64) - before).sum()) / 2.0


def mass(before: np.ndarray, found: np.ndarray) -> float:
    """Mass made or lost, as a share of the mass before: ``|sum(found) - sum(before)| / sum(before)``."""
    whole = before.sum(dtype=np.float64)
    return float(abs(found.sum(dtype=np.float64) - whole) / whole)


def density_l1(before: np.ndarray, truth: np.ndarray, found: np.ndarray) -> float:
    """Mass that is in the wrong place, as a share of what the truth moved: ``sum|found - truth| / 2 / net_moved``.

    1 where nothing was moved at all, up to 2 where as much was moved to other places.
    """
    return net_moved(truth, found) / net_moved(before, truth)


def density_w1(before: np.ndarray, truth: np.ndarray, found: np.ndarray, axis: int, face: int) -> float:
    """How far along ``axis`` mass lies from where it should, in voxels for each voxel's worth that the truth moved.

    For each column along the axis the earth mover's distance, the integral of the difference of the two cumulative
    sums. They are summed from both ends towards plane ``face``, where the material was pressed: what one column has and
    another lacks counts as if it had gone in or out there, and what was thrown away too.
    """
    wrong = np.moveaxis(found.astype(np.float64) - truth, axis, -1)
    below = np.cumsum(wrong[..., :face], axis=-1)
    above = np.cumsum(wrong[..., face:][..., ::-1], axis=-1)
    return float(np.abs(below).sum() + np.abs(above).sum()) / net_moved(before, truth)


def force(truth: np.ndarray, found: np.ndarray) -> float:
    """Root mean square difference of two curves of force over the same depths (n,), as a share of the truth's peak.

    Each method has a unit of its own, so ``found`` is first multiplied by the one factor that fits it best (least
    squares, not below 0). A curve that is no number, has no force in it or pulls is wrong by all of the truth.
    """
    square = float(found @ found)
    factor = max(float(found @ truth) / square, 0.0) if np.isfinite(square) and square > 0.0 else 0.0
    fitted = factor * found if factor else np.zeros_like(truth)
    return float(np.sqrt(np.mean((fitted - truth) ** 2)) / np.abs(truth).max())


def yield_depth(depth: np.ndarray, force: np.ndarray) -> float:
    """The depth in voxels at which a curve of force bends: where the two lines cross that fit it best, one to either
    side. nan where it nowhere bends down."""
    best, bend = np.inf, np.nan
    for split in range(3, len(depth) - 3):
        (a, b), first, *_ = np.polyfit(depth[:split], force[:split], 1, full=True)
        (c, d), second, *_ = np.polyfit(depth[split:], force[split:], 1, full=True)
        misfit = float(first.sum() + second.sum())
        if misfit < best:
            best, bend = misfit, (d - b) / (a - c) if a > c else np.nan
    return bend


def surface(density: np.ndarray, axis: int, sign: int) -> np.ndarray:
    """Height in voxels of the surface d = 1/2 along ``axis``, seen from its end (``sign`` 1) or its beginning (-1).

    Linear between voxel centres; in the frame of the indices, and turned round where ``sign`` is -1, so that a larger
    height is always nearer to the eye. A column that is nowhere half full is as low as the grid.
    """
    columns = np.moveaxis(density, axis, -1).astype(np.float64)
    if sign > 0:
        columns = columns[..., ::-1]
    n = columns.shape[-1]
    full = columns >= 0.5
    first = np.where(full.any(axis=-1), full.argmax(axis=-1), n)
    at = np.minimum(first, n - 1)[..., None]
    inside = np.take_along_axis(columns, at, -1)[..., 0]
    outside = np.where(first > 0, np.take_along_axis(columns, np.maximum(at - 1, 0), -1)[..., 0], 0.0)
    part = np.clip((inside - 0.5) / np.maximum(inside - outside, 1e-9), 0.0, 1.0)
    height = first - np.where(first < n, part, 0.0)  # voxels below the eye's end
    return (n - 1) - height if sign > 0 else -height


def occupancy(truth: np.ndarray, found: np.ndarray) -> float:
    """Volume between two free surfaces, given as heights over the first one (nx, ny) in voxels, as a share of twice
    the truth's pit. For a truth that does not change its density, whose distant part gives way elastically."""
    pit = float(np.maximum(-truth, 0.0).sum())
    return float(np.abs(found - truth).sum()) / 2.0 / pit


def pile_up(truth: float, found: float) -> float:
    """Difference of two rims, each the largest height over the first surface as a share of the depth."""
    return abs(found - truth)


def direction(straight: np.ndarray, oblique: Sequence[np.ndarray]) -> float:
    """How far pit and front of a push depend on its direction: the largest distance of a profile (bins along the push,
    bins of radius; mass that each ring gained) from that of the push along an axis, L1 over the latter's own."""
    return max(float(np.abs(profile - straight).sum() / np.abs(straight).sum()) for profile in oblique)


def symmetry(before: np.ndarray, found: np.ndarray, axis: int) -> float:
    """How far a press along ``axis`` through the middle of a square block is from fourfold symmetry: the largest
    distance from itself turned by 90, 180 or 270 degrees or mirrored, L1 over net moved mass; 0 where none moved."""
    across = [a for a in range(3) if a != axis]
    turned = [np.rot90(found, k, across) for k in (1, 2, 3)] + [np.flip(found, a) for a in across]
    moved = net_moved(before, found)
    return max(net_moved(found, image) for image in turned) / moved if moved else 0.0
