# SPDX-License-Identifier: GPL-3.0-or-later
"""Figure 5: a tree sculpted from a block by recorded strokes, replayed from their files."""

from __future__ import annotations

import matplotlib.pyplot as plt
import tree
from drawing import View, save, show, surface
from tqdm import tqdm

from repousse.core import DensityGrid

LEVEL = 0.28
STAGES = {"round": "room around the trunk", "crown": "the crown"}
"""Kinds of strokes after the last of which the block is shown."""
VIEW = View(azimuth=35, elevation=13, size=300, across=186, centre=(63.5, 63.5, 71.0))


def sculpt() -> tuple[DensityGrid, list, dict[str, int | float]]:
    """Replay all strokes: the grid at the end, (title, density) of the stages before it, and sums over the strokes."""
    grid = tree.block()
    mass, out = grid.mass, 0.0
    stages, strokes, poses, former, before = [("a block", grid.density.copy())], 0, 0, "", None
    for name, stroke, contacts in tqdm(
        tree.replay(grid), total=len(list(tree.STROKES.glob("tree-*.jsonl"))), unit="stroke", leave=False, disable=None
    ):
        kind = name.split("-")[2]
        if kind != former and former in STAGES:
            stages.append((f"{strokes} strokes: {STAGES[former]}", before))
        former, before = kind, grid.density.copy()
        strokes, poses = strokes + 1, poses + len(stroke.samples)
        out += sum(contact.mass_out for contact in contacts)
    return grid, stages, {"strokes": strokes, "poses": poses, "mass": mass, "out": out}


def draw(path) -> None:
    grid, stages, sums = sculpt()
    figure = plt.figure(figsize=(11.4, 8.2), layout="constrained")
    places = figure.subplot_mosaic([["0", "end"], ["1", "end"], ["2", "end"]], width_ratios=[1, 3])
    for number, (title, density) in enumerate(stages):
        show(places[str(number)], surface(density, VIEW, LEVEL), title)
    large = View(VIEW.azimuth, VIEW.elevation, 760, 182, VIEW.centre)
    show(places["end"], surface(grid.density, large, LEVEL), f"{sums['strokes']} strokes, {sums['poses']:,} poses")
    figure.suptitle(
        "A tree sculpted from a block and kept as strokes: nothing was cut, what is gone was pushed over the border\n"
        f"mass {sums['mass']:,.1f} in the block, {grid.mass:,.1f} left and {sums['out']:,.1f} counted out",
        fontsize=11,
    )
    save(figure, path)
