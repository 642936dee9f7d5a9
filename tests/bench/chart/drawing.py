# SPDX-License-Identifier: GPL-3.0-or-later
"""The chart: time against error, a panel for each truth and error, every point named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator
from PIL import Image

from ..drawing import INK, save
from .growth import Growth
from .pareto import front
from .rows import Row

LEAST = 1e-3
"""Errors below this are drawn here: no hand and no eye tells them from none."""
COLOURS = {
    "sweep": "#c8432b",
    "sweep + rim": "#e0902a",
    "carve": "#8a8f98",
    "recursive": "#2a7ab8",
}
OTHERS = ("#2d8f57", "#7a4fb0", "#0f8f96", "#b0488c", "#6b7a1e", "#4a5a8a")

HALO = [patheffects.withStroke(linewidth=2.2, foreground="white")]


@dataclass(frozen=True)
class Panel:
    """One truth and one of its errors, with what it is called on the axis."""

    truth: str
    error: str
    title: str
    axis: str

    def shows(self, row: Row) -> bool:
        """Whether a row has a point here. Another exponent moves no voxel, so it is seen where forces are."""
        force_alone = row.setting.startswith("m = ") and self.error != "err_force"
        return row.truth == self.truth and self.error in row.errors and row.ms_p50 > 0.0 and not force_alone


def known(rows: Sequence[Row], panel: Panel) -> list[Row]:
    """The rows that have a point in a panel."""
    return [row for row in rows if panel.shows(row)]


def colour(method: str, methods: Sequence[str]) -> str:
    """A colour for each method, the same in all panels."""
    others = [name for name in methods if name not in COLOURS]
    return COLOURS.get(method) or OTHERS[others.index(method) % len(OTHERS)]


def draw(rows: Sequence[Row], panels: Sequence[Panel], path: Path) -> None:
    """All panels that have a point, two beside each other; in few colours, so that the file is small."""
    shown = [panel for panel in panels if known(rows, panel)]
    methods = list(dict.fromkeys(row.method for row in rows))
    lines = -(-len(shown) // 2)
    figure, grid = plt.subplots(lines, 2, figsize=(14.0, 5.2 * lines), layout="constrained", squeeze=False)
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.12)
    for axes in grid.flat[len(shown) :]:
        axes.set_axis_off()
    for axes, panel in zip(grid.flat, shown):
        _frame(axes, panel, known(rows, panel))
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes, panel in zip(grid.flat, shown):
        _points(axes, known(rows, panel), panel, methods)
    save(figure, path, 100)
    with Image.open(path) as picture:
        few = picture.convert("RGB").quantize(255, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


def _frame(axes: Axes, panel: Panel, rows: Sequence[Row]) -> None:
    times = [row.ms_p50 for row in rows]
    errors = [max(row.errors[panel.error], LEAST) for row in rows]
    axes.set(xscale="log", yscale="log", title=panel.title, xlabel="milliseconds a step, p50", ylabel=panel.axis)
    axes.set_xlim(min(times) / 2.5, max(times) * 6.0)
    axes.set_ylim(min(errors) / 2.2, max(errors) * 2.2)
    axes.grid(True, which="major", lw=0.4, alpha=0.4)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def _points(axes: Axes, rows: Sequence[Row], panel: Panel, methods: Sequence[str]) -> None:
    points = [(row.ms_p50, max(row.errors[panel.error], LEAST)) for row in rows]
    best = [points[i] for i in front(points)]
    corners = [(best[0][0], axes.get_ylim()[1])]
    for before, after in pairwise(best):
        corners += [before, (after[0], before[1])]
    corners += [best[-1], (axes.get_xlim()[1], best[-1][1])]
    axes.plot(*zip(*corners), color=INK, lw=1.1, alpha=0.55, zorder=1)
    line = axes.transData.transform(corners)
    for row, (time, error) in zip(rows, points):
        on_front = (time, error) in best
        tint = colour(row.method, methods)
        axes.scatter(time, error, s=42 if on_front else 26, color=tint, edgecolor=INK, lw=1.2 * on_front, zorder=3)
    _name(axes, rows, points, methods, [(*np.minimum(a, b) - 1.0, *np.maximum(a, b) + 1.0) for a, b in pairwise(line)])


def _name(axes: Axes, rows: Sequence[Row], points: Sequence[tuple[float, float]], methods, taken: list) -> None:
    """Every point's name beside it, where it covers no point, no other name and no box of ``taken``; joined to it when
    far away."""
    figure = axes.figure
    renderer = figure.canvas.get_renderer()
    at = axes.transData.transform(points)
    frame = axes.get_window_extent(renderer)
    size = 7.0 * figure.dpi / 100.0
    taken += [(x - size, y - size, x + size, y + size) for x, y in at]
    for number in np.argsort([-y for _, y in at], kind="stable"):
        row, (x, y) = rows[number], at[number]
        text = axes.annotate(
            row.label, points[number], xytext=(0, 0), textcoords="offset pixels", fontsize=7.2,
            color=colour(row.method, methods), va="center", ha="left", zorder=4, path_effects=HALO,
        )  # fmt: skip
        extent = text.get_window_extent(renderer)
        place = _free_place(x, y, extent.width, extent.height, frame, taken, 1.4 * size)
        taken.append((place[0] - size, place[1], place[0] + extent.width + size, place[1] + extent.height))
        text.set_position((place[0] - x, place[1] + extent.height / 2 - y))
        nearest = np.clip((x, y), place, (place[0] + extent.width, place[1] + extent.height))
        if np.hypot(*(nearest - (x, y))) > 3.0 * size:
            ends = axes.transData.inverted().transform([(x, y), nearest])
            axes.plot(*ends.T, color=colour(row.method, methods), lw=0.6, alpha=0.7, zorder=2)


def _free_place(x, y, width, height, frame, taken, gap) -> tuple[float, float]:
    """The lower left corner of the nearest free place for a box of this size beside (x, y)."""
    best, least = (x + gap, y - height / 2), np.inf
    for ring in range(40):
        far = gap + ring * height * 0.35
        for angle in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False):
            dx, dy = np.cos(angle), np.sin(angle)
            left = x + far * dx - width * (1.0 - dx) / 2.0
            low = y + far * dy - height / 2.0
            inside = frame.x0 <= left and left + width <= frame.x1 and frame.y0 <= low and low + height <= frame.y1
            overlap = sum(
                max(0.0, min(left + width, b[2]) - max(left, b[0])) * max(0.0, min(low + height, b[3]) - max(low, b[1]))
                for b in taken
            )
            if inside and overlap == 0.0:
                return left, low
            if inside and overlap < least:
                best, least = (left, low), overlap
    return best


def draw_growth(grown: Sequence[Growth], path: Path, dpi: int = 100) -> None:
    """A step's p50 over the tool's radius and over the grid's side."""
    figure, panels = plt.subplots(1, 2, figsize=(13.0, 5.0), layout="constrained", sharey=True)
    names = {"tool": "the tool's radius in 128³, voxels", "grid": "the grid's side with a tool of R = 8, voxels"}
    methods = list(dict.fromkeys(one.method for one in grown))
    for axes, (kind, name) in zip(panels, names.items()):
        for method, setting in dict.fromkeys((one.method, one.setting) for one in grown):
            own = [g for g in grown if (g.method, g.setting, g.kind) == (method, setting, kind)]
            at, times = [g.at for g in own], [g.outcome.p50 for g in own]
            style = {"color": colour(method, methods), "ls": "--" if setting == "numpy" else "-"}
            axes.plot(at, times, marker="o", ms=4, label=f"{method}, {setting}", **style)
        axes.set(xscale="log", yscale="log", xlabel=name, xticks=sorted({g.at for g in grown if g.kind == kind}))
        axes.grid(True, which="major", lw=0.4, alpha=0.4)
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panels[0].set(ylabel="milliseconds a step, p50")
    panels[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panels[1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    save(figure, path, dpi)
