# SPDX-License-Identifier: GPL-3.0-or-later
"""The map as pictures: limits against theory, what fails where, and a failure beside its cure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap

from repousse.device.limits import PERIOD

from ..drawing import INK, save
from . import theory
from .cells import GUARDS, JITTERS, LATENCIES, PERIODS, Row
from .collision import Timing
from .couplings import Coupled, Coupling
from .naive import BoundByAge
from .scenes import DEVICES, HANDS, MS, at_wall

COLOURS = {"hold": "#b06d00", "interpolate": "#c8432b", "local": "#2d8f57", "in_loop": "#2a7ab8"}
NAMES = {
    "hold": "hold",
    "interpolate": "interpolate (the paper's)",
    "local": "local (the default)",
    "in_loop": "in the loop, on a shared grid",
}
RESTS, FAILS = "#bfe3cd", "#c8432b"


def draw_all(rows: Sequence[Row], folder: Path) -> None:
    """Three pictures."""
    limits(rows, folder / "stability-limits.png")
    the_map(rows, folder / "stability-map.png")
    cure(folder / "stability-cure.png")


def limits(rows: Sequence[Row], path: Path) -> None:
    """The stiffest wall that comes to rest against the collision's period: dots measured, lines by theory."""
    figure, panels = plt.subplots(2, 2, figsize=(11.0, 8.0), sharex=True, sharey=True, layout="constrained")
    for line, latency in zip(panels, (0.0, 1.0), strict=True):
        for axes, hand in zip(line, HANDS, strict=True):
            _limits(axes, rows, hand, latency)
            late = f"{latency:g} period late" if latency else "at once"
            axes.set_title(f"{hand} hand, models {late}")
    for axes in panels[-1]:
        axes.set_xlabel("from one model to the next, ms")
    for axes in panels[:, 0]:
        axes.set_ylabel("stiffest wall that comes to rest, N/m")
    panels[0, 0].legend(loc="lower left", fontsize=7.5)
    save(figure, path)


def _limits(axes, rows: Sequence[Row], hand: str, latency: float) -> None:
    damping = HANDS[hand].damping + DEVICES[0].mechanics.damping
    for name, colour in COLOURS.items():
        here = [
            row
            for row in rows
            if (row.coupling, row.guard, row.hand, row.jitter_ms) == (name, "none", hand, 0.0)
            and row.latency_ms == latency * row.collision_ms
            and row.k_asked == DEVICES[0].stiffness
        ]
        times = [row.collision_ms for row in here]
        marker = "o" if name != "in_loop" else "x"
        axes.plot(times, [row.k_max for row in here], marker, color=colour, ms=5, label=NAMES[name])
        axes.plot(times, [row.k_theory for row in here], color=colour, lw=1.0)
        if name in ("hold", "interpolate"):
            rule = [theory.rule(Coupling(name), damping, Timing(t * MS, latency * t * MS)) for t in times]
            axes.plot(times, rule, color=colour, lw=0.9, ls=":")
    for device in DEVICES:
        axes.axhline(device.stiffness, color=INK, lw=0.7, ls="--")
        axes.annotate(
            f"{device.name}, {device.stiffness:g}",
            (33.0, device.stiffness),
            (0, 2),
            fontsize=7.5,
            textcoords="offset points",
            ha="right",
        )
    axes.set(xscale="log", yscale="log", ylim=(20.0, 15000.0))
    axes.set_xticks(PERIODS, [f"{period:g}" for period in PERIODS], fontsize=7)
    axes.minorticks_off()


