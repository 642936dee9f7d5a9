# SPDX-License-Identifier: GPL-3.0-or-later
"""From a file's values to density: a window makes them 0 to 1, and unequal voxels become cubes."""

from __future__ import annotations

import numpy as np

from ..grid import CUBIC_TOLERANCE, DensityGrid
from .base import MAX_VOXELS, EmptyVolumeError, FormatError, Volume

Window = tuple[float, float]

SAME_LENGTH = 2e-7
"""Lengths that differ by less than this share differ by float32 rounding alone, as in transforms of real files."""


def to_grid(volume: Volume, window: Window | None) -> DensityGrid:
    """Make a DensityGrid of a file's values (which it uses up) and tell in its notes what was done to them.

    ``window`` = (lo, hi): lo becomes density 0 and hi density 1, what lies beyond is clipped; lo > hi inverts. None
    takes the window of `default_window`. Raises FormatError for a window without width, or a transform that shears;
    EmptyVolumeError when no voxel has any density.
    """
    low, high, broken = _range(volume.values)
    notes = list(volume.notes)
    if broken is not None:
        notes.append(f"{int(broken.sum())} of the values are no finite number and are taken as empty")
    lo, hi = window or default_window(volume, low, high)
    if not (np.isfinite([lo, hi]).all() and lo != hi):
        raise FormatError(f"{volume.path}: a window needs two different finite ends, not {lo:g}:{hi:g}")
    notes.append(_told(volume, low, high, (lo, hi), window is not None))
    as_they_are = (lo, hi) == (0.0, 1.0) and low >= 0.0 and high <= 1.0
    density = volume.values.astype(np.float32, copy=False) if as_they_are else _windowed(volume.values, lo, hi)
    if broken is not None:
        density[broken] = 0.0
    if not (high > 0.0 if as_they_are else density.any()):
        raise EmptyVolumeError(
            f"{volume.path}: grid {volume.info.key!r} holds nothing: its values go from {low:g} to {high:g}, "
            f"and none is above the empty end of the window {lo:g}:{hi:g}"
        )
    density, transform, resampled = cubed(density, volume.transform, str(volume.path))
    if resampled:
        notes.append(resampled)
    if not as_they_are or broken is not None or resampled:
        volume.own = None  # it does not hold these densities
    metadata = volume.info.metadata | {"source": volume.path.name, "window": f"{lo:.9g}:{hi:.9g}"}
    return DensityGrid(density, transform, volume.info.name, metadata, notes, copy=False)


def default_window(volume: Volume, low: float, high: float) -> Window:
    """The window for values from ``low`` to ``high`` when none is given.

    The format's own, where it has one (8 bits: 0 to 255; a level set: half a voxel to both sides of its surface).
    Values within [0, 1] are density already. All others go from the file's background, which is what the file says
    empty space is (0 in nearly all; a scan in Hounsfield units may say -1000), to the greatest value.
    """
    if volume.window is not None:
        return volume.window
    if low >= 0.0 and high <= 1.0:
        return 0.0, 1.0
    if not high > volume.background:
        raise EmptyVolumeError(
            f"{volume.path}: the values of grid {volume.info.key!r} go from {low:g} to {high:g}, and none is above "
            f"its background {volume.background:g}: give a window"
        )
    return volume.background, high


def cubed(density: np.ndarray, transform: np.ndarray, path: str) -> tuple[np.ndarray, np.ndarray, str | None]:
    """Resample unequal voxels to cubes of their smallest edge, and keep the mass.

    ``density`` is float32 (nx, ny, nz). Each axis by itself: a new voxel, never longer than an old one, lies in at most
    two of them and takes from each its share by overlap. So the integral over the world is kept, values stay within
    their range, and only the far end of an axis may gain a partly filled voxel. Returns the density, its transform,
    and a sentence about what was done, or None when the voxels were cubes. Raises FormatError for a shear, for
    voxels without volume, and where the cubes would be more than MAX_VOXELS.
    """
    axes = transform[:3, :3]
    edges = np.linalg.norm(axes, axis=0)
    if not (np.isfinite(transform).all() and edges.min() > 0.0):
        raise FormatError(f"{path}: its transform gives voxels without volume")
    if np.abs((axes / edges).T @ (axes / edges) - np.eye(3)).max() > CUBIC_TOLERANCE:
        raise FormatError(f"{path}: its transform shears the voxels: resample it to a plain one first")
    smallest = edges.min()
    if edges.max() <= smallest * (1.0 + CUBIC_TOLERANCE):
        return density, transform, None
    before = density.shape
    ratios = [float(edge / smallest) for edge in edges]
    after = [_cubes(count, ratio) for count, ratio in zip(before, ratios, strict=True)]
    if np.prod(after, dtype=float) > MAX_VOXELS:
        raise FormatError(f"{path}: as cubes its voxels would be {_by(after)}, more than {MAX_VOXELS} in all")
    for axis, (count, ratio) in enumerate(zip(after, ratios, strict=True)):
        if ratio > 1.0:
            density = _finer(density, axis, count, ratio)
    shrink = np.diag([1.0 / ratio for ratio in ratios] + [1.0])
    shrink[:3, 3] = [0.5 / ratio - 0.5 for ratio in ratios]  # the outer faces of the first voxels stay where they are
    note = (
        f"voxels of {edges[0]:g} x {edges[1]:g} x {edges[2]:g} were resampled to cubes of {smallest:g}, mass kept: "
        f"{_by(before)} became {_by(after)}"
    )
    return density, transform @ shrink, note


