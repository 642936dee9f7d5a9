# SPDX-License-Identifier: GPL-3.0-or-later
"""One arm, one session: who drives it holds a lock, which the system takes back however its process ends."""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class InUseError(RuntimeError):
    """Another session drives the arm; the text is one line."""


def lock_file(path: str) -> Path:
    """The file whose lock stands for the device at ``path``."""
    return Path(tempfile.gettempdir(), f"repousse-{hashlib.sha256(path.encode()).hexdigest()[:16]}.lock")


@contextmanager
def held(path: str) -> Iterator[None]:
    """Hold the lock of the device at ``path``. Raises InUseError.

    The file stays: were it removed, two could hold locks on files of the same name.
    """
    try:
        descriptor = os.open(lock_file(path), os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
    except OSError as error:  # another user's
        raise InUseError(f"{path}: its lock cannot be had ({error}): another user may be driving it") from error
    try:
        try:
            _lock(descriptor)
        except OSError as error:
            raise InUseError(f"{path}: is in use by another session of Repoussé: disconnect it there") from error
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
