# SPDX-License-Identifier: GPL-3.0-or-later
"""In all tests `repousse` is the add-on as Blender loads it: the very modules its operators use, under a short name.

With the bpy wheel that is this tree, linked into a user folder that is made here and thrown away at the end; in a
real Blender (tests/blender/run.py) it is the installed zip. Without bpy it is what is installed in the environment.
"""

import atexit
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ADDON = "bl_ext.user_default.repousse"


class AddonAlias(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives the modules of the add-on a second name, `repousse`, so that no module is ever loaded twice."""

    def __init__(self):
        self._specs = {}

    def find_spec(self, fullname, path=None, target=None):
        if fullname.partition(".")[0] != "repousse":
            return None
        importlib.import_module("bpy")  # which makes the package bl_ext
        name = ADDON + fullname.removeprefix("repousse")
        # A missing module is the caller's to report, under the name that it knows.
        if importlib.util.find_spec(name) is None:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, origin=name)

    def create_module(self, spec):
        module = importlib.import_module(spec.origin)
        self._specs[spec.name] = module.__spec__
        return module

    def exec_module(self, module):
        """Only undo what the import system did to the module: it has run already, under its own name."""
        alias = module.__spec__.name
        module.__spec__ = self._specs.pop(alias)


def link_addon(resources):
    """Make this tree the extension `repousse` of the user folder `resources`; its wheels are in the environment."""
    folder = resources / "extensions" / "user_default" / "repousse"
    folder.mkdir(parents=True)
    for source in [ROOT / "__init__.py", *(path.parent for path in ROOT.glob("*/__init__.py"))]:
        (folder / source.name).symlink_to(source)
    manifest = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    manifest = re.sub(r"^wheels = \[.*?^\]\n", "", manifest, flags=re.DOTALL | re.MULTILINE)
    (folder / "blender_manifest.toml").write_text(manifest, encoding="utf-8")


_status = 0


def pytest_sessionfinish(exitstatus):
    global _status
    _status = int(exitstatus)


def _leave():
    """The bpy 4.5 module may never end: it destroys what a thread of its own still waits on. So Python is the last to
    be ended in order, and Blender is not."""
    bpy = sys.modules.get("bpy")
    if bpy is not None and bpy.app.module and bpy.app.version < (5, 0, 0):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(_status)


atexit.register(_leave)  # before all others, so that it is called after them

# Before anything imports bpy: it reads its user folder once. Inside a real Blender bpy is there from the start.
if "bpy" not in sys.modules and importlib.util.find_spec("bpy"):
    resources = Path(tempfile.mkdtemp(prefix="repousse-tests-"))
    atexit.register(shutil.rmtree, resources, ignore_errors=True)
    os.environ["BLENDER_USER_RESOURCES"] = str(resources)
    link_addon(resources)
if importlib.util.find_spec("bpy"):
    sys.meta_path.insert(0, AddonAlias())

if importlib.util.find_spec("hypothesis"):
    import hypothesis

    # The machine's speed is no property of the code, and a failure must come back in the next run.
    hypothesis.settings.register_profile("repousse", deadline=None, derandomize=True)
    hypothesis.settings.load_profile("repousse")
