# SPDX-License-Identifier: GPL-3.0-or-later
"""What a VDB file (format versions 220 to 225) says of itself, without OpenVDB: its grids, and which bytes are whose.

OpenVDB trusts a file: it reads a cut one without a word, fills gigabytes for a length that lies, and follows counts to
wherever they lead. So this walks a file's directory first (names, metadata, transform, the counts at the root of each
tree, where each grid ends), and OpenVDB is given only what is consistent.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from .base import EmptyVolumeError, FormatError

MAGIC = struct.pack("<q", 0x56444220)

MARK = "\x1e"
"""Stands in a unique name between the name and a number."""

SCALARS = {"float": 4, "double": 8, "int32": 4, "int64": 8, "bool": 1}
"""Bytes of a value of the types that can be density."""

_MAPS = {  # float64 numbers of a linear map, and where among them its translation and its scale begin
    "UniformScaleMap": (15, None, 0),
    "ScaleMap": (15, None, 0),
    "UniformScaleTranslateMap": (18, 0, 3),
    "ScaleTranslateMap": (18, 0, 3),
    "TranslationMap": (3, 0, None),
    "AffineMap": (16, None, None),
    "UnitaryMap": (16, None, None),
}
_NUMBERS = {"int32": "<i", "int64": "<q", "float": "<f", "double": "<d", "bool": "<?"}
_ROOT_CHILD = 12 + 2 * 32**3 // 8  # bytes that each child of a root takes at the least: its place and its two masks


@dataclass(frozen=True)
class Part:
    """A grid in a file.

    ``unique`` is its name with the mark by which OpenVDB sets grids of one name apart, ``kind`` its type as in
    "Tree_float_5_4_3", ``parent`` the unique name of the grid whose tree it shares, or "". These names lie in the file
    from ``named`` over ``inherits`` (the parent's) to ``placed``, where three 8-byte places follow. Its own bytes go
    from ``begin`` (compression, metadata, transform) over ``tree`` (topology) and ``blocks`` (values) to ``end``.
    """

    unique: str
    kind: str
    parent: str
    metadata: dict[str, Any]
    transform: np.ndarray | None
    named: int
    inherits: int
    placed: int
    begin: int
    tree: int
    blocks: int
    end: int

    @property
    def name(self) -> str:
        """The grid's name."""
        return self.unique.partition(MARK)[0]

    @property
    def asked(self) -> str:
        """By which name OpenVDB finds the grid: "name[1]" where several have one name."""
        name, mark, number = self.unique.partition(MARK)
        return f"{name}[{number}]" if mark else name


@dataclass(frozen=True)
class Layout:
    """A whole file: its format version, where its own metadata lies, and its grids in their order."""

    version: int
    metadata: tuple[int, int]
    parts: list[Part]


def lay_out(path: Path) -> Layout:
    """Walk a file. Raises FormatError wherever it contradicts itself, EmptyVolumeError where it has no grids."""
    try:
        with path.open("rb") as file:
            layout = _walked(_Walk(path, file))
    except OSError as error:
        raise FormatError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not layout.parts:
        raise EmptyVolumeError(f"{path}: holds no grids")
    return layout


class _Walk:
    """Reads little-endian values from a file and never past ``end``."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self.path, self.file, self.at, self.end = path, file, 0, file.seek(0, os.SEEK_END)

    def bytes(self, count: int) -> bytes:
        if not 0 <= count <= self.end - self.at:
            raise self.damaged(f"{count} bytes are expected at byte {self.at}, but {self.end - self.at} are there")
        self.file.seek(self.at)
        self.at += count
        return self.file.read(count)

    def number(self, code: str) -> Any:
        return struct.unpack(code, self.bytes(struct.calcsize(code)))[0]

    def text(self) -> str:
        return self.bytes(self.number("<I")).decode(errors="replace")

    def metadata(self) -> dict[str, Any]:
        """A map of named, typed values; of the types, texts, numbers and triples of them are understood."""
        found: dict[str, Any] = {}
        for _ in range(self.number("<I")):
            name, kind, data = self.text(), self.text(), self.bytes(self.number("<I"))
            if kind == "string":
                found[name] = data.decode(errors="replace")
            elif kind in _NUMBERS and len(data) == struct.calcsize(_NUMBERS[kind]):
                found[name] = struct.unpack(_NUMBERS[kind], data)[0]
            elif kind == "vec3i" and len(data) == 12:
                found[name] = struct.unpack("<3i", data)
        return found

    def damaged(self, what: str) -> FormatError:
        return FormatError(f"{self.path}: damaged: {what}")


def _walked(walk: _Walk) -> Layout:
    path = walk.path
    if walk.bytes(8) != MAGIC:
        raise FormatError(f"{path}: is not an OpenVDB file")
    version = walk.number("<I")
    if not 220 <= version < 1000:
        raise FormatError(f"{path}: has OpenVDB's file version {version}, and only those from 220 on can be read")
    walk.bytes(8)  # version of the library
    if not walk.number("<?"):
        raise FormatError(f"{path}: was written to a stream, without the places of its grids: save it once more")
    walk.bytes((1 if version < 222 else 0) + 36)  # compression, and a UUID
    metadata = walk.at
    walk.metadata()
    metadata_end, parts, size = walk.at, [], walk.end
    for index in range(walk.number("<i")):
        named, unique, kind = walk.at, walk.text(), walk.text()
        inherits, parent, placed = walk.at, walk.text(), walk.at
        begin, blocks, end = (walk.number("<q") for _ in range(3))
        if parent and not blocks:  # what shares another's tree has no values of its own
            blocks = end
        if not walk.at <= begin <= blocks <= end <= size:
            raise walk.damaged(f"grid {index} is to end at byte {end}, but the file has {size}")
        walk.at, walk.end = begin, blocks
        told, transform, tree = _grid(walk, version, kind)
        parts.append(Part(unique, kind, parent, told, transform, named, inherits, placed, begin, tree, blocks, end))
        walk.at, walk.end = end, size
    return Layout(version, (metadata, metadata_end), parts)


def _grid(walk: _Walk, version: int, kind: str) -> tuple[dict[str, Any], np.ndarray | None, int]:
    """Metadata and transform of a grid, and where its tree begins; a scalar grid's root must fit into its bytes."""
    if version >= 222:
        walk.number("<I")  # compression
    metadata, name = walk.metadata(), walk.text()
    if name not in _MAPS:
        return metadata, None, walk.end
    count, shift, scale = _MAPS[name]
    numbers = np.frombuffer(walk.bytes(8 * count), "<f8")
    transform = np.eye(4)
    if scale is not None:
        transform[:3, :3] = np.diag(numbers[scale : scale + 3])
    if shift is not None:
        transform[:3, 3] = numbers[shift : shift + 3]
    if count == 16:
        transform = numbers.reshape(4, 4).T.copy()
    tree, value = walk.at, SCALARS.get(value_type(kind))
    if value and walk.end > walk.at:  # an instance has no tree of its own
        walk.bytes(4 + value)  # buffers, background
        tiles, children = walk.number("<I"), walk.number("<I")
        if tiles * (12 + value + 1) + children * _ROOT_CHILD > walk.end - walk.at:
            raise walk.damaged(f"{tiles} tiles and {children} branches cannot be in {walk.end - walk.at} bytes of tree")
    return metadata, transform, tree


def value_type(kind: str) -> str:
    """What `Tree_float_5_4_3_HalfFloat` holds: float."""
    return kind.removeprefix("Tree_").split("_")[0]
