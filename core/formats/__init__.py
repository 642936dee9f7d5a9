# SPDX-License-Identifier: GPL-3.0-or-later
"""Files to grids and back: PVM (`pvm`) and OpenVDB (`vdb`).

A reader knows a file by its first bytes, a writer by the suffix. Whatever a file holds, a reader gives a grid or a
FormatError, never more memory than `MAX_VOXELS` voxels need; whatever fails, a writer leaves no file behind.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

import numpy as np

from ..grid import DensityGrid
from . import layout, pvm, vdb
from .base import MAX_VOXELS, EmptyVolumeError, FormatError, GridInfo, Volume
from .normalise import Window, to_grid
from .revision import VolumeFile, write_in_place_of

__all__ = [
    "MAX_VOXELS",
    "EmptyVolumeError",
    "FormatError",
    "GridInfo",
    "VolumeFile",
    "describe",
    "list_grids",
    "read_volume",
    "write_in_place_of",
    "write_volume",
]


def read_volume(
    path: str | os.PathLike[str], grid: str | int | None = None, window: Window | None = None
) -> DensityGrid:
    """Read one volume of a .pvm or .vdb file as density on cubic voxels.

    Parameters
    ----------
    grid
        Which grid of a .vdb: its name, ``"name[1]"`` where several share one (`GridInfo.key`), or its index. None takes
        "density", else the first scalar grid.
    window
        (lo, hi): the value lo becomes density 0 and hi density 1, the rest is clipped; lo > hi inverts. For a level set
        these are signed distances in world units. None: 8-bit PVM 0:255, 16-bit 0:max, level set half a
        voxel to both sides; values within [0, 1] as they are; all others from the file's background to their maximum.

    Returns
    -------
    DensityGrid
        Placed in the world as the file says, in voxels of its smallest edge; ``notes`` tell what was done to the
        values, ``metadata`` holds the file's texts, ``source`` and ``window`` ("lo:hi").

    Raises
    ------
    FormatError
        One line: the file and what is wrong with it. EmptyVolumeError, which is one, for a sound file without density.
    """
    return to_grid(_volume(Path(path), grid), window)


def write_volume(grid: DensityGrid, path: str | os.PathLike[str], half: bool = False, bits: int = 8) -> None:
    """Write a grid with its metadata; the suffix .vdb or .pvm decides the format.

    A .vdb keeps every float32 bit (or with ``half`` 11 bits) and the whole transform; a .pvm keeps 8 or 16
    ``bits``, and of the transform only the edge of a voxel. The file appears whole or not at all. Raises FormatError.
    """
    path = Path(path)
    if path.suffix.lower() == ".vdb":
        vdb.write(grid, path, half)
    elif path.suffix.lower() == ".pvm":
        pvm.write(grid, path, bits)
    else:
        raise FormatError(f"{path}: cannot be written: its name must end in .vdb or .pvm")


def list_grids(path: str | os.PathLike[str]) -> list[GridInfo]:
    """What is in a file, in its order, without reading a .vdb's voxels. Raises FormatError."""
    path = Path(path)
    infos: list[GridInfo] = _format(path).list_grids(path)
    return infos


def describe(
    path: str | os.PathLike[str], grid: str | int | None = None, window: Window | None = None
) -> dict[str, object]:
    """All there is to tell about a file and the grid that `read_volume` would take.

    Keys: file, grids (list of GridInfo), grid (its key), values (lowest, highest in the file), shape, voxel_size,
    transform, mass (voxels' worth), metadata, notes. Where nothing can be sculpted, all from ``grid`` on may be
    None and the notes say why. Raises FormatError for a file that cannot be read.
    """
    path = Path(path)
    told: dict[str, object] = dict.fromkeys(
        ("grid", "values", "shape", "voxel_size", "transform", "mass", "metadata", "notes")
    )
    told |= {"file": str(path), "grids": list_grids(path)}
    try:
        volume = _volume(path, grid)
        told |= {
            "grid": volume.info.key,
            "values": (float(np.nanmin(volume.values)), float(np.nanmax(volume.values))),
        }
        density = to_grid(volume, window)
    except EmptyVolumeError as empty:
        return told | {"notes": [str(empty)]}
    return told | {
        "shape": density.shape,
        "voxel_size": density.voxel_size,
        "transform": density.transform,
        "mass": density.mass,
        "metadata": density.metadata,
        "notes": density.notes,
    }


def _volume(path: Path, grid: str | int | None) -> Volume:
    reader = _format(path)
    try:
        volume: Volume = reader.read(path, grid)
    except MemoryError as error:
        raise FormatError(f"{path}: needs more memory than there is") from error
    return volume


def _format(path: Path) -> ModuleType:
    """The module that reads a file, by its first bytes."""
    try:
        with path.open("rb") as file:
            start = file.read(8)
    except OSError as error:
        raise FormatError(f"{path}: cannot be read: {error.strerror or error}") from error
    if start.startswith(pvm.MAGICS):
        return pvm
    if start == layout.MAGIC:
        return vdb
    raise FormatError(f"{path}: is empty" if not start else f"{path}: is neither a PVM nor an OpenVDB file")
