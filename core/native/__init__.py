# SPDX-License-Identifier: GPL-3.0-or-later
"""The compiled kernels: found, checked and called through ctypes, which lets go of the GIL while they run.

They come as a wheel of their own, ``repousse_kernels``, one for each platform and none for each Python. Where it is
missing, or where the environment says ``REPOUSSE_KERNELS=numpy``, the numpy twins beside each caller do the same work.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import logging
import os
from pathlib import Path

from .structures import FINGERPRINT

LIBRARY_NAMES = ("kernels.so", "kernels.dylib", "kernels.dll")

_log = logging.getLogger("repousse")


def _find() -> Path | None:
    spec = importlib.util.find_spec("repousse_kernels")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        for name in LIBRARY_NAMES:
            if (Path(folder) / name).is_file():
                return Path(folder) / name
    return None


def _open(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    faster = path.with_name(f"avx2-{path.name}")  # the same source, the same results
    if faster.is_file() and library.repousse_has_avx2():
        library = ctypes.CDLL(str(faster))
    library.repousse_abi.restype = ctypes.c_int64
    if library.repousse_abi() != FINGERPRINT:
        raise OSError(f"{path.name} was built from another version of kernels.c: run make setup, or install again")
    for name in ("estimate", "empty", "behind", "loosen", "clear", "put_back", "rim_sources", "recursive"):
        getattr(library, f"repousse_{name}").restype = None
    for name in ("sweep", "rim_gather", "classify"):
        getattr(library, f"repousse_{name}").restype = ctypes.c_int64
    for name in ("rim_place", "smooth"):
        getattr(library, f"repousse_{name}").restype = ctypes.c_double
    return library


@functools.cache
def _load(choice: str) -> ctypes.CDLL | None:
    """The library, or None; says once which kernels are used where it is not the compiled ones."""
    if choice == "numpy":
        _log.warning("Repoussé uses its numpy kernels, as REPOUSSE_KERNELS asks")
        return None
    try:
        path = _find()
        if path is not None:
            return _open(path)
        reason = "the package repousse_kernels is not installed"
    except (OSError, AttributeError) as error:
        reason = str(error)
    _log.warning("Repoussé uses its numpy kernels, 20 to 100 times slower: %s", reason)
    return None


def library() -> ctypes.CDLL | None:
    """The compiled kernels, or None where the numpy twins are to be used."""
    return _load(os.environ.get("REPOUSSE_KERNELS", "").strip().lower())


def available() -> bool:
    """Whether the compiled kernels are used. ``REPOUSSE_KERNELS=numpy`` forces the fallback."""
    return library() is not None


def name() -> str:
    """Which kernels run, for reports: "compiled" or "numpy"."""
    return "compiled" if available() else "numpy"
