# SPDX-License-Identifier: GPL-3.0-or-later
"""How a module of this package is run by a Python of its own, from wherever Blender keeps the extension.

The subprocess is isolated (-I): no user's site, no environment. It is told where this package and hidapi are, so no
search path is changed, and gets all else as one line of JSON: nothing is unpickled.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

# As a package of its own name, for the extension's other parts are not wanted in the subprocess.
_BOOT = """
import importlib, importlib.util, sys
folder, module = sys.argv[1:3]
spec = importlib.util.spec_from_file_location(
    "repousse_device", folder + "/__init__.py", submodule_search_locations=[folder]
)
sys.modules["repousse_device"] = package = importlib.util.module_from_spec(spec)
spec.loader.exec_module(package)
sys.exit(importlib.import_module("repousse_device." + module).main())
"""

HIDAPI = ("hidraw", "hid")
"""The modules of the hidapi wheel, the better first. On Linux ``hidraw`` goes through the kernel's own HID driver and
``hid`` through libusb, which takes the device away from it; elsewhere there is only ``hid``."""


def command(module: str) -> list[str]:
    """The command line that runs ``module`` of this package: its ``main()``."""
    return [sys.executable, "-I", "-B", "-c", _BOOT, str(Path(__file__).resolve().parent), module]


def start(module: str, config: dict[str, Any], **options: Any) -> subprocess.Popen[str]:
    """Start ``module`` and hand it ``config``; its stdin stays open, and its end means that we are gone.

    Raises OSError when there is no Python to start.
    """
    pipe = subprocess.PIPE
    options["creationflags"] = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # on Windows a console would flash up
    process = subprocess.Popen(command(module), stdin=pipe, stdout=pipe, stderr=pipe, text=True, **options)
    assert process.stdin is not None
    try:
        process.stdin.write(json.dumps(config) + "\n")
        process.stdin.flush()
    except OSError:  # it has ended already; what it said is still to be read
        pass
    return process


def read_config() -> dict[str, Any]:
    """What :func:`start` handed over, in the subprocess. Raises ValueError when it is not a line of JSON."""
    config = json.loads(sys.stdin.readline())
    if not isinstance(config, dict):
        raise ValueError("the configuration is not a JSON object")
    return config


def find_hidapi() -> list[str] | None:
    """Name and file of the hidapi module that Blender installed with the extension; None when there is none."""
    for name in HIDAPI:
        found = importlib.util.find_spec(name)
        if found is not None and found.origin:
            return [name, found.origin]
    return None


def load_hidapi(name: str, origin: str) -> ModuleType:
    """The module that :func:`find_hidapi` found, in the subprocess. Raises ImportError."""
    spec = importlib.util.spec_from_file_location(name, origin)
    if name not in HIDAPI or spec is None or spec.loader is None:
        raise ImportError(f"{origin}: is not hidapi")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