def the_map(rows: Sequence[Row], path: Path) -> None:
    """Every cell: green where the hand comes to rest, red where it does not, the darker the more it moves."""
    figure, panels = plt.subplots(len(COLOURS), len(GUARDS), figsize=(11.0, 10.0), layout="constrained")
    for line, coupling in zip(panels, COLOURS, strict=True):
        for axes, guard in zip(line, GUARDS, strict=True):
            here = [row for row in rows if (row.coupling, row.guard) == (coupling, guard)]
            failing = sum(row.fails for row in here)
            guarded = "" if guard == "none" else ", guarded"
            axes.set_title(f"{NAMES[coupling]}{guarded}: {failing} of {len(here)} fail", fontsize=9.5)
            _panel(axes, here)
    for axes in panels[-1]:
        axes.set_xlabel("from one model to the next, ms; in each, late by none, half and all of it", fontsize=8)
    save(figure, path)


def _panel(axes, rows: Sequence[Row]) -> None:
    ups = [(device, hand, jitter) for device in DEVICES for hand in HANDS for jitter in JITTERS]
    values = np.zeros((len(ups), len(PERIODS) * len(LATENCIES)))
    for row in rows:
        latency = LATENCIES.index(round(row.latency_ms / row.collision_ms, 3))
        jitter = round(row.jitter_ms / row.collision_ms, 3)
        x = PERIODS.index(row.collision_ms) * len(LATENCIES) + latency
        y = ups.index((row.cell.device, row.hand, jitter))
        values[y, x] = np.log10(row.peak_to_peak_mm * MS / row.cell.device.mechanics.encoder) if row.fails else -1.0
    shades = plt.get_cmap("Reds")(np.linspace(0.45, 1.0, 9))
    axes.imshow(values, cmap=ListedColormap([RESTS, *shades]), vmin=-0.4, vmax=3.6, aspect="auto")
    axes.set_xticks(np.arange(1, values.shape[1], 3), [f"{period:g}" for period in PERIODS], fontsize=8)
    each = len(HANDS) * len(JITTERS)
    names = [f"{device.stiffness:.0f} {hand}" for device in DEVICES for hand in HANDS]
    axes.set_yticks(np.arange(0.5, len(ups), len(JITTERS)), names, fontsize=7)
    for edge in range(3, values.shape[1], 3):
        axes.axvline(edge - 0.5, color="white", lw=1.2)
    for edge in range(each, len(ups), each):
        axes.axhline(edge - 0.5, color="white", lw=1.2)


FAILURE = Timing(20.0 * MS, 10.0 * MS)
"""A model each 20 ms that is 10 ms late: up to 30 ms old."""


def cure(path: Path) -> None:
    """One press, three times: interpolated, bounded by age as it was, and as it is now."""
    device, hand = DEVICES[1], HANDS["soft"]
    figure, panels = plt.subplots(3, 3, figsize=(11.0, 6.4), sharex=True, sharey="row", layout="constrained")
    columns = (
        ("the paper's: between the last two", Coupling.INTERPOLATE, Coupled),
        ("local, bounded by age: as it was", Coupling.LOCAL, BoundByAge),
        ("local, with a surface that is known", Coupling.LOCAL, Coupled),
    )
    for (title, coupling, coupled), (place, force, slope) in zip(columns, panels.T, strict=True):
        trace = at_wall(device, hand, FAILURE, coupling, coupled=coupled).run(1.5)
        time = trace.time
        place.plot(time, 1e3 * trace.height, color=INK, lw=0.9)
        place.axhline(0.0, color=INK, lw=0.6, ls=":")
        place.set_title(title)
        force.plot(time, trace.force[:, 2], color="#c8432b", lw=0.9)
        slope.plot(time, [moment.granted for moment in trace.moments], color="#2a7ab8", lw=0.9)
        slope.set_xlabel("seconds")
    panels[0, 0].set_ylabel("tip, mm")
    panels[1, 0].set_ylabel("force, N")
    panels[2, 0].set_ylabel("slope granted, N/m")
    oldest = 1e3 * (FAILURE.period + FAILURE.latency)
    figure.suptitle(
        f"A soft hand comes down on {device.stiffness:g} N/m; models up to {oldest:g} ms old, the loop's period "
        f"{1e3 * PERIOD:g} ms",
        fontsize=10.5,
    )
    save(figure, path)
