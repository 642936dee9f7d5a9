# SPDX-License-Identifier: GPL-3.0-or-later
"""Figure 1: stress against depth through two cycles, the program's over the closed form of the column (DESIGN 2)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
from drawing import INK, REGIME_COLOURS, save

from repousse.core import BoxTool, DensityGrid, Material, Push

DENSITY, YIELD_RATIO, REACH_AHEAD = 0.6, 0.35, 12.0
WIDTH, SURFACE = 16, 96
STIFFNESS = 0.5
"""k_t A: newtons a voxel of depth, in full material."""
WIDTHS, DASHES = (1.8, 3.5, 1.6, 3.5), ("-", "-", (0, (2, 1.5)), "-")
"""Of the lines of the four legs: the way back in lies on the way out."""
TURNS = (9.0, 0.0, 24.0, 8.0)
"""Depths in voxels at which the punch turns: in, out, in past the first turn and out again."""


@dataclass(frozen=True)
class Column:
    """The closed form: a column of cross-section A, reach D ahead of a flat punch, density d0."""

    stiffness: float  # k_t A, newtons a voxel of full material

    @property
    def slope(self) -> float:
        return self.stiffness * DENSITY

    @property
    def yield_depth(self) -> float:
        return YIELD_RATIO * REACH_AHEAD

    @property
    def plateau_depth(self) -> float:
        return REACH_AHEAD * ((1 + YIELD_RATIO) / DENSITY - 1)

    @property
    def plateau(self) -> float:
        return self.stiffness * YIELD_RATIO * REACH_AHEAD

    @property
    def plastic_slope(self) -> float:
        return self.slope * YIELD_RATIO / (1 + YIELD_RATIO)

    def loading(self, depth):
        """Stress on the way in through fresh material, newtons."""
        plastic = self.slope * self.yield_depth + self.plastic_slope * (np.asarray(depth) - self.yield_depth)
        return np.minimum(np.minimum(self.slope * np.asarray(depth), plastic), self.plateau)

    def unloading(self, depth, turn: float):
        """Stress on the way out from ``turn``: the front is compacted, so the slope is E / d0."""
        return np.maximum(self.loading(turn) - self.stiffness * (turn - np.asarray(depth)), 0.0)


def measure():
    """Depths (voxels) and contacts of a punch as wide as its walled column, through both cycles."""
    density = np.zeros((WIDTH, WIDTH, SURFACE + 8), np.float32)
    density[:, :, :SURFACE] = DENSITY
    half = 24.0
    punch = BoxTool((2 * half, 2 * half, half), REACH_AHEAD)
    push = Push(
        DensityGrid(density),
        punch,
        Material(STIFFNESS / WIDTH**2 * punch.volume.covered_volume, YIELD_RATIO),
        border="wall",
    )
    column = Column(push.k_t * WIDTH**2)
    path, at = [], -2.0
    for turn in TURNS:
        path.append(np.linspace(at, turn, max(2, round(abs(turn - at) / 0.125) + 1)))
        at = turn
    middle = (WIDTH - 1) / 2
    legs = [(leg, [push.move_to((middle, middle, SURFACE - 0.5 - d + half)) for d in leg]) for leg in path]
    return column, legs


def draw(path) -> None:
    column, legs = measure()
    figure, axes = plt.subplots(figsize=(8.6, 5.0), layout="constrained")
    first, second = TURNS[0], TURNS[2]
    deep = np.linspace(0.0, second, 400)
    closed = {"lw": 5.0, "alpha": 0.22, "color": INK, "solid_capstyle": "round"}
    axes.plot(deep, column.loading(deep), label="closed form", **closed)
    for turn in (first, second):
        out = np.linspace(turn - float(column.loading(turn)) / column.stiffness, turn, 50)
        axes.plot(out, column.unloading(out, turn), **closed)
    named = set()
    for leg, (depths, contacts) in enumerate(legs):
        regimes = np.array([c.regime.value for c in contacts])
        stress = np.array([c.stress for c in contacts])
        for begin, end in _runs(regimes):
            regime = regimes[begin]
            if regime == "none":
                continue
            since = max(begin - 1, 0)
            label = None if regime in named else f"measured, {regime}"
            named.add(regime)
            axes.plot(
                depths[since:end],
                stress[since:end],
                color=REGIME_COLOURS[regime],
                lw=WIDTHS[leg],
                ls=DASHES[leg],
                label=label,
            )
    worst = max(
        _difference(column, depths, contacts, turn) for (depths, contacts), turn in zip(legs[::2], (first, second))
    )
    _annotate(axes, column, first)
    axes.axhline(0.0, color=INK, lw=0.8)
    axes.text(first + 0.4, float(column.loading(first)), "dashed: the second way in", va="top", fontsize=8, alpha=0.8)
    axes.set(
        xlabel="depth of the punch, δ (voxels)",
        ylabel="stress σ (N)",
        xlim=(-1.0, second + 1.5),
        ylim=(-0.06 * column.plateau, 1.3 * column.plateau),
        title="Elastic loading, plastic loading, unloading: "
        f"density {DENSITY}, κ = {YIELD_RATIO}, reach D = {REACH_AHEAD:g} voxels\n"
        f"largest difference from the closed form on the way in: {worst:.1%} of the plateau",
    )
    axes.legend(loc="lower center", bbox_to_anchor=(0.6, 0.06))
    save(figure, path)


def _runs(values: np.ndarray):
    edges = np.nonzero(values[1:] != values[:-1])[0] + 1
    bounds = [0, *edges.tolist(), len(values)]
    return pairwise(bounds)


def _difference(column: Column, depths, contacts, turn: float) -> float:
    """Largest distance of stress from the closed form on a way in, over the plateau; fresh material only."""
    fresh = depths > (0.0 if turn == TURNS[0] else TURNS[0])
    stress = np.array([c.stress for c in contacts])
    return float(np.abs(stress - column.loading(depths))[fresh].max() / column.plateau)


def _annotate(axes, column: Column, turn: float) -> None:
    at_turn = float(column.loading(turn))
    left = turn - float(column.loading(turn)) / column.stiffness
    notes = {"fontsize": 10, "color": INK}
    axes.text(0.36 * column.yield_depth, column.slope * column.yield_depth * 0.62, "E", ha="right", **notes)
    middle = (turn + column.plateau_depth) / 2
    axes.text(
        middle, float(column.loading(middle)) + 0.05 * column.plateau, r"$E_{ep} = E\,κ/(1+κ)$", ha="right", **notes
    )
    axes.text(left + 0.62 * (turn - left) + 0.5, 0.55 * at_turn, r"$E/d_0$", ha="left", **notes)
    axes.annotate(
        "",
        (0, -0.028 * column.plateau),
        (left, -0.028 * column.plateau),
        arrowprops={"arrowstyle": "<->", "color": INK},
    )
    axes.text(left + 0.75, 0.02 * column.plateau, "the last voxel of\na front is part full", fontsize=8, alpha=0.8)
    axes.text(left / 2, 0.02 * column.plateau, "permanent Δε", ha="center", fontsize=9)
    first_yield = column.slope * column.yield_depth
    for height, text in (
        (first_yield, r"$σ_e$"),
        (at_turn, r"$σ_f$ after the first cycle"),
        (column.plateau, "plateau $k_t A κ D$"),
    ):
        axes.axhline(height, color=INK, lw=0.6, ls=":", alpha=0.6)
        axes.text(-0.8, height, text, va="bottom", ha="left", fontsize=8.5)
