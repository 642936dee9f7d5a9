# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist sees of Repoussé."""

from importlib import import_module

_MODULES = ("panel",)


def register():
    for module in _MODULES:
        import_module(f".{module}", __package__).register()


def unregister():
    for module in reversed(_MODULES):
        import_module(f".{module}", __package__).unregister()
