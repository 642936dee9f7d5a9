# SPDX-License-Identifier: GPL-3.0-or-later
"""Output files that appear all together or not at all."""

from __future__ import annotations

import contextlib
import os
import uuid
from pathlib import Path


class Outputs:
    """Files that are written under temporary names and appear together when the ``with`` block ends well."""

    def __init__(self) -> None:
        self._parts: dict[Path, Path] = {}

    def add(self, path: str | os.PathLike) -> Path:
        """The temporary name for an output, with its suffix. ValueError where the output could not be made."""
        path = Path(path)
        if path in self._parts:
            raise ValueError(f"{path}: two outputs have this name")
        if path.is_dir():
            raise ValueError(f"{path}: cannot be written: it is a folder")
        part = path.with_name(f".{uuid.uuid4().hex[:8]}.{path.name}")
        try:
            part.touch()  # a folder that is not there or takes no file says so now, not after the work
        except OSError as error:
            raise ValueError(f"{path}: cannot be written: {error.strerror or error}") from error
        self._parts[path] = part
        return part

    def __enter__(self) -> Outputs:
        return self

    def __exit__(self, kind, error, trace) -> None:
        try:
            if kind is None:
                for path, part in self._parts.items():
                    part.replace(path)
        finally:
            for part in self._parts.values():
                with contextlib.suppress(OSError):
                    part.unlink(missing_ok=True)
