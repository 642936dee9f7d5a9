# SPDX-License-Identifier: GPL-3.0-or-later
"""Figure 4: the pyramid, voxel by voxel as the paper recurses, by the sweep, and as the sweep's footprint."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from drawing import INK, save
from matplotlib.colors import LogNorm, SymLogNorm
from matplotlib.patches import Circle

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.dispersion import DISPERSION, dominant_axis, spreading

SIDE, SURFACE, DENSITY, RADIUS = 25, 15, 0.95, 4.0
"""Dense enough that one voxel's mass needs several planes of neighbours."""
DIRECTIONS = {
    "along -z": (0.0, 0.0, -1.0),
    "along (0, 1, -1)": (0.0, 1.0, -1.0),
    "along (.33, .5, -.8)": (0.33, 0.5, -0.8),
}
PLANES = 28
STEP, LATER = 0.005, 0.6


def section_at(method: str, depth: float | None) -> tuple[np.ndarray, float]:
    """The change of density in a section, and the tool's height, when its tip is ``depth`` voxels in, or, for None,
    as soon as any density has moved."""
    density = np.zeros((SIDE, SIDE, SIDE), np.float32)
    density[:, :, :SURFACE] = DENSITY
    push = Push(DensityGrid(density), SphereTool(RADIUS), Material(3.3, 0.02), method=method, border="wall")
    middle, surface, gone = SIDE // 2, SURFACE - 0.5 + RADIUS, -0.5
    moved = False
    while gone < depth if depth is not None else not moved:
        gone += STEP
        moved = push.move_to((middle, middle, surface - gone)).moved_mass > 0.0
    return push.grid.density[:, middle] - density[:, middle], surface - gone


def footprint(direction) -> tuple[np.ndarray, int]:
    """The flux that one voxel sends through each plane of packed material: (planes, positions) summed across the
    section, and the position of the voxel."""
    u = np.array(direction) / np.linalg.norm(direction)
    kernel = spreading(u, dominant_axis(u))
    weights = np.reshape(kernel.weights, (3, 3)).sum(axis=0, dtype=np.float64)
    shift = kernel.shift[1]
    row = np.zeros(4 * PLANES + 1)
    row[2 * PLANES] = 1.0
    rows = [row]
    for _ in range(PLANES - 1):
        row = np.roll(np.convolve(row, weights, mode="same"), shift)
        rows.append(row)
    return np.array(rows), 2 * PLANES


def draw(path) -> None:
    figure = plt.figure(figsize=(12.0, 8.2), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=[1, 1])
    first, later, swept = top.subplots(1, 3)
    first_voxel = "the paper's recursion: the first voxel\n0 gives up density; 1, 2, ... take it up"
    next_ones = f"the paper's recursion: the next ones\n{LATER} voxels deep"
    image = _section(first, *section_at("recursive", None), first_voxel)
    _section(later, *section_at("recursive", LATER), next_ones)
    _section(swept, *section_at("sweep", LATER), "the sweep, at the same depth\nwhole shells of the tool at once")
    top.colorbar(image, ax=[first, later, swept], label="change of density", shrink=0.85, aspect=18, pad=0.01)
    for axes, (name, direction) in zip(panels := bottom.subplots(1, 3), DIRECTIONS.items()):
        image = _footprint(axes, name, direction)
    bottom.colorbar(image, ax=panels, label="share of the voxel's mass", shrink=0.85, aspect=18, pad=0.01)
    save(figure, path)


def _section(axes, change, height, title):
    image = axes.imshow(change.T, origin="lower", cmap="RdBu_r", norm=SymLogNorm(0.005, vmin=-1, vmax=1))
    gave = np.argwhere(change < -1e-6)
    for x, z in np.argwhere(np.abs(change) > 1e-6):
        level = 0 if change[x, z] < 0 else int(gave[:, 1].max() - z)
        axes.text(
            x, z, level, ha="center", va="center", fontsize=7.5, color="white" if abs(change[x, z]) > 0.2 else INK
        )
    axes.add_patch(Circle((SIDE // 2, height), RADIUS, fill=False, ec="#e09000", lw=1.8))
    axes.axhline(SURFACE - 0.5, color=INK, lw=0.8, ls=":")
    axes.set_xticks(np.arange(-0.5, SIDE), minor=True)
    axes.set_yticks(np.arange(-0.5, SIDE), minor=True)
    axes.grid(which="minor", color="#d8dade", lw=0.5)
    axes.tick_params(which="both", length=0, labelbottom=False, labelleft=False)
    axes.set(xlim=(4.5, SIDE - 5.5), ylim=(4.5, SURFACE + 5.5), title=title)
    return image


def _footprint(axes, name, direction):
    rows, start = footprint(direction)
    image = axes.imshow(
        np.ma.masked_less(rows, 1e-5),
        cmap="magma_r",
        norm=LogNorm(1e-5, 1.0),
        interpolation="nearest",
        aspect="equal",
        extent=(-start - 0.5, start + 0.5, PLANES - 0.5, -0.5),
    )
    u = np.array(direction) / np.linalg.norm(direction)
    axis = dominant_axis(u)
    across = u[1] if axis == 2 else u[2]
    planes = np.arange(PLANES)
    mean = planes * across / abs(u[axis])
    deviation = np.sqrt(planes * DISPERSION / abs(u[axis]) * (1 + (across / u[axis]) ** 2))
    axes.plot(mean, planes, color="#0b6e99", lw=1.4, label="u")
    axes.plot(mean + deviation, planes, color="#0b6e99", lw=1.0, ls="--", label="± one deviation, D = 0.3")
    axes.plot(mean - deviation, planes, color="#0b6e99", lw=1.0, ls="--")
    shift = np.round(across / abs(u[axis]))
    for side, label in ((-1, None), (1, "the pyramid's faces")):
        axes.plot((shift + side) * planes, planes, color=INK, lw=0.8, ls=":", label=label)
    axes.set(xlim=(-24, 24), ylim=(PLANES - 0.5, -1.5), title=f"forward kernel {name}")
    axes.set(xlabel="voxels across", ylabel="planes ahead")
    if across < 0.0:  # where there is room for it
        axes.legend(loc="lower right", handlelength=1.4, fontsize=8)
    return image
