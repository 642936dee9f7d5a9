# SPDX-License-Identifier: GPL-3.0-or-later
"""The inside of run.py, which starts Blender with this script: plays scenarios one after the other from a timer.

The last argument is JSON: the names of the scenarios to play, the folder of the session and the graphics backend.
"""

from __future__ import annotations

import ctypes
import faulthandler
import importlib
import importlib.util
import json
import os
import sys
import traceback
from pathlib import Path

import bpy

HERE = Path(__file__).resolve().parent
MARK = "@window "
PACKAGE = "repousse_window"
BREATH = 0.005
"""Seconds between two steps where a scenario asks for less: Blender handles its events and draws in between."""
LAST_REPORTS = 8


def load_scenarios():
    """All scenarios, from the modules in scenarios/, as a package of its own name: Blender's path stays as it is."""
    spec = importlib.util.spec_from_file_location(PACKAGE, HERE / "__init__.py", submodule_search_locations=[str(HERE)])
    sys.modules[PACKAGE] = importlib.util.module_from_spec(spec)
    for path in sorted((HERE / "scenarios").glob("[!_]*.py")):
        importlib.import_module(f"{PACKAGE}.scenarios.{path.stem}")
    return importlib.import_module(f"{PACKAGE}.scenario").REGISTERED


def tell(what: str, **facts) -> None:
    """Tell the outside, after everything that was said before."""
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.CDLL(None).fflush(None)  # Blender's own messages
    os.write(1, f"\n{MARK}{json.dumps({'what': what, **facts})}\n".encode())


class Drive:
    """A timer that plays scenarios to their ends, then quits Blender."""

    def __init__(self, scenarios, folder: Path, suffix: str):
        self.window_module = importlib.import_module(f"{PACKAGE}.window")
        self.window_module.count_drawings()
        self.left = list(scenarios)
        self.folder = folder
        self.suffix = suffix
        self.steps = self.window = None

    def __call__(self) -> float | None:
        if self.steps is None:
            if not self.left:
                bpy.ops.wm.quit_blender()
                return None
            self._begin(self.left[0])
        try:
            return max(BREATH, next(self.steps) or 0.0)
        except StopIteration:
            self._ended(None)
        except Exception:
            told = "".join(f"\n    {line}" for line in self.window.reports()[-LAST_REPORTS:])
            self._ended(f"{traceback.format_exc()}Blender's last reports:{told}")
        return BREATH

    def _begin(self, scenario) -> None:
        tell("begins", name=scenario.name, limit=scenario.limit, leaves=scenario.leaves)
        faulthandler.dump_traceback_later(scenario.limit, exit=True, file=sys.__stderr__)
        self.window = self.window_module.Window(scenario.name + self.suffix, self.folder, tell)
        self.steps = self._played(scenario)

    def _played(self, scenario):
        yield from self.window.fresh_file()
        yield from scenario.run(self.window)

    def _ended(self, error: str | None) -> None:
        faulthandler.cancel_dump_traceback_later()
        self.steps = None
        del self.left[0]
        tell("ended", error=error)


def main() -> None:
    wanted = json.loads(sys.argv[-1])
    scenarios = load_scenarios()
    tell("plan", plan=[scenario.told() for scenario in scenarios])
    if bpy.app.background:
        return
    suffix = f"-{wanted['backend']}" if wanted["backend"] else ""
    chosen = [scenario for name in wanted["names"] for scenario in scenarios if scenario.name == name]
    bpy.context.preferences.view.show_splash = False
    bpy.context.preferences.use_preferences_save = False
    bpy.app.timers.register(Drive(chosen, Path(wanted["folder"]), suffix), first_interval=0.5, persistent=True)


if __name__ == "__main__":
    main()
