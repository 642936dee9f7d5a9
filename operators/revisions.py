# SPDX-License-Identifier: GPL-3.0-or-later
"""The files that a volume has been while it is sculpted: one a stroke, each under a name of its own.

Blender caches a volume by its path for as long as it runs, and its undo brings back paths, not voxels. So each
revision has a name that was never there before, and stays for as long as anything can come back to it.
"""

from __future__ import annotations

import functools
import os
import re
import tempfile
from pathlib import Path
from uuid import uuid4

import bpy


def new_path(volume: bpy.types.Volume) -> Path:
    """Where the next revision of a volume goes: a name that no file has had."""
    stem = re.sub(r"[^\w-]+", "_", volume.name)
    return folder() / f"{stem}-{uuid4().hex[:12]}.vdb"


@functools.cache
def folder() -> Path:
    """Where this process keeps its revisions."""
    root = __package__.rpartition(".")[0]
    try:
        parent = bpy.utils.extension_path_user(root, path="volumes", create=True)
    except ValueError:  # not run as an extension
        parent = bpy.utils.user_resource("DATAFILES", path="repousse", create=True) or bpy.app.tempdir
    return Path(tempfile.mkdtemp(prefix=f"{os.getpid()}-", dir=parent))
