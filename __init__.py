# SPDX-License-Identifier: GPL-3.0-or-later
"""Repoussé: push a tool into a volume that yields, hardens and pushes back. A Blender extension."""

from importlib import import_module

_PARTS = ("operators", "ui")  # ui shows operators


def register():
    for part in _PARTS:
        import_module(f".{part}", __package__).register()


def unregister():
    for part in reversed(_PARTS):
        import_module(f".{part}", __package__).unregister()
