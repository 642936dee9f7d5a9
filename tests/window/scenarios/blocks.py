# SPDX-License-Identifier: GPL-3.0-or-later
"""Making clay, and taking that back by keys."""

import bpy

from ..clay import RESOLUTION, in_file, new_block
from ..scenario import Steps, scenario
from ..window import THREE_QUARTERS, Window


@scenario()
def a_new_block_is_undone_and_redone(window: Window) -> Steps:
    new_block(window)
    yield from window.look(THREE_QUARTERS)
    before = in_file(bpy.context.object).density.copy()
    yield from window.move(window.pixel((0, 0, 0)))
    yield from window.tap("Z", "LEFT_CTRL")
    yield from window.until(lambda: not bpy.data.objects, "the block to go")
    yield from window.tap("Z", "LEFT_CTRL", "LEFT_SHIFT")
    yield from window.until(lambda: len(bpy.data.objects) == 1, "the block to come back")
    assert (in_file(bpy.data.objects[0]).density == before).all()
    assert before.shape == (RESOLUTION,) * 3
