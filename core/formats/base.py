# SPDX-License-Identifier: GPL-3.0-or-later
"""What the file formats share: their errors, what is told of a grid, how one is chosen, and how a file is written."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

GENERATOR = "Repousse 0.1.0"
"""Written into every file, so that one can tell what made it."""

MAX_VOXELS = 1 << 29
"""The most voxels that are read from a file (812^3, 2 GiB of float32): a file of some bytes may promise any number."""


class FormatError(ValueError):
    """A file that cannot be read or written; the message is one line that names the file and what is wrong."""


class EmptyVolumeError(FormatError):
    """The file is sound, but what it holds cannot be sculpted: no scalar grid, or one without any density."""


@dataclass(frozen=True)
class GridInfo:
    """What a file tells of one of its grids without its voxels being read.

    Parameters
    ----------
    name, index
        As in the file; the index counts the file's grids in their order.
    key
        What ``read_volume(path, grid=key)`` takes: the name, or ``"name[1]"`` where several grids share one.
    kind
        "fog volume", "level set", "unknown", ...; for a PVM file "PVM", "PVM2" or "PVM3".
    value_type
        "float", "double", "int32", "vec3s", ...; for a PVM file "uint8", "uint16" or "rgb8". Half floats add " (half)".
    shape
        Voxels along each axis of the box that holds values, or None where the file does not say.
    transform
        (4, 4) float64, the file's voxel indices to the world, or None where it is not linear.
    readable
        Whether `read_volume` takes it: scalar, with a linear transform.
    metadata
        The file's own texts and numbers.
    """

    name: str
    index: int
    key: str
    kind: str
    value_type: str
    shape: tuple[int, int, int] | None
    transform: np.ndarray | None
    readable: bool = True
    metadata: dict[str, str | int | float] = field(default_factory=dict)

    @property
    def edges(self) -> tuple[float, float, float] | None:
        """Edges of a voxel in world units; None without a linear transform."""
        if self.transform is None:
            return None
        x, y, z = np.linalg.norm(self.transform[:3, :3], axis=0).tolist()
        return x, y, z


@dataclass
class Volume:
    """Values as they are in a file, before a window makes them density.

    ``values`` is (nx, ny, nz) of any real dtype; ``transform`` (4, 4) takes the array's indices to the world, and its
    voxels need not be cubes; ``window`` is the (lo, hi) that the format itself gives, None where the values must
    tell; ``background`` is what the file says lies outside its values: empty space. ``own`` is OpenVDB's grid where
    Repoussé wrote it: its indices are then those of the array.
    """

    path: Path
    info: GridInfo
    values: np.ndarray
    transform: np.ndarray
    window: tuple[float, float] | None = None
    background: float = 0.0
    notes: list[str] = field(default_factory=list)
    own: Any = None


def select(infos: Sequence[GridInfo], grid: str | int | None, path: Path) -> GridInfo:
    """The grid that is asked for by key, name or index; None takes "density", else the first that can be read.

    Raises FormatError when there is none such, or when its values are not scalars.
    """
    listed = ", ".join(f"{info.key!r} ({info.value_type})" for info in infos) or "none"
    if grid is None:
        readable = [info for info in infos if info.readable]
        if not readable:
            raise EmptyVolumeError(f"{path}: holds no scalar grid that could be sculpted; its grids: {listed}")
        return next((info for info in readable if info.name == "density"), readable[0])
    found = [info for info in infos if info.key == grid] or [info for info in infos if info.name == grid]
    if not found and str(grid).isdecimal():
        found = [info for info in infos if info.index == int(grid)]
    if not found:
        raise FormatError(f"{path}: has no grid {grid!r}; its grids: {listed}")
    if not found[0].readable:
        why = f"holds {found[0].value_type} values" if found[0].transform is not None else "has a non-linear transform"
        raise FormatError(f"{path}: grid {found[0].key!r} {why}: choose a scalar grid; its grids: {listed}")
    return found[0]


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary name beside ``path``, renamed to it at the end; whatever fails, nothing half-written is left.

    Raises FormatError where the system refuses (no such folder, no room, no permission).
    """
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        part.touch()  # a folder that takes no file says so here, whatever writes next
        yield part
        os.replace(part, path)
    except OSError as error:
        raise FormatError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
