# SPDX-License-Identifier: GPL-3.0-or-later
"""Compile fakehid.c and fakeudev.c with `zig cc` of the `ziglang` package, once for each version of the source."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
SOURCES = (HERE / "fakehid.c", HERE / "fakeudev.c")
ROOT = HERE.parents[2]
FOLDER = ROOT / "build" / "fakehid"
CACHE = ROOT / "build" / "zig"
FLAGS = ("-std=gnu11", "-O2", "-fPIC", "-shared", "-s", "-Wall", "-Wextra", "-Werror")


def library() -> Path:
    """The library to preload, for this machine. Raises OSError or subprocess.CalledProcessError when it cannot be."""
    text = b"".join(source.read_bytes() for source in (*SOURCES, HERE / "node.h"))
    key = hashlib.sha256(text + repr(FLAGS).encode()).hexdigest()[:16]
    path = FOLDER / f"fakehid-{key}.so"
    if not path.exists():
        FOLDER.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}.part")
        cache = {"ZIG_GLOBAL_CACHE_DIR": str(CACHE), "ZIG_LOCAL_CACHE_DIR": str(CACHE)}
        command = [sys.executable, "-m", "ziglang", "cc", *FLAGS, "-o", str(part), *map(str, SOURCES)]
        subprocess.run(command, env=os.environ | cache, check=True, stdout=sys.stderr)
        part.replace(path)
    return path
