# SPDX-License-Identifier: GPL-3.0-or-later
"""The rim on trial: the compiled push into a half space, packed by `core.material.packing`, against finite elements.

`python -m tests.bench.truths.trial` writes out/chart/rim_trial.csv and rim_trial.png; --small FILE draws the picture
that pages show.
"""

from __future__ import annotations

import argparse
import csv
import os
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from tqdm import tqdm

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.material import Packing, packing

from .cache import load
from .case import CASES, DEPTHS, Case
from .indentation import Indentation

RADII = (16, 24, 32)
"""Of the tool, in voxels."""
YIELDS_AT_ONCE = 1e-6
"""A yield ratio with which the tool is emptied wholly, as a rigid sphere is."""
HALF_WIDTH, BELOW, ABOVE = 3.0, 2.5, 0.75
"""Extent of the block in radii, beside the sphere, under the surface and over it."""
HAS_A_RIM = 0.05
"""Of the depth: only a rim above this has a place."""
SHOWN = ("mises-500", "mises-500-h100", "mises-200", "mises-100", "mises-50", "foam-500")
"""Cases, and one depth, in the small picture."""


@dataclass(frozen=True)
class Raised:
    """A surface after the push, lengths in radii: its height ``z`` (m, k) at radii ``r`` (k,), and its rim.

    ``rim`` (m,) is the greatest height over the depth, 0 where nothing stands above the surface, at ``radius`` (m,).
    """

    r: np.ndarray
    z: np.ndarray
    rim: np.ndarray
    radius: np.ndarray


@dataclass(frozen=True)
class Row:
    """One depth of one case with one tool; lengths in radii, heights over the depth."""

    case: str
    tool: int
    depth: float
    density: float
    band: float | None
    hats: float
    rim_truth: float
    rim: float
    peak_truth: float
    peak: float
    surface_max: float
    surface_l1: float

    @property
    def err_rim(self) -> float:
        return self.rim - self.rim_truth

    @property
    def err_peak(self) -> float:
        """nan where the truth has no rim."""
        return self.peak - self.peak_truth if self.rim_truth > HAS_A_RIM else float("nan")


def packing_of(case: Case) -> Packing:
    """By the rule; stresses are in E."""
    solid = case.solid
    return packing(1.0, solid.yield_stress, solid.hardening, solid.filled)


def press(radius: int, packed: Packing, depths: tuple[float, ...] = DEPTHS, step: float = 0.25) -> Raised:
    """Press a sphere of ``radius`` voxels into a block; ``depths`` are in radii, ``step`` in voxels."""
    half, first = int(HALF_WIDTH * radius), int(ABOVE * radius)
    block = np.zeros((2 * half, 2 * half, first + int(BELOW * radius)), np.float32)
    block[:, :, first:] = packed.density
    grid = DensityGrid(block, copy=False)
    band = None if packed.band is None else packed.band * radius
    push = Push(grid, SphereTool(radius), Material(3.3, YIELDS_AT_ONCE), border="wall", band=band, rim=packed.rim)
    middle, surface = half - 0.5, first - 0.5
    lines, depth = [], -step
    for wanted in depths:
        while depth < wanted * radius - 1e-9:
            depth = min(depth + step, wanted * radius)
            push.move_to((middle, middle, surface - radius + depth))
        lines.append(profile(grid.density, first, packed.density) / radius)
    z = np.array(lines)
    r = (np.arange(z.shape[1]) + 0.5) / radius
    peaks = np.array([peak(r, line) for line in z])
    return Raised(r, z, np.maximum(peaks[:, 0], 0.0) / depths, peaks[:, 1])


def profile(density: np.ndarray, first: int, at_first: float) -> np.ndarray:
    """Mean height in voxels over rings of one voxel about the middle, (k,), of what filled planes ``first`` and on.

    The surface lies where density passes half of what it was ``at_first``, told between voxels.
    """
    half, level = density.shape[0] // 2, np.float32(0.5 * at_first)
    top = (density >= level).argmax(axis=2)
    i, j = np.indices(top.shape)
    inside, outside = density[i, j, top].astype(float), density[i, j, np.maximum(top - 1, 0)].astype(float)
    inside = np.minimum(inside, at_first)  # what is compacted is no higher for it
    height = (first - 0.5) - (top - (inside - level) / np.maximum(inside - outside, 1e-6))
    ring = np.hypot(i - half + 0.5, j - half + 0.5).astype(int).ravel()
    return (np.bincount(ring, height.ravel()) / np.bincount(ring))[:half]


def peak(r: np.ndarray, z: np.ndarray) -> tuple[float, float]:
    """Height of the highest ring, and its place by the parabola through it and its neighbours."""
    k = int(np.argmax(z[1:-1])) + 1
    bend = z[k - 1] - 2.0 * z[k] + z[k + 1]
    shift = 0.5 * (z[k - 1] - z[k + 1]) / bend if bend < 0.0 else 0.0
    return float(z[k]), float(r[k] + shift * (r[1] - r[0]))


