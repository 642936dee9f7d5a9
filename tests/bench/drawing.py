# SPDX-License-Identifier: GPL-3.0-or-later
"""What the figures share: a camera that looks at a block of voxels, two ways to shade it, and a way to save.

A view is the block resampled on a box of rays (orthographic, one sample a voxel along the ray), so that both the fog of
paper figure 6 and a lit surface are plain array arithmetic along the last axis.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy import ndimage

INK, PAPER = "#22252b", "#ffffff"
CLAY = (0.80, 0.47, 0.33)
REGIME_COLOURS = {"none": "#8a8f98", "elastic": "#2a7ab8", "plastic": "#c8432b", "unloading": "#2d8f57"}

plt.rcParams.update(
    {
        "figure.facecolor": PAPER,
        "savefig.facecolor": PAPER,
        "font.size": 9.5,
        "axes.titlesize": 10.5,
        "axes.edgecolor": INK,
        "axes.labelcolor": INK,
        "text.color": INK,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "legend.frameon": False,
        "legend.fontsize": 8.5,
    }
)


def save(figure, path: Path, dpi: int = 130) -> None:
    """Write a PNG, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f"{path.stem}.{os.getpid()}.part.png")
    try:
        figure.savefig(unfinished, dpi=dpi)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
        plt.close(figure)


def show(axes, picture: np.ndarray, title: str = "") -> None:
    """Put an image (rows, columns[, 3]) in axes without ticks."""
    axes.imshow(np.clip(picture, 0.0, 1.0), cmap="gray", vmin=0.0, vmax=1.0, interpolation="bilinear")
    axes.set_axis_off()
    axes.set_title(title)


@dataclass(frozen=True)
class View:
    """A block seen from a direction: azimuth and elevation in degrees, z up; ``size`` pixels square over ``across``
    voxels around ``centre`` (default the block's middle)."""

    azimuth: float = 35.0
    elevation: float = 25.0
    size: int = 420
    across: float = 200.0
    centre: tuple[float, float, float] | None = None

    @property
    def axes(self) -> np.ndarray:
        """(3, 3): right, up and away from the eye, as rows in voxel space."""
        a, e = np.radians([self.azimuth, self.elevation])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        away = -np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
        return np.stack([right, np.cross(right, away), away])

    def rays(self, density: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The block on the rays (rows, columns, depth) float32, and the affine map (matrix, start) back to voxels."""
        right, up, away = self.axes
        centre = np.array(self.centre if self.centre is not None else [(n - 1) / 2 for n in density.shape])
        pixel = self.across / self.size
        corners = np.array(list(np.ndindex(2, 2, 2))) * (np.array(density.shape) - 1) - centre
        near, far = (corners @ away).min(), (corners @ away).max()
        depth = int(np.ceil(far - near)) + 3
        matrix = np.stack([-up * pixel, right * pixel, away], axis=1)
        start = centre + (up - right) * pixel * (self.size - 1) / 2 + away * (near - 1.0)
        half = self.size // 2
        seen = np.empty((self.size, self.size, depth), np.float32)

        def resample(rows: slice) -> None:
            at = start + matrix[:, 0] * rows.start
            ndimage.affine_transform(density, matrix, at, output=seen[rows], output_shape=seen[rows].shape, order=1)

        with ThreadPoolExecutor(2) as pool:  # the resampling lets go of the GIL
            list(pool.map(resample, (slice(0, half), slice(half, self.size))))
        return seen, matrix, start


def fog(density: np.ndarray, view: View, length: float) -> np.ndarray:
    """Grey emission and absorption: a voxel's grey is its density, and so is the opacity of ``length`` voxels of it.

    Density 0 is black and clear, density 1 white and opaque (paper figure 6). Returns (rows, columns) in [0, 1].
    """
    seen = np.clip(view.rays(density)[0], 0.0, 1.0)
    clear = np.maximum(1.0 - seen, 1e-6) ** (1.0 / length)
    before = np.cumprod(clear, axis=2)
    before = np.concatenate([np.ones_like(before[..., :1]), before[..., :-1]], axis=2)
    return (before * (1.0 - clear) * seen).sum(axis=2)


def surface(
    density: np.ndarray, view: View, level: float = 0.5, colour=CLAY, smooth: float = 0.8, paint=None
) -> np.ndarray:
    """The surface where density is ``level``, lit by a lamp at upper left with its shadow, and a sky.

    ``paint`` (points (3, n) in voxels -> (n, 3)) colours it; otherwise it is of one ``colour``. The edge of the array
    counts as surface too. Returns (rows, columns, 3) in [0, 1], on white.
    """
    margin = 3
    density = np.pad(density, margin)
    shifted = view if view.centre is None else View(**{**vars(view), "centre": tuple(c + margin for c in view.centre)})
    seen, matrix, start = shifted.rays(density)
    inside = seen > level
    hit = inside.any(axis=2)
    rows, columns = np.nonzero(hit)
    depth = inside.argmax(axis=2)[rows, columns]
    after, before = seen[rows, columns, depth], seen[rows, columns, np.maximum(depth - 1, 0)]
    at = depth - np.where(after > before, (after - level) / np.maximum(after - before, 1e-6), 0.0)
    points = matrix @ np.stack([rows, columns, at]) + start[:, None]
    soft = ndimage.gaussian_filter(density, smooth)
    normal = -np.stack([ndimage.map_coordinates(g, points, order=1) for g in np.gradient(soft)])
    normal /= np.maximum(np.linalg.norm(normal, axis=0), 1e-6)
    right, up, away = view.axes
    lamp = -0.75 * right + 0.95 * up - 0.55 * away
    lamp /= np.linalg.norm(lamp)
    shade = np.clip(normal.T @ lamp, 0.0, 1.0) * _unshadowed(soft, points + 1.5 * normal, lamp, level)
    wide = ndimage.gaussian_filter(density, 6.0)
    sky = np.clip(1.25 - 1.5 * ndimage.map_coordinates(wide, points + 4.0 * normal, order=1), 0.15, 1.0)
    light = (0.36 * sky * (0.75 + 0.25 * normal[2]) + 0.80 * shade)[:, None]
    glint = np.clip(normal.T @ ((lamp - away) / np.linalg.norm(lamp - away)), 0.0, 1.0) ** 30 * shade
    base = np.array(colour) if paint is None else paint(points - margin)
    picture = np.ones((*hit.shape, 3))
    picture[rows, columns] = (np.clip(base * light, 0.0, 1.0) + 0.10 * glint[:, None]) ** (1.0 / 1.35)
    return picture


def _unshadowed(density: np.ndarray, points: np.ndarray, lamp: np.ndarray, level: float) -> np.ndarray:
    """Share of the lamp that reaches each point (3, n): what it passes on its way out, softly."""
    thickest = np.zeros(points.shape[1])
    for step in np.arange(1.5, 0.8 * max(density.shape), 1.5):
        np.maximum(thickest, ndimage.map_coordinates(density, points + step * lamp[:, None], order=1), out=thickest)
    return 1.0 - np.clip((thickest - 0.6 * level) / (0.5 * level), 0.0, 1.0)
