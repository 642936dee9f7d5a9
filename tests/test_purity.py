# SPDX-License-Identifier: GPL-3.0-or-later
"""The material and the arm know neither Blender nor each other: core and device import nothing outside themselves.

The arm, whose half runs in a subprocess of its own, needs no more than Python, and hidapi at run time.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("core", "device")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
BLENDER = {"bpy", "bl_ui", "bl_operators", "bmesh", "gpu", "mathutils", "blf", "bgl", "addon_utils", "openvdb"}
HIDAPI = {"hid", "hidraw"}
DEVICES = HIDAPI | {"hidapi", "usb", "serial"}
ASKS_FOR_BLENDER = ROOT / "core" / "formats" / "vdb.py"
LOADS_HIDAPI = ROOT / "device" / "child.py"

IMPORT_ALL = """
import importlib, sys, types
root = types.ModuleType("repousse")
root.__path__ = [{root!r}]
sys.modules["repousse"] = root
before = set(sys.modules)
for name in {names!r}:
    importlib.import_module(name)
new = set(sys.modules) - before
inside = sorted(m for m in new if m.startswith("repousse.") and not m.startswith("repousse.{package}"))
assert not inside, inside
tops = {{m.partition(".")[0] for m in new}}
found = sorted(tops & set({forbidden!r}))
assert not found, found
others = sorted(tops - set(sys.stdlib_module_names) - {{"repousse"}})
assert {others} or not others, others
"""


def module_name(path):
    parts = ("repousse", *path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree):
    """(line, top-level name, levels up, whether inside a function) of every import in a module."""

    def visit(node, inside):
        inside = inside or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name.partition(".")[0], 0, inside
        elif isinstance(node, ast.ImportFrom):
            yield node.lineno, (node.module or "").partition(".")[0], node.level, inside
        for child in ast.iter_child_nodes(node):
            yield from visit(child, inside)

    return list(visit(tree, False))


@pytest.mark.parametrize(("package", "others"), [("core", True), ("device", False)])
def test_all_of_it_imports_without_blender_a_device_or_the_other(package, others):
    """`others`: whether more than Python is needed, as numpy is by the material."""
    names = [module_name(path) for path in MODULES if path.is_relative_to(ROOT / package)]
    assert len(names) > 10
    forbidden = sorted(BLENDER | DEVICES)
    script = IMPORT_ALL.format(root=str(ROOT), names=names, package=package, forbidden=forbidden, others=others)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_a_module_imports(path):
    """Imports go up no farther than the package. Blender is asked for in one place, and only when that is called."""
    depth = len(path.relative_to(ROOT).parts) - 1
    for line, name, level, inside in imports(ast.parse(path.read_text(encoding="utf-8"))):
        where = f"{path.relative_to(ROOT)}, line {line}"
        assert name != "repousse", f"{where}: a relative import is wanted"
        assert level <= depth, f"{where}: reaches out of its package"
        if level == 0 and name in BLENDER | DEVICES:
            assert path == ASKS_FOR_BLENDER and inside, f"{where}: imports {name}"
        if level == 0 and path.is_relative_to(ROOT / "device"):
            assert name in sys.stdlib_module_names, f"{where}: {name} is no part of Python"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_bpy_is_not_even_named_elsewhere(path):
    """Not as a string for importlib either; nor are the modules of hidapi."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            assert node.id not in BLENDER or path == ASKS_FOR_BLENDER
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            name = node.value.partition(".")[0]
            assert name not in BLENDER or path == ASKS_FOR_BLENDER
            assert name not in HIDAPI or path == LOADS_HIDAPI
