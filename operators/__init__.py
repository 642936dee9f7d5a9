# SPDX-License-Identifier: GPL-3.0-or-later
"""What Repoussé does in Blender, one file a verb, and the headless door. Imports no bpy: the door opens fast."""

from importlib import import_module

_MODULES = (
    "volumes",  # what the verbs share comes first
    "settings",
    "session",
    "handlers",
    "arm_session",
    "import_volume",
    "new_clay_block",
    "mesh_to_clay",
    "replay_stroke",
    "strokes",
    "resample_volume",
    "automatic_level",
    "sculpt",
    "hover",
    "export_vdb",
    "arm_devices",
    "arm_verbs",
    "command",
)


def register():
    for module in _MODULES:
        import_module(f".{module}", __package__).register()


def unregister():
    for module in reversed(_MODULES):
        import_module(f".{module}", __package__).unregister()
