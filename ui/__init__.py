# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist sees of Repoussé."""

from importlib import import_module

_MODULES = (
    "preferences",
    "plots",
    "presets",
    "panel",  # the parent of those that follow
    "material_panel",
    "brush_panel",
    "view_panel",
    "stress_panel",
    "strokes_panel",
    "arm_panel",
    "live_view",
    "cursor",
    "tool",
)


def register():
    for module in _MODULES:
        import_module(f".{module}", __package__).register()


def unregister():
    for module in reversed(_MODULES):
        import_module(f".{module}", __package__).unregister()
