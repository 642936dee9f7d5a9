# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenVDB files, through the OpenVDB that Blender brings along: the only module of the core that imports bpy, and late.

OpenVDB trusts a file: it reads a cut one without a word, fills gigabytes for a length that lies, and follows counts to
wherever they lead. So this module first walks the file's directory itself (names, metadata, transform, the
counts at the root of each tree, where each grid ends) and lets OpenVDB have only what is consistent.
"""

from __future__ import annotations

import importlib
import os
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from ..grid import DensityGrid
from .base import GENERATOR, MAX_VOXELS, EmptyVolumeError, FormatError, GridInfo, Volume, replacing, select

MAGIC = struct.pack("<q", 0x56444220)

SHAPE = "repousse_shape"
"""Metadata that keeps the array's shape: OpenVDB drops empty borders, but poses and strokes count from the corner."""

FARTHEST = 1 << 30
"""Indices from here on are refused: OpenVDB adds two of them as 32 bits when it copies, then crashes or never ends."""

_SCALARS = {"float": 4, "double": 8, "int32": 4, "int64": 8, "bool": 1}  # bytes of a value
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
_OPENVDB_OWN = ("class", "name", "value_type", "vector_type", "is_", "file_", "generator", "creator", SHAPE)
_ROOT_CHILD = 12 + 2 * 32**3 // 8  # bytes that each child of a root takes at the least: its place and its two masks


class _Entry(NamedTuple):
    """A grid in a file's directory; ``unique`` is the name that OpenVDB finds it by."""

    info: GridInfo
    unique: str
    metadata: dict[str, Any]


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


def read(path: Path, grid: str | int | None) -> Volume:
    """The values of one grid in the box of its active voxels (or the array's that Repoussé once wrote).

    A level set's window is half of its smallest voxel edge to both sides. Raises FormatError, also when OpenVDB finds
    the grid damaged or its box has more than MAX_VOXELS; EmptyVolumeError for a grid without active voxels.
    """
    entries = _directory(path)
    info = select([entry.info for entry in entries], grid, path)
    openvdb = _openvdb(path)
    with _refusals(openvdb, path, "cannot be read"):
        found = openvdb.read(str(path), entries[info.index].unique)
        if found.empty() or not found.activeVoxelCount():
            raise EmptyVolumeError(f"{path}: grid {info.key!r} holds nothing: it has no active voxels")
        low, high = (np.array(corner, np.int64) for corner in found.evalActiveVoxelBoundingBox())
        written = _written_shape(entries[info.index].metadata)
        if written is not None and (low >= 0).all() and (high < written).all():
            low, high = np.zeros(3, np.int64), written - 1
        shape = tuple((high - low + 1).tolist())
        by = " x ".join(map(str, shape))
        if max(np.abs([low, high]).flat) >= FARTHEST:
            raise FormatError(f"{path}: grid {info.key!r} lies too far out, around index {tuple(low.tolist())}")
        if np.prod(shape, dtype=float) > MAX_VOXELS:
            raise FormatError(f"{path}: grid {info.key!r} spans {by} voxels, more than the {MAX_VOXELS} that are read")
        exact = info.value_type.split()[0] in ("double", "int32", "int64")
        values = np.empty(shape, np.float64 if exact else np.float32)
        found.copyToArray(values, ijk=tuple(low.tolist()))
        background = float(found.background)
    assert info.transform is not None  # select() takes no other
    transform = info.transform.copy()
    transform[:3, 3] += transform[:3, :3] @ low
    notes, window = [], None
    if info.kind == "level set":
        half = 0.5 * float(np.linalg.norm(transform[:3, :3], axis=0).min())
        window = (half, -half)
    elif info.kind != "fog volume":
        notes.append(f"grid {info.key!r} is of class {info.kind!r} and is taken as fog")
    return Volume(path, info, values, transform, window, background, notes)


def list_grids(path: Path) -> list[GridInfo]:
    """All grids of a file in its order, also those that cannot be read. Needs no OpenVDB. Raises FormatError."""
    return [entry.info for entry in _directory(path)]


def write(grid: DensityGrid, path: Path, half: bool) -> None:
    """Write a fog volume: every bit of float32, or 11 with ``half``; the transform, name and metadata of the grid."""
    openvdb = _openvdb(path)
    with replacing(path) as part, _refusals(openvdb, path, "cannot be written"):
        fog = openvdb.FloatGrid()
        fog.copyFromArray(grid.density, tolerance=0.0)
        fog.prune(0.0)
        fog.name, fog.gridClass, fog.saveFloatAsHalf = grid.name, openvdb.GridClass.FOG_VOLUME, half
        fog.transform = openvdb.createLinearTransform(grid.transform.T.tolist())  # OpenVDB's vectors are rows
        fog.creator = GENERATOR
        for name, value in grid.metadata.items():
            if name and not name.startswith(_OPENVDB_OWN):
                fog[name] = value
        fog[SHAPE] = " ".join(map(str, grid.shape))
        fog["generator"] = GENERATOR
        openvdb.write(str(part), grids=[fog], metadata={"generator": GENERATOR})
        try:
            _directory(part)
        except FormatError as error:  # OpenVDB does not notice
            raise FormatError(f"{path}: cannot be written whole: the disk is full, or a quota is") from error


