# SPDX-License-Identifier: GPL-3.0-or-later
"""A saved .blend takes the volumes along that it shows: copies in a folder beside it, "<its name> volumes".

Such a folder has a list of which save showed which files. Those that neither the .blend nor one of the backups that
Blender keeps of it shows any more go at the next save, unless undo may still come back to them.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from contextlib import suppress
from pathlib import Path

import bpy

from ..core.formats.base import replacing
from . import revisions
from .session import live

LIST = "saves.json"
"""In such a folder: the names that each save showed, the newest first."""

_before: dict[int, str] = {}
"""While Blender saves: what the paths of volumes were, by session_uid."""
_places: dict[str, Path] = {}
"""Which file a relative path meant when it was current: undo brings it back also after Save As into another folder."""


def folder_of(blend: Path) -> Path:
    """Where the volumes of a .blend lie."""
    return blend.with_name(f"{blend.stem} volumes")


def before_save(blend: str) -> None:
    """Copy what the session's volumes show beside the .blend that will be written, and let them show the copies.

    Where that fails a volume keeps its path, and one line on stderr says so.
    """
    _before.clear()
    if not blend:  # the startup file
        return
    note_places()
    folder = folder_of(Path(blend))
    for volume in _ours():
        source = revisions.path_of(volume)
        target = folder / source.name
        try:
            if not target.exists():
                _copy(source, target)
        except (OSError, ValueError) as error:
            print(f"Repoussé: {volume.name} is not saved beside {blend}: {error}", file=sys.stderr)
            continue
        _before[volume.session_uid] = volume.filepath
        text = _text(target)
        if volume.filepath != text:
            _let_show(volume, text)


def after_save(blend: str) -> None:
    """Keep the list of what was saved. After Save Copy the volumes show what they did before."""
    revisions.keep_current()  # before volumes show again what they did
    if not blend:
        return
    saved, names = Path(blend), []
    copy = not bpy.data.filepath or Path(bpy.data.filepath) != saved
    for volume in bpy.data.volumes:
        if volume.session_uid in _before:
            names.append(revisions.path_of(volume).name)
            if copy:
                _let_show(volume, _before[volume.session_uid])
    _before.clear()
    with suppress(OSError):
        _keep_list(folder_of(saved), names)


def after_failed_save() -> None:
    """The volumes show what they did before."""
    for volume in bpy.data.volumes:
        if volume.session_uid in _before:
            _let_show(volume, _before[volume.session_uid])
    _before.clear()


def note_places() -> None:
    """Keep what relative paths mean now."""
    for volume in bpy.data.volumes:
        if volume.filepath.startswith("//") and volume.library is None:
            path = revisions.path_of(volume)
            if path.exists():
                _places[volume.filepath] = path


def find_again() -> None:
    """Let volumes whose path leads nowhere show the file it meant before, or that of its name beside the .blend."""
    for volume in bpy.data.volumes:
        if volume.library is not None or not volume.filepath or volume.is_sequence:
            continue
        path = revisions.path_of(volume)
        if path.exists():
            continue
        beside = folder_of(Path(bpy.data.filepath)) / path.name if bpy.data.filepath else path
        for found in (_places.get(volume.filepath, path), beside):
            if found.exists():
                volume.filepath = str(found)
                break


def forget_places() -> None:
    """Another file was loaded."""
    _places.clear()


def _let_show(volume: bpy.types.Volume, text: str) -> None:
    """Let a volume show the same voxels in another file; its session need not read them."""
    volume.filepath = text
    session = live()
    if session is not None and session.volume_uid == volume.session_uid:
        session.moved_to(revisions.path_of(volume))


def _ours() -> list[bpy.types.Volume]:
    """The volumes that show a revision of this or another process, or what was saved beside a .blend."""
    root = revisions.root()
    return [
        volume
        for volume in bpy.data.volumes
        if volume.library is None
        and volume.override_library is None
        and volume.filepath
        and not volume.is_sequence
        and (path := revisions.path_of(volume)).exists()
        and (path.is_relative_to(root) or (path.parent / LIST).exists())
    ]


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(exist_ok=True)
    with replacing(target) as part:
        shutil.copyfile(source, part)
    listed = target.parent / LIST
    if not listed.exists():
        listed.write_text("[]\n", encoding="utf-8")


def _text(target: Path) -> str:
    """The path that the volume has while Blender saves.

    Relative paths are relative to where the .blend was: Blender rebases them when it writes into another folder, and
    makes all paths of a .blend relative that was nowhere yet.
    """
    if not bpy.data.filepath or not bpy.context.preferences.filepaths.use_relative_paths:
        return str(target)
    try:
        return "//" + Path(os.path.relpath(target, Path(bpy.data.filepath).parent)).as_posix()
    except ValueError:  # on another drive
        return str(target)


def _keep_list(folder: Path, names: list[str]) -> None:
    """Put a save's names at the head of the list, and remove the files that nothing needs."""
    listed = folder / LIST
    if not listed.exists():
        return
    former = [sorted(names), *_list_in(listed)]
    backups = bpy.context.preferences.filepaths.save_version
    needed = {name for save in former[: 1 + backups] for name in save} | revisions.reachable()
    for name in {name for save in former for name in save} - needed:
        (folder / name).unlink(missing_ok=True)
    kept = [
        save
        for number, save in enumerate(former)
        if number <= backups or any((folder / name).exists() for name in save)
    ]
    with replacing(listed) as part:
        part.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


def _list_in(listed: Path) -> list[list[str]]:
    """What the list holds; nothing that could lead out of its folder."""
    try:
        saves = json.loads(listed.read_text(encoding="utf-8"))
        return [[name for name in save if Path(name).name == name and name.endswith(".vdb")] for save in saves]
    except (OSError, ValueError, TypeError):
        return []
