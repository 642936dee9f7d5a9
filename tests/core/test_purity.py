# SPDX-License-Identifier: GPL-3.0-or-later
"""The material knows neither Blender nor devices: core imports no bpy and no hid, and nothing outside itself."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CORE = ROOT / "core"
MODULES = sorted(CORE.rglob("*.py"))
BLENDER = {"bpy", "bl_ui", "bl_operators", "bmesh", "gpu", "mathutils", "blf", "bgl", "addon_utils", "openvdb"}
DEVICES = {"hid", "hidapi", "hidraw", "usb", "serial"}

IMPORT_ALL = """
import importlib, sys, types
root = types.ModuleType("repousse")
root.__path__ = [{root!r}]
sys.modules["repousse"] = root
for name in {names!r}:
    importlib.import_module(name)
found = sorted({{m.partition(".")[0] for m in sys.modules}} & set({forbidden!r}))
assert not found, found
inside = sorted(m for m in sys.modules if m.startswith("repousse.") and not m.startswith("repousse.core"))
assert not inside, inside
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


def test_all_of_core_imports_without_blender_or_a_device():
    assert len(MODULES) > 10
    names = [module_name(path) for path in MODULES]
    script = IMPORT_ALL.format(root=str(ROOT), names=names, forbidden=sorted(BLENDER | DEVICES))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(CORE)))
def test_bpy_in_one_place_alone(path):
    """Only formats/vdb.py asks for Blender, and only when it is called; imports go up no farther than core."""
    depth = len(path.relative_to(CORE).parts)
    for line, name, level, inside in imports(ast.parse(path.read_text(encoding="utf-8"))):
        where = f"{path.relative_to(ROOT)}, line {line}"
        assert name != "repousse", f"{where}: a relative import is wanted"
        assert level <= depth, f"{where}: reaches out of core"
        if level == 0 and name in BLENDER | DEVICES:
            assert path == CORE / "formats" / "vdb.py" and inside, f"{where}: imports {name}"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(CORE)))
def test_bpy_is_not_even_named_elsewhere(path):
    """Not as a string for importlib either."""
    if path == CORE / "formats" / "vdb.py":
        return
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            assert node.id not in BLENDER
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            assert node.value.partition(".")[0] not in BLENDER
