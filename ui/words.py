# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences in a layout: Blender's labels are one line, and cut what does not fit."""

from __future__ import annotations

from textwrap import wrap

import bpy

CHARACTER = 6.5
"""Mean width of a character of Blender's font in pixels, with a user interface of the usual size."""
MARGIN = 60.0
"""Pixels of a region that a label does not have: panel, box, icon and scroll bar."""
FEWEST = 16


def characters_in(context: bpy.types.Context) -> int:
    """How many characters of a label can be seen in the region that is drawn."""
    scale = context.preferences.system.ui_scale or 1.0  # 0 without a window
    width = context.region.width / scale if context.region is not None else 0.0
    return max(FEWEST, int((width - MARGIN) / CHARACTER))


def draw_text(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE") -> None:
    """A text of any length, as many labels as it needs, the first with the icon. ``text`` is translated already."""
    column = layout.column(align=True)
    column.scale_y = 0.85
    for number, line in enumerate(wrap(text, characters_in(context))):
        column.label(text=line, icon=icon if number == 0 or icon == "NONE" else "BLANK1", translate=False)