def _openvdb(path: Path) -> ModuleType:
    try:
        import bpy

        bpy.utils.expose_bundled_modules()
        openvdb = importlib.import_module("openvdb")
    except ImportError as error:
        raise FormatError(
            f"{path}: .vdb files need OpenVDB, which comes with Blender's Python or its bpy package: run this there"
        ) from error
    return openvdb


@contextmanager
def _refusals(openvdb: ModuleType, path: Path, what: str) -> Iterator[None]:
    """Make one line of whatever OpenVDB raises, and keep it from printing others."""
    level = openvdb.getLoggingLevel()
    openvdb.setLoggingLevel("fatal")
    try:
        yield
    except (FormatError, OSError):
        raise
    except Exception as error:  # its bindings raise RuntimeError, LookupError, KeyError, TypeError, UnicodeError, ...
        why = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(f"{path}: {what}, OpenVDB says: {why}") from error
    finally:
        openvdb.setLoggingLevel(level)


def _directory(path: Path) -> list[_Entry]:
    """Walk a file's directory (format versions 220 to 225). Raises FormatError wherever it contradicts the file."""
    with path.open("rb") as file:
        found = _grids(_Walk(path, file))
    if not found:
        raise EmptyVolumeError(f"{path}: holds no grids")
    names = [unique.partition("\x1e") for unique, *_ in found]  # OpenVDB sets grids of one name apart by a number
    shared = Counter(name for name, *_ in names)
    entries = []
    for index, ((_, kind, metadata, transform), (name, mark, number)) in enumerate(zip(found, names, strict=True)):
        value_type = _value_type(kind)
        info = GridInfo(
            name,
            index,
            f"{name}[{number}]" if shared[name] > 1 and mark else name,
            str(metadata.get("class", "unknown")),
            value_type + (" (half)" if kind.endswith("_HalfFloat") else ""),
            _shape(metadata),
            transform,
            value_type in _SCALARS and transform is not None,
            {
                name: value
                for name, value in metadata.items()
                if isinstance(value, str | int | float) and not name.startswith(_OPENVDB_OWN)
            },
        )
        entries.append(_Entry(info, f"{name}[{number}]" if mark else name, metadata))
    return entries


def _grids(walk: _Walk) -> list[tuple[str, str, dict[str, Any], np.ndarray | None]]:
    """Unique name, type, metadata and transform of each grid of a file."""
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
    walk.metadata()
    found, size = [], walk.end
    for index in range(walk.number("<i")):
        unique, kind = walk.text(), walk.text()
        walk.text()  # the grid that this is an instance of
        begin, blocks, end = (walk.number("<q") for _ in range(3))
        if not walk.at <= begin <= blocks <= end <= size:
            raise walk.damaged(f"grid {index} is to end at byte {end}, but the file has {size}")
        walk.at, walk.end = begin, blocks
        found.append((unique, kind, *_grid(walk, version, kind)))
        walk.at, walk.end = end, size
    return found


def _grid(walk: _Walk, version: int, kind: str) -> tuple[dict[str, Any], np.ndarray | None]:
    """Metadata and transform of a grid; for scalar grids the root's counts must fit into the tree's bytes."""
    if version >= 222:
        walk.number("<I")  # compression
    metadata, name = walk.metadata(), walk.text()
    if name not in _MAPS:
        return metadata, None
    count, shift, scale = _MAPS[name]
    numbers = np.frombuffer(walk.bytes(8 * count), "<f8")
    transform = np.eye(4)
    if scale is not None:
        transform[:3, :3] = np.diag(numbers[scale : scale + 3])
    if shift is not None:
        transform[:3, 3] = numbers[shift : shift + 3]
    if count == 16:
        transform = numbers.reshape(4, 4).T.copy()
    value = _SCALARS.get(_value_type(kind))
    if value and walk.end > walk.at:  # an instance has no tree of its own
        walk.bytes(4 + value)  # buffers, background
        tiles, children = walk.number("<I"), walk.number("<I")
        if tiles * (12 + value + 1) + children * _ROOT_CHILD > walk.end - walk.at:
            raise walk.damaged(f"{tiles} tiles and {children} branches cannot be in {walk.end - walk.at} bytes of tree")
    return metadata, transform


def _value_type(kind: str) -> str:
    """What `Tree_float_5_4_3_HalfFloat` holds: float."""
    return kind.removeprefix("Tree_").split("_")[0]


def _shape(metadata: dict[str, Any]) -> tuple[int, int, int] | None:
    """Shape of the box of values, from what the file tells of it."""
    written = _written_shape(metadata)
    if written is not None:
        x, y, z = written.tolist()
        return x, y, z
    low, high = metadata.get("file_bbox_min"), metadata.get("file_bbox_max")
    if not (isinstance(low, tuple) and isinstance(high, tuple)):
        return None
    x, y, z = (max(last - first + 1, 0) for first, last in zip(low, high, strict=True))
    return x, y, z


def _written_shape(metadata: dict[str, Any]) -> np.ndarray | None:
    counts = str(metadata.get(SHAPE, "")).split()
    if len(counts) != 3 or not all(count.isdecimal() and 0 < int(count) < 1 << 31 for count in counts):
        return None
    return np.array([int(count) for count in counts], np.int64)
