# SPDX-License-Identifier: GPL-3.0-or-later
"""A .vdb file that is written again and again while one of its grids is sculpted; all else in it stays, bit for bit.

OpenVDB's Python does not know every type of grid, and what it reads and writes once more comes out recompressed. So the
other grids are not read at all: their bytes go from file to file, and only the directory says anew where they lie.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from ..grid import Box, DensityGrid
from . import vdb
from .base import replacing, select
from .layout import Layout, lay_out
from .normalise import to_grid

OLDEST = 222
"""Format version from which on a grid's bytes mean the same in any file."""
OLDEST_OF_POINTS = 224
"""The same for grids of points."""


class VolumeFile:
    """The file of a volume that is sculpted, as OpenVDB's tree in memory: only what changed is copied into that.

    ``grid`` is the sculpted grid as the file has it.
    """

    def __init__(self, path: Path, key: str | int | None = None) -> None:
        """Read the grid ``key`` of a .vdb as `read_volume` does. Raises FormatError."""
        volume = vdb.read(path, key)
        self.path = path
        self.grid: DensityGrid = to_grid(volume, None)
        self._index: int | None = volume.info.index  # of the grid in the file; None: there is nothing else in that
        self._fog: Any = volume.own
        self._shape = self.grid.shape

    def write(self, path: Path, boxes: list[Box] | None) -> None:
        """Write ``grid`` as it is now, and all else of the file, to ``path``, which becomes the file.

        ``boxes`` (half-open, array indices) hold every voxel that changed since the last time; None: anything may have.
        The file appears whole or not at all; where it does not (FormatError) the next ``boxes`` count as None.
        """
        fog, self._fog = self._fog, None
        if fog is None or boxes is None or self.grid.shape != self._shape:
            fog = vdb.fog_of(self.grid, path)
        else:
            for box in boxes:
                vdb.change(fog, self.grid, box)
        self._index = _write(fog, self.grid, path, self.path, self._index)
        self.path, self._fog, self._shape = path, fog, self.grid.shape


def write_in_place_of(source: Path, grid: DensityGrid, path: Path) -> None:
    """Write ``grid``, in place of the one that `read_volume` takes from ``source``, and all else of that, to ``path``.

    The file appears whole or not at all. Raises FormatError.
    """
    index = select(vdb.list_grids(source), None, source).index
    _write(vdb.fog_of(grid, path), grid, path, source, index)


def _write(fog: Any, grid: DensityGrid, path: Path, source: Path, index: int | None) -> int | None:
    """Returns the index once more, or None where ``source`` has turned out to hold nothing else."""
    with replacing(path) as part, _scratch(part, 2) as (written, renewed):
        vdb.save(fog, grid, written, path)
        if index is not None and _outdated(lay_out(source)):
            vdb.renew(source, renewed, path)
            source = renewed
        if index is None or not _has_more(source, written):
            os.replace(written, part)
            return None
        with part.open("wb") as target:
            _join(source, index, written, target)
        vdb.whole(part, path)
    return index


@contextmanager
def _scratch(path: Path, count: int) -> Iterator[list[Path]]:
    """Names of files beside ``path`` that are gone in the end."""
    names = [path.with_name(f"{path.name}.{number}") for number in range(count)]
    try:
        yield names
    finally:
        for name in names:
            with suppress(OSError):
                name.unlink(missing_ok=True)


def _outdated(layout: Layout) -> bool:
    points = any(part.kind.startswith("Tree_pt") for part in layout.parts)
    return layout.version < (OLDEST_OF_POINTS if points else OLDEST)


def _has_more(source: Path, written: Path) -> bool:
    """Whether ``source`` holds anything but one grid of the name that ``written`` has."""
    old, new = lay_out(source), lay_out(written)
    with source.open("rb") as others, written.open("rb") as own:
        same = _bytes(others, *old.metadata) == _bytes(own, *new.metadata)
    return not same or [part.unique for part in old.parts] != [new.parts[0].unique]


def _join(source: Path, index: int, written: Path, target: BinaryIO) -> None:
    """Write ``source`` to ``target``, but for its ``index``-th grid, in whose place the one of ``written`` comes.

    The first grid that shares its tree with that one gets the tree as it was; others that do share it with that grid.
    """
    old, new = lay_out(source), lay_out(written)
    [sculpted] = new.parts
    former = old.parts[index]
    heir = next((part for part in old.parts if part.parent == former.unique), None)
    with source.open("rb") as others, written.open("rb") as own:
        target.write(_bytes(own, 0, new.metadata[0]) + _bytes(others, *old.metadata))
        target.write(struct.pack("<i", len(old.parts)))
        for part in old.parts:
            name, kind = _texts(_bytes(others, part.named, part.inherits))
            parent = _bytes(others, part.inherits, part.placed)
            topology, values = [(others, part.begin, part.blocks)], (others, part.blocks, part.end)
            if part is former:
                kind, parent = _texts(_bytes(own, sculpted.named, sculpted.inherits))[1], _NO_TEXT
                topology, values = [(own, sculpted.begin, sculpted.blocks)], (own, sculpted.blocks, sculpted.end)
            elif part is heir:
                parent = _NO_TEXT
                topology = [(others, part.begin, part.tree), (others, former.tree, former.blocks)]
                values = (others, former.blocks, former.end)
            elif heir is not None and part.parent == former.unique:
                parent = _texts(_bytes(others, heir.named, heir.inherits))[0]
            target.write(name + kind + parent)
            begin = target.tell() + _PLACES.size
            blocks = begin + sum(end - start for _, start, end in topology)
            target.write(_PLACES.pack(begin, blocks if parent == _NO_TEXT else 0, blocks + values[2] - values[1]))
            for piece in (*topology, values):
                _copy(*piece, target)


_PLACES = struct.Struct("<3q")
_NO_TEXT = struct.pack("<I", 0)
_CHUNK = 1 << 20


def _texts(data: bytes) -> tuple[bytes, bytes]:
    """Two texts, each with its length before it, apart."""
    end = 4 + struct.unpack_from("<I", data)[0]
    return data[:end], data[end:]


def _bytes(file: BinaryIO, start: int, end: int) -> bytes:
    file.seek(start)
    return file.read(end - start)


def _copy(file: BinaryIO, start: int, end: int, target: BinaryIO) -> None:
    file.seek(start)
    while start < end:
        chunk = file.read(min(_CHUNK, end - start))
        if not chunk:
            raise OSError("a file became shorter while it was read")
        target.write(chunk)
        start += len(chunk)
