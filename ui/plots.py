# SPDX-License-Identifier: GPL-3.0-or-later
"""Small plots in the panel: how much of a volume has which density, and the stress against depth of a stroke.

A picture is made when what it shows has changed, by a timer and not while Blender draws, and is kept until then.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import bpy
import bpy.utils.previews
import numpy as np

SIDE = 256
"""Width and height of a picture in pixels: Blender scales it to the panel."""
MARGIN = 10
MOST_POINTS = 2048
"""Points of a curve that are drawn, at most: several to each column."""
INTERVAL = 0.1
"""Seconds from a change to its picture: a stroke changes its own a thousand times a second."""
STRESS = (1.0, 0.55, 0.15)
YIELD = (0.30, 0.62, 1.0)
HIDDEN = (0.45, 0.45, 0.45)

Colour = tuple[float, float, float]
Trace = Sequence[tuple[float, float, float]]


@dataclass(frozen=True)
class Plot:
    """A picture as an icon of Blender's, 0 while there is none yet; how far its two axes go from their origin."""

    icon: int = 0
    across: float = 0.0
    up: float = 0.0


@dataclass
class _Slot:
    """What one plot shows, and what it is to show instead."""

    preview: bpy.types.ImagePreview
    shown: Hashable = None
    plot: Plot = Plot()
    wanted: Hashable = None
    make: Callable[[], tuple[np.ndarray, float, float]] | None = None


_previews = None
_slots: dict[str, _Slot] = {}


def histogram_plot(counts: Sequence[float], level: float) -> Plot:
    """Voxels by density (core/histogram.py); densities that are not seen at the visible ``level`` are grey."""
    ink, counts = _ink(), tuple(counts)
    key = (counts, round(level, 3), ink)
    return _plot("histogram", key, lambda: (histogram_picture(counts, level, ink), 1.0, max(counts)))


def stress_plot(trace: Trace) -> Plot:
    """Stress and yield stress in N, up, against depth in voxels, across: rows of a ``trace`` that may still grow."""
    ink, count = _ink(), len(trace)
    key = (id(trace), trace[-1] if count else None, count, ink)
    return _plot("stress", key, lambda: stress_picture(trace[:count], ink))


def _plot(name: str, key: Hashable, make: Callable[[], tuple[np.ndarray, float, float]]) -> Plot:
    """The newest plot of this name; where it is not the one of this key, that is made soon."""
    if name not in _slots:
        _slots[name] = _Slot(_previews.new(name))
    slot = _slots[name]
    if slot.shown != key:
        slot.wanted, slot.make = key, make
        if not bpy.app.timers.is_registered(make_wanted):
            bpy.app.timers.register(make_wanted, first_interval=INTERVAL)
    return slot.plot


def make_wanted() -> None:
    """Make the plots that were asked for while drawing, and let the panels show them."""
    made = [slot for slot in _slots.values() if slot.make is not None]
    for slot in made:
        picture, across, up = slot.make()
        slot.preview.image_size = SIDE, SIDE
        picture[..., :3] *= picture[..., 3:]  # an icon's colours are to be multiplied by its alpha
        slot.preview.image_pixels_float.foreach_set(picture.ravel())
        slot.shown, slot.make = slot.wanted, None
        slot.plot = Plot(slot.preview.icon_id, across, up)
    for window in bpy.context.window_manager.windows if made else ():
        for area in window.screen.areas:
            for region in area.regions:
                if area.type == "VIEW_3D" and region.type == "UI":
                    region.tag_redraw()


def histogram_picture(counts: Sequence[float], level: float, ink: Colour) -> np.ndarray:
    """(SIDE, SIDE, 4), first row at the bottom: a column for each bin, as high as the logarithm of its count."""
    picture = _sheet(ink)
    counts = np.asarray(counts, np.float64)
    heights = np.log1p(counts) / max(np.log1p(counts.max(initial=0.0)), 1e-9)
    inner = SIDE - 2 * MARGIN
    edges = MARGIN + np.rint(np.linspace(0, inner, len(counts) + 1)).astype(int)
    for n, height in enumerate(heights):
        seen = (n + 1) / len(counts) > level
        top = MARGIN + round(height * inner)
        picture[MARGIN:top, edges[n] : edges[n + 1] - 1] = (*(STRESS if seen else HIDDEN), 1.0)
    at = MARGIN + round(min(max(level, 0.0), 1.0) * inner)
    picture[MARGIN : SIDE - MARGIN, at - 1 : at + 1] = (*ink, 1.0)
    return picture


def stress_picture(trace: Trace, ink: Colour) -> tuple[np.ndarray, float, float]:
    """The paper's figure 1, loading and unloading of one stroke: (SIDE, SIDE, 4), first row at the bottom.

    Then how many voxels it is wide, and how many newtons high.
    """
    picture = _sheet(ink)
    points = np.array(trace[:: 1 + len(trace) // MOST_POINTS], np.float64).reshape(-1, 3)
    if len(points) < 2:
        return picture, 0.0, 0.0
    depth, stress, yielding = points.T
    first, last = depth.min(), max(depth.max(), depth.min() + 1e-9)
    highest = max(stress.max(), yielding.max(), 1e-9)
    scale = SIDE - 1 - 2 * MARGIN
    across = MARGIN + (depth - first) / (last - first) * scale
    for curve, colour, width in ((yielding, YIELD, 1.2), (stress, STRESS, 2.0)):
        _line(picture, across, MARGIN + curve / highest * scale, colour, width)
    return picture, float(last - first), float(highest)


def _sheet(ink: Colour) -> np.ndarray:
    """Nothing but the two axes."""
    picture = np.zeros((SIDE, SIDE, 4), np.float32)
    picture[..., :3] = ink
    picture[MARGIN - 2 : MARGIN, MARGIN - 2 : SIDE - MARGIN, 3] = 0.5
    picture[MARGIN - 2 : SIDE - MARGIN, MARGIN - 2 : MARGIN, 3] = 0.5
    return picture


def _line(picture: np.ndarray, x: np.ndarray, y: np.ndarray, colour: Colour, width: float) -> None:
    """Draw through points given in pixels, ``width`` to either side, with smooth edges."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    steps = np.linspace(0.0, way[-1], int(way[-1]) + 2)
    x, y = np.interp(steps, way, x), np.interp(steps, way, y)
    cover = np.zeros(SIDE * SIDE, np.float32)
    around = np.arange(-int(width + 1.0), int(width + 1.0) + 1)
    rows = np.rint(y).astype(int)[:, None, None] + around[:, None]
    columns = np.rint(x).astype(int)[:, None, None] + around
    away = np.hypot(rows - y[:, None, None], columns - x[:, None, None])
    share = np.clip(width + 0.5 - away, 0.0, 1.0).astype(np.float32)
    np.maximum.at(cover, (rows * SIDE + columns).ravel(), share.ravel())  # the margin has room for the whole width
    pixels = picture.reshape(-1, 4)
    at = np.flatnonzero(cover)
    part = cover[at, None]
    pixels[at, :3] += part * (np.array(colour, np.float32) - pixels[at, :3])
    pixels[at, 3:] = np.maximum(pixels[at, 3:], part)


def _ink() -> Colour:
    """The colour in which the panel writes."""
    red, green, blue = bpy.context.preferences.themes[0].user_interface.wcol_regular.text
    return round(red, 3), round(green, 3), round(blue, 3)


def register():
    global _previews
    _previews = bpy.utils.previews.new()


def unregister():
    if bpy.app.timers.is_registered(make_wanted):
        bpy.app.timers.unregister(make_wanted)
    _slots.clear()
    bpy.utils.previews.remove(_previews)
