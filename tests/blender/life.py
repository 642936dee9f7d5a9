# SPDX-License-Identifier: GPL-3.0-or-later
"""A script for a Blender of its own: install a zip, enable and disable it twice, write what each round did as JSON.

The last two arguments are the zip and the JSON file.
"""

import importlib
import json
import sys
import threading
from pathlib import Path

import bpy

# isort: split
import addon_utils  # importable once bpy is

ADDON = "bl_ext.user_default.repousse"


def name_of(function):
    return f"{function.__module__}.{function.__qualname__}"


def snapshot():
    """All that an add-on can add to Blender and that Blender can list: strings, by kind."""
    types = {name: getattr(bpy.types, name) for name in dir(bpy.types) if not name.startswith("_")}
    keyconfigs = bpy.context.window_manager.keyconfigs
    return {
        "types": set(types),
        "properties": {
            f"{name}.{key}"
            for name, kind in types.items()
            if hasattr(kind, "bl_rna")
            for key, _ in kind.bl_rna.properties.items()
        },
        "draw functions": {
            f"{name}: {name_of(function)}"
            for name, kind in types.items()
            for function in getattr(getattr(kind, "draw", None), "_draw_funcs", ())
            if function.__qualname__ != f"{name}.draw"  # Blender lists a menu's own once any was appended
        },
        "handlers": {
            f"{name}: {name_of(function)}"
            for name in dir(bpy.app.handlers)
            if isinstance(functions := getattr(bpy.app.handlers, name), list)
            for function in functions
        },
        "keymap items": {
            f"{config.name} {keymap.name} {item.idname} {item.to_string()}"
            for config in keyconfigs
            for keymap in config.keymaps
            for item in keymap.keymap_items
        },
        "data": {
            f"{name}: {block.name}"
            for name in dir(bpy.data)
            if isinstance(blocks := getattr(bpy.data, name), bpy.types.bpy_prop_collection)
            for block in blocks
        },
        "threads": {thread.name for thread in threading.enumerate()},
        "import hooks": {repr(finder) for finder in sys.meta_path},
    }


def difference(after, before):
    """What is in one snapshot and not in the other, leaving out kinds that are the same."""
    return {kind: sorted(after[kind] - before[kind]) for kind in after if after[kind] - before[kind]}


def main():
    extension, report = sys.argv[-2:]
    installed = bpy.ops.extensions.package_install_files(
        filepath=extension, repo="user_default", enable_on_install=False
    )
    assert installed == {"FINISHED"}, installed
    before = snapshot()
    rounds = []
    for _ in range(2):
        enabled = addon_utils.enable(ADDON, default_set=True) is not None
        during = snapshot()
        kernels = importlib.import_module(f"{ADDON}.core.native").name()
        importlib.import_module("hid")
        wheels = Path(bpy.utils.user_resource("EXTENSIONS", path=".local")).glob("lib/python*/site-packages/*")
        unpacked = sorted({path.name.partition(".")[0] for path in wheels})
        addon_utils.disable(ADDON, default_set=True)
        after = snapshot()
        rounds.append(
            {
                "enabled": enabled,
                "kernels": kernels,
                "unpacked": unpacked,
                "added": difference(during, before),
                "left": difference(after, before),
                "taken": difference(before, after),
            }
        )
    with open(report, "w", encoding="utf-8") as file:
        json.dump(rounds, file, indent=1)


main()
