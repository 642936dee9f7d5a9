# SPDX-License-Identifier: GPL-3.0-or-later
"""Figure 3: the four regimes, in sections through one real run, with the stresses of the whole of it."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from drawing import INK, REGIME_COLOURS, save
from matplotlib.patches import Circle

from repousse.core import DensityGrid, Material, Push, Regime, SphereTool

SIDE, SURFACE, DENSITY = 72, 42, 0.6
RADIUS, REACH = 10.0, 15.0
DEEPEST, STEP = 13.0, 0.125
SHOWN = {Regime.NONE: -2.0, Regime.ELASTIC: 3.0, Regime.PLASTIC: DEEPEST, Regime.UNLOADING: 9.5}
"""The depth of the tool's tip at which each regime is shown; the last on the way out."""


def draw(path) -> None:
    density = np.zeros((SIDE - 1, SIDE - 1, SIDE), np.float32)
    density[:, :, :SURFACE] = DENSITY
    push = Push(DensityGrid(density), SphereTool(RADIUS, REACH), Material(3.3, 0.25), border="wall")
    middle, face = (SIDE - 2) / 2, SURFACE - 0.5
    way = np.concatenate([np.arange(-3.0, DEEPEST, STEP), np.arange(DEEPEST, -3.0 - STEP, -STEP)])
    trace, pictures = [], {}
    for travelled, depth in enumerate(way):
        contact = push.move_to((middle, middle, face - depth + RADIUS))
        trace.append((travelled * STEP, contact))
        on_this_leg = (travelled * STEP > DEEPEST + 3.0) == (contact.regime is Regime.UNLOADING)
        if SHOWN[contact.regime] == depth and on_this_leg and contact.regime not in pictures:
            pictures[contact.regime] = (push.grid.density[:, SIDE // 2 - 1].copy(), depth, travelled * STEP, contact)

    figure = plt.figure(figsize=(11.6, 6.4), layout="constrained")
    places = figure.subplot_mosaic(
        [["none", "elastic", "plastic", "unloading"], ["trace"] * 4], height_ratios=[1.25, 1]
    )
    full = push.material.full_force
    for regime in SHOWN:
        image = _section(places[regime.value], *pictures[regime], middle, face, full)
    figure.colorbar(image, ax=[places[r.value] for r in SHOWN], label="density", shrink=0.85, pad=0.01, aspect=18)
    _trace(places["trace"], trace, pictures)
    save(figure, path)


def _section(axes, section, depth, travelled, contact, middle, face, full):
    image = axes.imshow(section.T, origin="lower", cmap="gray", vmin=0.0, vmax=1.0)
    height = face - depth + RADIUS
    axes.add_patch(Circle((middle, height), RADIUS, fill=False, lw=1.8, ec="#ffb000"))
    axes.add_patch(Circle((middle, height), REACH, fill=False, lw=1.2, ls="--", ec="#ffb000"))
    axes.axhline(face, color="#7fb4e6", lw=0.8, ls=":")
    force = contact.force[2] / full
    if force > 0.0:
        axes.annotate(
            "",
            (middle, height + 70.0 * force),
            (middle, height),
            arrowprops={"arrowstyle": "-|>", "color": "#58c4ff", "lw": 2.2},
        )
    axes.set(xlim=(3, SIDE - 5), ylim=(6, SIDE - 1), xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    colour = REGIME_COLOURS[contact.regime.value]
    axes.set_title(
        f"{contact.regime.value}\n$σ$ = {contact.stress:.3f} N, $σ_f$ = {contact.yield_stress:.3f} N", color=colour
    )
    return image


def _trace(axes, trace, pictures) -> None:
    travelled = np.array([t for t, _ in trace])
    stress = np.array([c.stress for _, c in trace])
    yield_stress = np.array([c.yield_stress for _, c in trace])
    force = np.array([np.linalg.norm(c.force) for _, c in trace])
    axes.plot(travelled, yield_stress, color=INK, lw=1.2, ls="--", label="$σ_f$, what the material bears")
    axes.plot(travelled, stress, color="#b06d00", lw=1.4, label="σ, what the tool asks")
    axes.plot(travelled, force, color="#1a1a1a", lw=4.0, alpha=0.18, label="force on the hand, min(σ, $σ_f$)")
    top = 1.12 * max(yield_stress.max(), stress.max())
    regimes = np.array([c.regime.value for _, c in trace])
    for regime, colour in REGIME_COLOURS.items():
        axes.fill_between(travelled, 0.0, top, where=regimes == regime, color=colour, alpha=0.10, lw=0, step="mid")
    for regime, (_, _, at, contact) in pictures.items():
        axes.plot(at, contact.stress, "o", color=REGIME_COLOURS[regime.value], ms=8, mec="white", zorder=5)
    axes.axvline(DEEPEST + 3.0, color=INK, lw=0.6, ls=":")
    axes.text(DEEPEST + 3.1, 0.02 * top, "the tool turns back", fontsize=8)
    axes.set(
        xlabel="travel of the tool (voxels): 16 in, then out", ylabel="newtons", ylim=(0, top), xlim=(0, travelled[-1])
    )
    axes.legend(loc="upper left", ncols=1)
