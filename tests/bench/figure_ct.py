# SPDX-License-Identifier: GPL-3.0-or-later
"""Figure 7: the same tool in a CT volume of 256^3 voxels read from a PVM, before and after."""

from __future__ import annotations

import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drawing import View, save, show, surface
from scipy import ndimage

from repousse.core import DensityGrid, Material, Push, SphereTool, Stroke, native
from repousse.core.formats import read_volume

BONSAI = Path(__file__).resolve().parents[3] / "shared" / "data" / "pvm" / "bonsai_256.pvm"
RADIUS = 16.0
LEVEL = 0.17
STROKES = {
    "into the wall of the pot": ((118.0, 30.0, 56.0), (118.0, 30.0, 118.0)),
    "through the crown": ((236.0, 176.0, 118.0), (30.0, 168.0, 118.0)),
}
PAINT = (
    (0.17, (0.42, 0.56, 0.26)),
    (0.34, (0.46, 0.42, 0.22)),
    (0.48, (0.50, 0.33, 0.20)),
    (0.62, (0.55, 0.38, 0.26)),
    (0.76, (0.62, 0.64, 0.68)),
    (1.0, (0.75, 0.77, 0.80)),
)
"""Colours by the density just inside the surface: leaves, wood, earth, pot."""


def load() -> tuple[DensityGrid, str]:
    """The bonsai where it is, else a volume made like it: noise, a stem, a crown and a pot."""
    if BONSAI.is_file():
        return read_volume(BONSAI), "CT of a bonsai (bonsai_256.pvm)"
    x, y, z = np.ogrid[:256, :256, :256]
    noise = ndimage.zoom(np.random.default_rng(7).random((64, 64, 64), dtype=np.float32), 4, order=1)
    crown = ((x - 118) ** 2 + (y - 168) ** 2 + (z - 128) ** 2 < 62**2) & (noise > 0.62)
    stem = ((x - 118) ** 2 + (z - 128) ** 2 < 81) & (y > 40) & (y < 180)
    pot = (np.hypot(x - 118, z - 128) < 52) & (y < 56)
    density = np.where(pot, 0.8, np.where(stem, 0.6, np.where(crown, 0.25, 0.0))).astype(np.float32)
    return DensityGrid(density), "Made volume (bonsai_256.pvm is not here)"


def draw(path) -> None:
    grid, what = load()
    before, mass = grid.density.copy(), grid.mass
    push = Push(grid, SphereTool(RADIUS), Material(3.3, 0.05), border="wall")
    spent, moved = [], 0.0
    for start, end in STROKES.values():
        push.lift()
        for sample in Stroke.line(start, end).samples:
            began = time.perf_counter()
            moved += push.move_to(sample.position).moved_mass
            spent.append(time.perf_counter() - began)
    figure = plt.figure(figsize=(13.2, 6.6), layout="constrained")
    left, right, cuts = figure.subplots(1, 3, width_ratios=[1, 1, 0.55])
    cuts.set_axis_off()
    for axes, density, title in ((left, before, "before"), (right, push.grid.density, "after two strokes")):
        upright = np.ascontiguousarray(density.transpose(2, 0, 1))  # y is up in this scan
        view = View(azimuth=212, elevation=16, size=420, across=250, centre=(128, 122, 118))
        show(axes, surface(_without_table(upright), view, LEVEL, smooth=0.9, paint=_painter(upright)), title)
    for place, (density, title) in enumerate(((before, "section at x = 118, before"), (push.grid.density, "after"))):
        inset = cuts.inset_axes((0.1, 0.54 - 0.52 * place, 0.9, 0.42))
        inset.imshow(density[118], origin="lower", cmap="gray", vmin=0, vmax=1)
        inset.set(ylabel="y (voxels)", title=title)
    inset.set_xlabel("z (voxels)")
    milliseconds = 1000 * np.array(spent)
    figure.suptitle(
        f"{what}: a sphere of {2 * RADIUS:g} voxels pushed {' and '.join(STROKES)}\n"
        f"{len(spent)} steps, {moved:,.0f} voxels' worth moved, "
        f"mass {mass:,.1f} before and {push.grid.mass:,.1f} after, "
        f"{np.median(milliseconds):.2f} ms a step ({native.name()})",
        fontsize=11,
    )
    save(figure, path)


def _without_table(upright: np.ndarray) -> np.ndarray:
    """The scan without specks of noise and without the scanner's table, which stays low; for the picture only."""
    parts, _ = ndimage.label(upright > LEVEL)
    sizes = np.bincount(parts.ravel())
    low = np.array([False, *(place[2].stop < 45 for place in ndimage.find_objects(parts))])
    unwanted = (sizes < 60) | low
    unwanted[0] = False
    return np.where(unwanted[parts], 0.0, upright)


def _painter(density: np.ndarray):
    levels = np.array([level for level, _ in PAINT])
    colours = np.array([colour for _, colour in PAINT])
    inner = ndimage.maximum_filter(density, 3)

    def paint(points: np.ndarray) -> np.ndarray:
        value = ndimage.map_coordinates(inner, points, order=1)
        return np.stack([np.interp(value, levels, colours[:, channel]) for channel in range(3)], axis=1)

    return paint
