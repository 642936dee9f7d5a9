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
class _Wanted:
    key: Hashable
    make: Callable[[], np.ndarray]


class _Pictures:
    """What is shown, and what is to be shown instead, by the name of the plot."""

    def __init__(self) -> None:
        self.previews = bpy.utils.previews.new()
        self.shown: dict[str, Hashable] = {}
        self.wanted: dict[str, _Wanted] = {}

    def icon(self, name: str, wanted: _Wanted) -> int:
        """The icon of the newest picture of this name, 0 while there is none; asks for another where it is old."""
        if self.shown.get(name) != wanted.key:
            self.wanted[name] = wanted
            if not bpy.app.timers.is_registered(make_wanted):
                bpy.app.timers.register(make_wanted, first_interval=INTERVAL)
        return self.previews[name].icon_id if name in self.shown else 0

    def make(self) -> bool:
        """Draw what is wanted. Returns whether anything was."""
        changed = bool(self.wanted)
        while self.wanted:
            name, wanted = self.wanted.popitem()
            preview = self.previews[name] if name in self.previews else self.previews.new(name)
            preview.image_size = SIDE, SIDE
            preview.image_pixels_float.foreach_set(np.ascontiguousarray(wanted.make(), np.float32).ravel())
            self.shown[name] = wanted.key
        return changed


_pictures: _Pictures | None = None


def histogram_icon(counts: Sequence[float], level: float) -> int:
    """Icon of a histogram, with the densities that are not seen at this visible ``level`` greyed; 0 until it is made.

    ``counts`` are voxels by density (core/histogram.py).
    """
    ink, counts = _ink(), tuple(counts)
    key = (counts, round(level, 3), ink)
    return _pictures.icon("histogram", _Wanted(key, lambda: histogram_picture(counts, level, ink)))


def stress_icon(trace: Trace) -> int:
    """Icon of stress and yield stress (N) against depth (voxels); 0 until it is made.

    ``trace`` may still grow: rows of (depth, stress, yield stress).
    """
    ink, count = _ink(), len(trace)
    key = (id(trace), count, trace[-1] if count else None, ink)
    return _pictures.icon("stress", _Wanted(key, lambda: stress_picture(trace[:count], ink)))


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


def stress_picture(trace: Trace, ink: Colour) -> np.ndarray:
    """(SIDE, SIDE, 4), first row at the bottom: the paper's figure 1, loading and unloading of one stroke."""
    picture = _sheet(ink)
    points = np.array(trace[:: 1 + len(trace) // MOST_POINTS], np.float64).reshape(-1, 3)
    if len(points) < 2:
        return picture
    depth, stress, yielding = points.T
    first, last = depth.min(), max(depth.max(), depth.min() + 1e-9)
    highest = max(stress.max(), yielding.max(), 1e-9)
    scale = SIDE - 1 - 2 * MARGIN
    across = MARGIN + (depth - first) / (last - first) * scale
    for curve, colour, width in ((yielding, YIELD, 1.2), (stress, STRESS, 2.0)):
        _line(picture, across, MARGIN + curve / highest * scale, colour, width)
    return picture


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
    cover = cover.reshape(SIDE, SIDE, 1)
    picture[..., :3] += cover * (np.array(colour, np.float32) - picture[..., :3])
    picture[..., 3:] = np.maximum(picture[..., 3:], cover)


def _ink() -> Colour:
    """The colour in which the panel writes."""
    red, green, blue = bpy.context.preferences.themes[0].user_interface.wcol_regular.text
    return round(red, 3), round(green, 3), round(blue, 3)


def make_wanted() -> None:
    """Make the pictures that were asked for while drawing, and let the sidebars show them."""
    if _pictures is None or not _pictures.make():
        return
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in {"VIEW_3D", "PROPERTIES"}:
                area.tag_redraw()


def register():
    global _pictures
    _pictures = _Pictures()


def unregister():
    global _pictures
    if bpy.app.timers.is_registered(make_wanted):
        bpy.app.timers.unregister(make_wanted)
    bpy.utils.previews.remove(_pictures.previews)
    _pictures = None
