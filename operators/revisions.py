# SPDX-License-Identifier: GPL-3.0-or-later
"""The files that volumes have been while they are sculpted: one a stroke, each under a name of its own.

Blender caches a volume by its path for as long as it runs, and its undo brings back paths, not voxels. So each revision
has a name that no file ever had, and stays for as long as anything can come back to it: what is current, what undo
still reaches, and what was current when this process last saved itself automatically. A file's name stands for its
voxels wherever copies of it lie.
"""

from __future__ import annotations

import functools
import os
import re
import shutil
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

import bpy

from .processes import is_alive

KEPT_FOR = 7 * 24 * 3600.0
"""Seconds for which the files of a process that is no more stay: quit.blend and autosaves show them."""


@dataclass
class Revision:
    """When, counted in commits, a file became what a volume shows, and when that was last so."""

    volume: int
    born: int
    last: int


_known: dict[str, Revision] = {}
"""By file name: what undo may come back to."""
_depth = 0
"""How many commits lie behind what is shown now; undo makes it less."""
_current: set[str] = set()
_pinned: set[str] = set()
"""What was current when `_autosaved`, the time of the last autosave in ns, was written."""
_autosaved = 0
_saved: set[str] = set()
"""What a .blend shows in this process's folder itself, as it could not be copied."""


def new_path(volume: bpy.types.Volume) -> Path:
    """Where the next revision of a volume goes: a name that no file has had."""
    look()
    stem = re.sub(r"[^\w-]+", "_", volume.name)
    return folder() / f"{stem}-{uuid4().hex[:12]}.vdb"


def commit(volume: bpy.types.Volume, path: Path) -> None:
    """Let a volume show its next revision, ``path`` from `new_path`; what nothing can come back to goes."""
    global _depth
    volume.filepath = str(path)
    _depth += 1
    _note_current()
    there = {other.session_uid for other in bpy.data.volumes}
    for name, revision in list(_known.items()):
        # A commit on top of what was undone ends that: redo does not come back to it.
        undone = revision.born >= _depth and revision.volume in there
        if name not in _current and (undone or revision.last < _depth - _undo_steps()):
            del _known[name]
    _remove_but(reachable() | _pinned | _saved)


def reachable() -> set[str]:
    """The names of all files that are current or that undo may come back to."""
    return _current | set(_known)


def keep_current() -> None:
    """After a .blend was saved: what it shows in this process's folder stays until that is old."""
    if _made_folder.cache_info().currsize:
        _saved.update(path.name for path in shown() if path.parent == _made_folder())


def look() -> None:
    """Before anything is changed: note what is current, and whether that is what an autosave has kept."""
    global _autosaved, _pinned
    _note_current()
    newest = max((_time_of(path) for path in _autosaves()), default=0)
    if newest != _autosaved:
        _autosaved, _pinned = newest, set(_current)


def follow() -> None:
    """After undo or redo: note what is current, and how many commits lie behind it."""
    global _depth
    _depth = max((_known[path.name].born for path in shown() if path.name in _known), default=0)
    _note_current()


def restart() -> None:
    """After a file was loaded: undo comes back to nothing that was before it."""
    global _depth
    _known.clear()
    _depth = 0
    _note_current()
    _remove_but(_current | _pinned | _saved)


def clear() -> None:
    """At the end of Blender: superseded revisions go, current ones stay."""
    with suppress(Exception):  # Blender's data may be gone by now; then what was last known counts
        _current.update(path.name for path in shown())
    _remove_but(_current | _saved)


def shown() -> list[Path]:
    """The file of every volume that has one."""
    return [path_of(volume) for volume in bpy.data.volumes if volume.filepath]


def path_of(volume: bpy.types.Volume) -> Path:
    """The file of a volume, absolute and without ".."."""
    return Path(os.path.normpath(bpy.path.abspath(volume.filepath, library=volume.library)))


def root() -> Path:
    """The folder with those of all processes."""
    package = __package__.rpartition(".")[0]
    try:
        return Path(bpy.utils.extension_path_user(package, path="volumes", create=True))
    except ValueError:  # not run as an extension
        return Path(bpy.utils.user_resource("DATAFILES", path="repousse", create=True) or bpy.app.tempdir)


@functools.cache
def _made_folder() -> Path:
    made = Path(tempfile.mkdtemp(prefix=f"{os.getpid()}-", dir=root()))
    _remove_abandoned(made)
    return made


def folder() -> Path:
    """Where this process keeps its revisions."""
    made = _made_folder()
    made.mkdir(parents=True, exist_ok=True)  # somebody may have tidied it away
    return made


def _note_current() -> None:
    _current.clear()
    for volume in bpy.data.volumes:
        if volume.filepath:
            name = path_of(volume).name
            _current.add(name)
            _known.setdefault(name, Revision(volume.session_uid, _depth, _depth)).last = _depth


def _undo_steps() -> int:
    return bpy.context.preferences.edit.undo_steps


def _autosaves() -> list[Path]:
    """What this process has saved automatically: 123_autosave.blend, or with the file's name before that."""
    name = re.compile(rf"(.*_)?{os.getpid()}_autosave\.blend")
    return [path for path in Path(bpy.app.tempdir).parent.glob("*_autosave.blend") if name.fullmatch(path.name)]


def _time_of(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _remove_but(names: set[str]) -> None:
    """Empty this process's folder but for the files of these names."""
    if not _made_folder.cache_info().currsize:
        return
    made = _made_folder()
    for path in list(made.glob("*")):
        if path.name not in names:
            with suppress(OSError):  # on Windows a file that is being read stays
                path.unlink()
    with suppress(OSError):  # it goes when it is empty
        made.rmdir()


def _remove_abandoned(own: Path) -> None:
    """The folders of processes that are no more, once they are old and nothing here shows them."""
    used = {path.parent for path in shown()}
    for other in own.parent.iterdir():
        process = re.match(r"(\d+)-", other.name)
        if process and other != own and other not in used and not is_alive(int(process[1])):
            with suppress(OSError):
                if other.stat().st_mtime < time.time() - KEPT_FOR:
                    shutil.rmtree(other)