def _cubes(count: int, ratio: float) -> int:
    """How many new voxels cover ``count`` old ones that are ``ratio`` times as long."""
    length = count * ratio
    return round(length) if abs(length - round(length)) <= SAME_LENGTH * length else int(np.ceil(length))


def _finer(density: np.ndarray, axis: int, count: int, ratio: float) -> np.ndarray:
    """``count`` new voxels along an axis whose old ones are ``ratio`` > 1 times as long."""
    faces = np.arange(count + 1) / ratio
    if abs(faces[-1] - density.shape[axis]) <= SAME_LENGTH * density.shape[axis]:
        faces[-1] = density.shape[axis]
    first = np.minimum(faces[:-1].astype(int), density.shape[axis] - 1)
    inside = np.minimum(faces[1:], first + 1.0) - faces[:-1]  # of the old voxel that the new one begins in
    second = first + 1
    beyond = np.where(second < density.shape[axis], faces[1:] - faces[:-1] - inside, 0.0)
    along = [1, 1, 1]
    along[axis] = count
    shares = (inside * ratio).astype(np.float32).reshape(along), (beyond * ratio).astype(np.float32).reshape(along)
    finer: np.ndarray = density.take(first, axis)
    finer *= shares[0]
    rest = density.take(second, axis, mode="clip")
    rest *= shares[1]
    finer += rest
    np.minimum(finer, 1.0, out=finer)
    return finer


def _range(values: np.ndarray) -> tuple[float, float, np.ndarray | None]:
    """Lowest and highest finite value, and where the values are not finite (None: nowhere)."""
    low, high = float(values.min()), float(values.max())
    if np.isfinite([low, high]).all():
        return low, high, None
    broken = ~np.isfinite(values)
    if broken.all():
        return 0.0, 0.0, broken
    finite = values[~broken]
    return float(finite.min()), float(finite.max()), broken


def _windowed(values: np.ndarray, lo: float, hi: float) -> np.ndarray:
    """float32 clamp((values - lo) / (hi - lo), 0, 1), in place for floats; the window 0:1 leaves each bit as it is."""
    wide = values.dtype.itemsize > 4 or values.dtype == np.int32  # float32 does not hold these
    density = values.astype(np.float64 if wide else np.float32, copy=False)
    if (lo, hi) != (0.0, 1.0):
        np.subtract(density, lo, out=density)
        np.divide(density, hi - lo, out=density)
    np.clip(density, 0.0, 1.0, out=density)
    return density.astype(np.float32, copy=False)


def _told(volume: Volume, low: float, high: float, window: Window, asked: bool) -> str:
    """The sentence about the window for the grid's notes."""
    lo, hi = window
    if (lo, hi) == (0.0, 1.0) and low >= 0.0 and high <= 1.0:
        return f"values {low:g} to {high:g} are taken as density as they are"
    if volume.info.kind == "level set" and not asked:
        return f"signed distance became density across the surface, from {lo:g} (empty) to {hi:g} (full)"
    outside = np.count_nonzero(volume.values < min(window)) + np.count_nonzero(volume.values > max(window))
    return (
        f"values {low:g} to {high:g} became density by the window {lo:g}:{hi:g} ({'as asked' if asked else 'default'}: "
        f"{lo:g} is empty, {hi:g} is full)"
        + (f"; {outside / volume.values.size:.2%} of the voxels lie outside it and were clipped" if outside else "")
    )


def _by(shape: tuple[int, ...] | list[int]) -> str:
    return " x ".join(map(str, shape))
