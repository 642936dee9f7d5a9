# SPDX-License-Identifier: GPL-3.0-or-later
"""How the time of a step grows with the tool and with the grid: the first four voxels of a press, in blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from . import scenes
from .measure import Outcome, Request, measure
from .method import Scene

RADII, GRIDS = (8, 16, 32), (64, 128, 256)
SIDE, RADIUS, DEPTH = 128, 8.0, 4.0
"""The grid for all tools, the tool for all grids, and how deep: voxels."""
CRUSHABLE, PACKED = 0.5, 1.0
BUDGET, REPEATED = 6.0, 0.25
GROWN = (
    ("carve", "carve", "remove only", CRUSHABLE),
    ("sweep", "sweep", "compiled", CRUSHABLE),
    ("sweep", "sweep", "numpy", CRUSHABLE),
    ("coarse", "coarse sweep", "half the resolution", CRUSHABLE),
    ("sweep", "sweep + rim", "compiled", PACKED),
)
"""Module, method, setting, and the density of the block that it is pressed into; packed blocks have a band R ahead."""


def block(side: int, radius: float, density: float) -> Scene:
    """Two thirds of a grid full, pressed in the middle of its face."""
    band = radius if density == PACKED else None
    return scenes.press(side, 2 * side // 3, side - 2 * side // 3, radius, DEPTH, density, 0.05, band)


@dataclass(frozen=True)
class Growth:
    """A method's steps with a tool of ``at`` voxels radius (``kind`` "tool"), or in a grid of ``at``^3 ("grid")."""

    method: str
    setting: str
    kind: str
    at: int
    outcome: Outcome


def grow(grown: Sequence[tuple[str, str, str, float]], step: Callable[[str], None]) -> Iterator[Growth]:
    """All methods over all tools and grids; ``step`` is told of each before it begins."""
    for module, name, setting, density in grown:
        for kind, sizes in (("tool", RADII), ("grid", GRIDS)):
            for size in sizes:
                step(f"growth: {name}, {kind} {size}")
                scene = block(SIDE, size, density) if kind == "tool" else block(size, RADIUS, density)
                outcome = measure(Request(module, name, setting, BUDGET, REPEATED), scene)
                yield Growth(name, setting, kind, size, outcome)