def compared(case: Case, truth: Indentation, tool: int, raised: Raised) -> list[Row]:
    """Row by depth. The free surface is compared from the contact's end to 2.5 R, the farthest that both have."""
    packed, rows = packing_of(case), []
    for m, depth in enumerate(DEPTHS):
        free = (raised.r > np.interp(depth, truth.depth, truth.contact_radius)) & (raised.r < 2.5)
        differs = np.abs(raised.z[m] - np.interp(raised.r, truth.profile_r, truth.profile_z[m]))[free] / depth
        of_rim = truth.rim[m], float(raised.rim[m]), truth.rim_radius[m], float(raised.radius[m])
        shape = float(differs.max()), float(differs.mean() * 2.5)
        rows.append(Row(case.name, tool, depth, packed.density, packed.band, packed.rim, *of_rim, *shape))
    return rows


def tried() -> tuple[list[Row], dict[tuple[str, int], Raised]]:
    rows, surfaces = [], {}
    for name, case in tqdm(CASES.items(), "rim"):
        truth = load(name)
        for tool in RADII:
            surfaces[name, tool] = press(tool, packing_of(case))
            rows += compared(case, truth, tool, surfaces[name, tool])
    return rows, surfaces


def worst(rows: list[Row], tool: int) -> tuple[float, float]:
    """Greatest error of height, over the depth, and of place, in radii, with one tool."""
    mine = [row for row in rows if row.tool == tool]
    return max(abs(row.err_rim) for row in mine), float(np.nanmax([abs(row.err_peak) for row in mine]))


def save_csv(rows: list[Row], path: Path) -> None:
    columns = [*Row.__dataclass_fields__, "err_rim", "err_peak"]
    beside = path.with_suffix(f".{os.getpid()}.part")
    with beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in rows:
            values = [getattr(row, column) for column in columns]
            writer.writerow([f"{value:.4f}" if isinstance(value, float) else value for value in values])
    beside.replace(path)


def draw(
    surfaces: dict[tuple[str, int], Raised], path: Path, names: tuple[str, ...], depths: tuple[float, ...]
) -> None:
    """The free surface by the elements (wide grey) and by the push with each tool, height over depth."""
    columns = 3 if len(names) <= 6 else 6
    lines = -(-len(names) // columns)
    figure, axes = plt.subplots(
        lines, columns, figsize=(2.5 * columns, 1.7 * lines), sharex=True, sharey=True, layout="constrained"
    )
    shades = plt.get_cmap("viridis")(np.linspace(0.0, 0.75, len(RADII)))
    for name, panel in zip(names, axes.flat):
        truth = load(name)
        for depth in depths:
            m = DEPTHS.index(depth)
            panel.plot(truth.profile_r, truth.profile_z[m] / depth, color="0.75", linewidth=4.0)
            for tool, shade in zip(RADII, shades):
                raised = surfaces[name, tool]
                panel.plot(raised.r, raised.z[m] / depth, color=shade, linewidth=0.9, label=f"R = {tool} voxels")
        panel.set_title(name, fontsize=8)
        panel.axhline(0.0, color="0.5", linewidth=0.5)
        panel.set(xlim=(0.0, 2.2), ylim=(-0.6, 0.6))
        panel.tick_params(labelsize=7)
    axes.flat[0].legend(*(one[: len(RADII)] for one in axes.flat[0].get_legend_handles_labels()), fontsize=6, loc=4)
    figure.supxlabel("r / R", fontsize=8)
    figure.supylabel(f"height / depth, {' and '.join(f'{depth:g}' for depth in depths)} R deep", fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(f".{os.getpid()}.part")
    figure.savefig(beside, dpi=100, format="png")
    plt.close(figure)
    beside.replace(path)


def main() -> None:
    parser = argparse.ArgumentParser("tests.bench.truths.trial", description=__doc__)
    parser.add_argument(
        "--out", type=Path, default=Path("out/chart"), help="folder for rim_trial.csv and rim_trial.png"
    )
    parser.add_argument("--small", type=Path, help="the page's picture, drawn too")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows, surfaces = tried()
    save_csv(rows, options.out / "rim_trial.csv")
    draw(surfaces, options.out / "rim_trial.png", tuple(CASES), (0.15, 0.3))
    if options.small:
        draw(surfaces, options.small, SHOWN, (0.3,))
    for name in CASES:
        mine = [row for row in rows if row.case == name]
        peaks = [abs(row.err_peak) for row in mine if not np.isnan(row.err_peak)]
        print(
            f"{name:15s} d0 {mine[0].density:.4f} rim {mine[0].hats:.2f}"
            f"  height {max(abs(row.err_rim) for row in mine):.3f} of the depth  place {max(peaks, default=0.0):.3f} R"
            f"  surface {max(row.surface_max for row in mine):.2f} of the depth at most"
        )
    for tool in RADII:
        height, place = worst(rows, tool)
        print(f"R = {tool} voxels: height within {height:.3f} of the depth, place within {place:.3f} R")


if __name__ == "__main__":
    main()
