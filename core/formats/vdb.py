# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenVDB files, through the OpenVDB that Blender brings along: the only module of the core that imports bpy, and late.

OpenVDB trusts a file, so `layout` walks it first, and OpenVDB is given only what is consistent.
"""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from ..bricks import BRICK, FULL, MIXED, BrickMap, boxes_of
from ..grid import Box, DensityGrid
from .base import GENERATOR, MAX_VOXELS, EmptyVolumeError, FormatError, GridInfo, Volume, replacing, select
from .layout import SCALARS, Part, lay_out, value_type

SHAPE = "repousse_shape"
"""Metadata that keeps the array's shape: OpenVDB drops empty borders, but poses and strokes count from the corner."""

FARTHEST = 1 << 30
"""Indices from here on are refused: OpenVDB adds two of them as 32 bits when it copies, then crashes or never ends."""

_OPENVDB_OWN = ("class", "name", "value_type", "vector_type", "is_", "file_", "generator", "creator", SHAPE)


class _Entry(NamedTuple):
    """A grid in a file's directory."""

    info: GridInfo
    part: Part


def read(path: Path, grid: str | int | None) -> Volume:
    """The values of one grid in the box of its active voxels (or the array's that Repoussé once wrote).

    A level set's window is half of its smallest voxel edge to both sides. Raises FormatError, also when OpenVDB finds
    the grid damaged or its box has more than MAX_VOXELS; EmptyVolumeError for a grid without active voxels.
    """
    entries = _directory(path)
    info = select([entry.info for entry in entries], grid, path)
    openvdb = _openvdb(path)
    with _refusals(openvdb, path, "cannot be read"):
        found = openvdb.read(str(path), entries[info.index].part.asked)
        if found.empty() or not found.activeVoxelCount():
            raise EmptyVolumeError(f"{path}: grid {info.key!r} holds nothing: it has no active voxels")
        low, high = (np.array(corner, np.int64) for corner in found.evalActiveVoxelBoundingBox())
        written = _written_shape(entries[info.index].part.metadata)
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
    own = found if written is not None and not low.any() and info.value_type == "float" and not background else None
    return Volume(path, info, values, transform, window, background, notes, own)


def list_grids(path: Path) -> list[GridInfo]:
    """All grids of a file in its order, also those that cannot be read. Needs no OpenVDB. Raises FormatError."""
    return [entry.info for entry in _directory(path)]


def write(grid: DensityGrid, path: Path, half: bool) -> None:
    """Write a fog volume: every bit of float32, or 11 with ``half``; the transform, name and metadata of the grid."""
    fog = fog_of(grid, path)
    fog.saveFloatAsHalf = half
    with replacing(path) as part:
        save(fog, grid, part, path)


def fog_of(grid: DensityGrid, path: Path) -> Any:
    """OpenVDB's FloatGrid of a density grid; ``path`` is named where that fails: FormatError."""
    openvdb = _openvdb(path)
    with _refusals(openvdb, path, "cannot be written"):
        fog = openvdb.FloatGrid()
        bricks = BrickMap(grid.density)
        _lay_bricks(fog, bricks, (0, 0, 0), bricks.states.shape)
        fog.prune(0.0)
    return fog


def change(fog: Any, grid: DensityGrid, box: Box) -> None:
    """Make the voxels of a box, as far as it lies in the grid, and of its bricks, what they are in ``grid``."""
    low = tuple(max(n, 0) // BRICK for n in box[0])
    high = tuple(-(-min(n, edge) // BRICK) for n, edge in zip(box[1], grid.shape, strict=True))
    if any(a >= b for a, b in zip(low, high, strict=True)):
        return
    grid.bricks.changed(box)  # the box says so, and what is saved must not depend on who else has
    # A leaf that has become empty is left out by copyFromArray, which takes it for one that was never there.
    fog.fill(tuple(n * BRICK for n in low), tuple(n * BRICK - 1 for n in high), 0.0, False)
    _lay_bricks(fog, grid.bricks, low, high)


def _lay_bricks(fog: Any, bricks: BrickMap, low: Sequence[int], high: Sequence[int]) -> None:
    """Fill or copy the bricks from ``low`` up to ``high``: by a copy full ones would become as many leaves."""
    states = bricks.states[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    if 2 * np.count_nonzero(states == MIXED) > states.size:
        states = np.full_like(states, MIXED)  # one copy is faster than hundreds
    for state in (FULL, MIXED):
        for box in boxes_of(states == state):
            first, last = ([BRICK * (n + a) for n, a in zip(end, low, strict=True)] for end in box)
            last = [min(n, edge) for n, edge in zip(last, bricks.density.shape, strict=True)]
            if state == FULL:
                fog.fill(tuple(first), tuple(n - 1 for n in last), 1.0, True)
            else:
                inside = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
                fog.copyFromArray(np.ascontiguousarray(bricks.density[inside]), ijk=tuple(first), tolerance=0.0)


def save(fog: Any, grid: DensityGrid, part: Path, path: Path) -> None:
    """Write ``fog``, with the transform, name and metadata of ``grid``, to ``part``, which is to become ``path``."""
    openvdb = _openvdb(path)
    with _refusals(openvdb, path, "cannot be written"):
        fog.name, fog.gridClass = grid.name, openvdb.GridClass.FOG_VOLUME
        fog.transform = openvdb.createLinearTransform(grid.transform.T.tolist())  # OpenVDB's vectors are rows
        fog.creator = GENERATOR
        for name, value in grid.metadata.items():
            if name and not name.startswith(_OPENVDB_OWN):
                fog[name] = value
        fog[SHAPE] = " ".join(map(str, grid.shape))
        fog["generator"] = GENERATOR
        openvdb.write(str(part), grids=[fog], metadata={"generator": GENERATOR})
    whole(part, path)


def renew(source: Path, part: Path, path: Path) -> None:
    """Write all of ``source``, in this OpenVDB's format version, to ``part``; where that fails ``path`` is named."""
    openvdb = _openvdb(path)
    with _refusals(openvdb, path, "cannot be written"):
        grids, metadata = openvdb.readAll(str(source))
        openvdb.write(str(part), grids=grids, metadata=metadata)
    whole(part, path)


def whole(part: Path, path: Path) -> None:
    """Raise FormatError where ``part``, which is to become ``path``, was not written to its end."""
    try:
        lay_out(part)
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
    """The grids of a file. Raises FormatError."""
    parts = lay_out(path).parts
    shared = Counter(part.name for part in parts)
    entries = []
    for index, part in enumerate(parts):
        kind = value_type(part.kind)
        info = GridInfo(
            part.name,
            index,
            part.asked if shared[part.name] > 1 else part.name,
            str(part.metadata.get("class", "unknown")),
            kind + (" (half)" if part.kind.endswith("_HalfFloat") else ""),
            _shape(part.metadata),
            part.transform,
            kind in SCALARS and part.transform is not None,
            {
                name: value
                for name, value in part.metadata.items()
                if isinstance(value, str | int | float) and not name.startswith(_OPENVDB_OWN)
            },
        )
        entries.append(_Entry(info, part))
    return entries


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
