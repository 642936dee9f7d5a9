# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes of the chart: a column, a half space that is pressed along an axis, and one that is pressed aslant."""

from __future__ import annotations

import numpy as np

from .method import Scene

STEP = 0.5
"""Voxels to a step, as in the bench."""


def press(
    side: int,
    material: int,
    air: int,
    radius: float,
    depth: float,
    density: float,
    yield_ratio: float,
    band: float | None = None,
    step: float = STEP,
) -> Scene:
    """A block ``side`` voxels square and ``material`` deep under ``air``, pressed downward (-z) in its middle.

    The path begins where the ball touches the face and ends at ``depth`` voxels.
    """
    values = np.zeros((side, side, material + air), np.float32)
    values[:, :, :material] = density
    middle, face = (side - 1) / 2, material - 0.5
    depths = np.linspace(0.0, depth, int(np.ceil(depth / step - 1e-9)) + 1)
    path = np.column_stack([np.full((len(depths), 2), middle), face + radius - depths])
    return Scene(values, radius, path, (0.0, 0.0, -1.0), yield_ratio, band)


def depths(scene: Scene) -> np.ndarray:
    """How deep the tool is at each step of a `press`, in voxels (n,)."""
    return scene.path[0, 2] - scene.path[:, 2]


def face(scene: Scene) -> int:
    """The first plane above the material of a `press`."""
    return int((scene.density[0, 0] > 0.0).sum())


def aslant(side: int, radius: float, depth: float, density: float, yield_ratio: float, direction) -> Scene:
    """A half space whose face is across ``direction`` through the middle of a cube, cut smoothly, and pressed so."""
    u = np.array(direction, float) / np.linalg.norm(direction)
    middle = (side - 1) / 2
    along = sum(c * (a - middle) for c, a in zip(u, np.ogrid[:side, :side, :side]))
    values = (density * np.clip(along + 0.5, 0.0, 1.0)).astype(np.float32)
    ways = np.arange(0.0, depth + 1e-9, STEP)
    return Scene(values, radius, middle + (ways - radius)[:, None] * u, (u[0], u[1], u[2]), yield_ratio)


def rings(scene: Scene, found: np.ndarray, width: float = 2.0) -> np.ndarray:
    """Mass that each ring around the push has gained: (bins along it, bins of radius), each ``width`` voxels wide.

    A voxel counts in the four bins whose middles it lies between, in parts; a ring has the mean change of its voxels
    times its true volume. So the lattice's counting is not in it.
    """
    u, side = np.array(scene.direction), scene.density.shape[0]
    half = 0.4 * side
    change = found.astype(np.float64).ravel() - scene.density.ravel()
    offsets = np.indices(scene.density.shape).reshape(3, -1) - (side - 1) / 2
    along = u @ offsets
    radius = np.sqrt(np.maximum((offsets**2).sum(axis=0) - along**2, 0.0))
    near = (np.abs(along) < half) & (radius < half)
    place = np.stack([along[near] + half, radius[near]]) / width
    low = np.floor(place).astype(int)
    shape = (int(2 * half / width) + 2, int(half / width) + 2)
    total, voxels = np.zeros(shape), np.zeros(shape)
    for corner in np.ndindex(2, 2):
        part = np.prod([p - i if c else 1.0 - (p - i) for p, i, c in zip(place, low, corner)], axis=0)
        at = (low[0] + corner[0], low[1] + corner[1])
        np.add.at(total, at, part * change[near])
        np.add.at(voxels, at, part)
    radii = np.arange(shape[1]) * width
    area = np.pi * ((radii + width / 2) ** 2 - np.maximum(radii - width / 2, 0.0) ** 2)
    return total / np.maximum(voxels, 1e-9) * area * width
