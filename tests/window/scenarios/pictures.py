# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures for the README, made with make bench: copy out/window/sculpting.png to tests/pictures."""

import bpy

from ..clay import new_slab
from ..scenario import Steps, scenario
from ..sculpting import begin, end, ready, stroke
from ..window import THREE_QUARTERS, Window


@scenario(limit=120.0, kind="figures")
def sculpting(window: Window) -> Steps:
    """A groove, a ridge, and the tool in the middle of a stroke."""
    new_slab(window, 128)
    bpy.context.scene.render.preview_pixel_size = "1"
    yield from ready(window, THREE_QUARTERS, target=(0.0, 0.0, -0.2), distance=2.9, record=False, radius=36)
    yield from stroke(window, (-0.5, 0.42, 0.0), (0.45, 0.42, 0.0), moves=30)
    yield from stroke(window, (-0.45, 0.02, 0.0), (0.45, 0.02, 0.0), "LEFT_CTRL", moves=30)
    yield from begin(window, (-0.45, -0.42, 0.0))
    yield from window.drag_to(window.pixel((0.25, -0.38, 0.0)), 20)
    yield from window.drawn()
    yield from window.picture()
    yield from end(window)
