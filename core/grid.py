# SPDX-License-Identifier: GPL-3.0-or-later
"""DensityGrid: how full each voxel is, and where the voxels lie in the world."""

from __future__ import annotations

from dataclasses import dataclass, field
from threading import Lock

import numpy as np

from .bricks import BRICK, BrickMap

CUBIC_TOLERANCE = 0.01
"""Voxel edges that differ by less than this share are taken as equal (DESIGN 2)."""

Box = tuple[tuple[int, int, int], tuple[int, int, int]]
"""A half-open box of voxels: (lowest index, one past the highest index)."""

_swapping = Lock()
"""Held while a grid gets another array: its map must be that array's, whichever thread asks."""


def union(first: Box | None, second: Box | None) -> Box | None:
    """The smallest box around two boxes; None is the empty box."""
    if first is None or second is None:
        return first or second
    (a, b), (c, d) = first, second
    return (
        (min(a[0], c[0]), min(a[1], c[1]), min(a[2], c[2])),
        (max(b[0], d[0]), max(b[1], d[1]), max(b[2], d[2])),
    )


@dataclass(eq=False)
class DensityGrid:
    """Density of a volume on cubic voxels (paper 4.1).

    Parameters
    ----------
    density
        Shape (nx, ny, nz), any real dtype, values in [0, 1]; 0 is empty, 1 is full. Outside the array it is 0.
        Kept as C-contiguous float32, as a copy unless ``copy=False``.
    transform
        (4, 4) float64, index space (voxel centres at integers) to world space; default the identity.
        Its three axes must be at right angles and equally long, to 1 %.
    name
        The grid's name in a .vdb file.
    metadata
        What made the grid, as text or numbers; written into a .vdb file.
    notes
        What a reader did to the data on its way in (window, resampling), a sentence each, to be told to the user.

    :attr:`grown` counts the voxels (x, y, z) ever added before the first ones, by which all who hold indices follow.
    Who writes into ``density`` in place says so to :attr:`bricks`.

    Raises
    ------
    ValueError
        When the array is not 3-D or has no voxels, when a density is not finite or outside [0, 1], or when the
        transform is not that of cubic voxels.
    """

    density: np.ndarray
    transform: np.ndarray = field(default_factory=lambda: np.eye(4))
    name: str = "density"
    metadata: dict[str, str | int | float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    copy: bool = field(default=True, repr=False)
    grown: tuple[int, int, int] = field(default=(0, 0, 0), init=False, repr=False)
    _bricks: BrickMap | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        given = np.asarray(self.density)
        if given.ndim != 3 or 0 in given.shape:
            raise ValueError(f"a density grid has three axes with at least one voxel each, not the shape {given.shape}")
        low, high = float(given.min()), float(given.max())
        if not (low >= 0.0 and high <= 1.0):  # written so that NaN fails too
            raise ValueError(f"density must lie in [0, 1], but goes from {low:g} to {high:g}: give a window")
        make = np.array if self.copy else np.asarray  # copy=None is numpy 2's, and Blender 4.5 has numpy 1.26
        self.density = make(given, dtype=np.float32, order="C")
        self.transform = np.array(self.transform, dtype=np.float64)
        if self.transform.shape != (4, 4) or not np.isfinite(self.transform).all():
            raise ValueError("a transform is a finite 4x4 matrix from voxel indices to the world")
        axes = self.transform[:3, :3]
        edges = np.linalg.norm(axes, axis=0)
        if edges.min() <= 0.0 or edges.max() > edges.min() * (1.0 + CUBIC_TOLERANCE):
            raise ValueError(f"voxels must be cubes, but their edges are {edges[0]:g}, {edges[1]:g}, {edges[2]:g}")
        angles = (axes / edges).T @ (axes / edges) - np.eye(3)
        if np.abs(angles).max() > CUBIC_TOLERANCE:
            raise ValueError("voxels must be cubes, but the transform shears them")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along each axis."""
        nx, ny, nz = self.density.shape
        return nx, ny, nz

    @property
    def voxel_size(self) -> float:
        """Edge of a voxel in world units."""
        return float(np.linalg.norm(self.transform[:3, 0]))

    @property
    def mass(self) -> float:
        """Sum of density in voxels' worth, accumulated in float64 (DESIGN 2)."""
        return float(self.density.sum(dtype=np.float64))

    @property
    def bricks(self) -> BrickMap:
        """Which bricks of ``density`` are empty or full; all who work with the grid share it."""
        with _swapping:
            if self._bricks is None or self._bricks.density is not self.density:
                self._bricks = BrickMap(self.density)
            return self._bricks

    def swap(self, bricks: BrickMap) -> None:
        """Live in another array from now on, that of ``bricks``."""
        with _swapping:
            self.density, self._bricks = bricks.density, bricks

    def grow(self, below: tuple[int, int, int], above: tuple[int, int, int]) -> None:
        """Pad with empty voxels: ``below`` before the first and ``above`` after the last index of each axis.

        The transform follows, so that each voxel stays where it was in the world.
        """
        nx, ny, nz = self.shape
        grown = np.zeros([n + lo + hi for n, lo, hi in zip(self.shape, below, above, strict=True)], np.float32)
        grown[below[0] : below[0] + nx, below[1] : below[1] + ny, below[2] : below[2] + nz] = self.density
        if any(b % BRICK for b in below):
            self.density = grown  # and there is no map of it yet
        else:
            self.swap(self.bricks.grown(grown, below))
        self.grown = (self.grown[0] + below[0], self.grown[1] + below[1], self.grown[2] + below[2])
        self.transform = self.transform.copy()
        self.transform[:3, 3] -= self.transform[:3, :3] @ np.array(below, dtype=np.float64)
