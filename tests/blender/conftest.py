# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on is enabled for the whole of these tests, and each begins in a fresh file."""

import pytest

bpy = pytest.importorskip("bpy", reason="these tests need Blender, as the bpy wheel or for real (make test-blender)")

import addon_utils  # noqa: E402  Blender makes it importable with bpy

ADDON = "bl_ext.user_default.repousse"


@pytest.fixture(scope="session", autouse=True)
def addon():
    """The enabled add-on, as a module."""
    module = addon_utils.enable(ADDON, default_set=True)
    assert module is not None, f"{ADDON} cannot be enabled: see the traceback above"
    yield module
    addon_utils.disable(ADDON, default_set=True)


@pytest.fixture(autouse=True)
def fresh_file(addon):
    bpy.ops.wm.read_homefile(app_template="", use_empty=True)
