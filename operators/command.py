# SPDX-License-Identifier: GPL-3.0-or-later
"""`blender --command repousse ...`: the command line of `cli`, in a Blender without a window."""

import bpy

from . import cli

_registered = []


def register():
    _registered.append(bpy.utils.register_cli_command("repousse", cli.main))


def unregister():
    bpy.utils.unregister_cli_command(_registered.pop())
