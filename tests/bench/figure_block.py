# SPDX-License-Identifier: GPL-3.0-or-later
"""Figure 6: a push along Z right through a block of 128^3 voxels of uniform density, as fog and in section."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from drawing import View, fog, save, show

from repousse.core import DensityGrid, Material, Push, SphereTool

SIDE, DENSITY, RADIUS = 128, 0.3, 16.0
FOG_LENGTH = 16.0
"""Voxels of density d that are as opaque as d says: with one voxel nothing behind the block's skin would be seen."""
STOPS = (-8.0, 24.0, 64.0, 104.0, 156.0)
"""Depths of the tool's tip in voxels at which the block is shown; at the last the tool has left the far side."""
ABOVE, BELOW = 48, 76
"""Voxels of space shown above and below the block."""


def run():
    """(depth, density on one common frame, mass) at each stop, and the mass at the start."""
    grid = DensityGrid(np.full((SIDE,) * 3, DENSITY, np.float32))
    push = Push(grid, SphereTool(RADIUS), Material(3.3, 0.05), border="grow")
    middle, before = (SIDE - 1) / 2, grid.mass
    shots, at = [], STOPS[0]
    for stop in STOPS:
        for depth in np.arange(at, stop + 1e-9, 0.5):
            push.move_to((middle, middle, SIDE - 0.5 - depth + RADIUS))
        at = stop
        shots.append((stop, _framed(push), push.grid.mass))
    return shots, before


def _framed(push: Push) -> np.ndarray:
    """The live grid on the frame that all pictures share: the block with space around it."""
    framed = np.zeros((SIDE + 16, SIDE + 16, SIDE + ABOVE + BELOW), np.float32)
    start = np.add(push.origin, (8, 8, BELOW))
    low = np.maximum(start, 0)
    high = np.minimum(start + push.grid.shape, framed.shape)
    part = push.grid.density[tuple(slice(a, b) for a, b in zip(low - start, high - start))]
    framed[tuple(slice(a, b) for a, b in zip(low, high))] = part
    return framed


def draw(path) -> None:
    shots, before = run()
    figure = plt.figure(figsize=(13.6, 7.6), layout="constrained", facecolor="#ffffff")
    rows = figure.subplots(2, len(shots), height_ratios=[1.0, 1.06])
    for (depth, density, _), seen, cut in zip(shots, rows[0], rows[1]):
        view = View(azimuth=38, elevation=18, size=380, across=232)
        show(seen, fog(density, view, FOG_LENGTH), "before" if depth < 0 else f"tip {depth:g} voxels down")
        image = cut.imshow(
            density[:, density.shape[1] // 2].T,
            origin="lower",
            cmap="gray",
            vmin=0.0,
            vmax=1.0,
            extent=(-8.5, SIDE + 7.5, -BELOW - 0.5, SIDE + ABOVE - 0.5),
        )
        cut.add_patch(
            plt.Circle(((SIDE - 1) / 2, SIDE - 0.5 - depth + RADIUS), RADIUS, fill=False, ec="#ffb000", lw=1.4)
        )
        cut.set(xlabel="x (voxels)", ylim=(-BELOW - 0.5, SIDE + ABOVE - 0.5))
        if cut is rows[1][0]:
            cut.set_ylabel("z (voxels)")
        else:
            cut.tick_params(labelleft=False)
    figure.colorbar(image, ax=rows[1], label="density", shrink=0.8, aspect=22, pad=0.01)
    figure.suptitle(
        f"A sphere of {2 * RADIUS:g} voxels pushed along -Z through {SIDE}³ voxels of density {DENSITY:g}: "
        f"grey is density, opacity is density over {FOG_LENGTH:g} voxels;\n"
        f"borders grow, and mass stays: {before:.1f} before, {shots[-1][2]:.1f} after",
        fontsize=11,
    )
    save(figure, path)
