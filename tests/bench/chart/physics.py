# SPDX-License-Identifier: GPL-3.0-or-later
"""The finite elements' press as the chart's scenes have it: in voxels of a sixteenth of the tool's radius."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy import ndimage

from ..truths import Indentation, load
from ..truths.measures import CELL, PROFILE_R, TOP
from . import errors, scenes
from .method import Scene

RADIUS, SIDE, MATERIAL, AIR = 16.0, 96, 64, 24
YIELD_RATIO = {"foam": 0.10, "mises": 0.05}
"""kappa of the presets foam and clay."""


@cache
def truth(name: str) -> Indentation:
    """The finite elements' press of that name."""
    return load(name)


def crushable(name: str) -> bool:
    """Whether density is compared; else occupancy."""
    return truth(name).case.crushable


@cache
def scene(name: str, side: int = SIDE) -> Scene:
    """The press of a truth in voxels: foam as full as it is, without a band; a dense solid with the band R ahead.

    ``side`` other than 96 scales it all.
    """
    solid, scale = truth(name).case, side / SIDE
    radius = RADIUS * scale
    depth = float(truth(name).depths[-1]) * radius
    density, band = (solid.solid.filled, None) if solid.crushable else (1.0, radius)
    kappa = YIELD_RATIO[name.partition("-")[0]]
    return scenes.press(side, round(MATERIAL * scale), round(AIR * scale), radius, depth, density, kappa, band)


def force(name: str, pressed: Scene) -> np.ndarray:
    """The truth's force at the steps of its scene (n,), in E R^2."""
    found = truth(name)
    return np.interp(scenes.depths(pressed) / pressed.radius, found.depth, found.force, left=0.0)


def _radius(pressed: Scene) -> np.ndarray:
    """Distance of each column from the axis, voxels (nx, ny)."""
    side = np.arange(pressed.density.shape[0]) - (pressed.density.shape[0] - 1) / 2
    return np.hypot(side[:, None], side[None, :])


def surface(pressed: Scene, profile: np.ndarray) -> np.ndarray:
    """Heights (nx, ny) over the first surface in voxels, of those of a profile in radii at ``PROFILE_R`` (k,)."""
    return pressed.radius * np.interp(_radius(pressed) / pressed.radius, PROFILE_R, profile, right=0.0)


def density(pressed: Scene, raster: np.ndarray) -> np.ndarray:
    """Density (nx, ny, nz) float64, of a raster (nz, nr) of rho / rho0 as the truths have it."""
    height = np.arange(pressed.density.shape[2]) - (scenes.face(pressed) - 0.5)
    r = _radius(pressed) / pressed.radius / CELL - 0.5
    z = (TOP - height / pressed.radius) / CELL - 0.5
    rows, columns = np.broadcast_arrays(z[None, None, :], r[:, :, None])
    ratio = ndimage.map_coordinates(raster, [rows, columns], order=1, mode="nearest")
    deeper = rows > raster.shape[0] - 0.5  # than the raster reaches
    return np.where(deeper, 1.0, ratio) * float(pressed.density.max())


def rim(pressed: Scene, values: np.ndarray) -> float:
    """Greatest height of the surface d = d0/2 over where it was, as a share of the depth.

    Of means over rings a voxel wide around the push: a single voxel's step is not a rim.
    """
    height = heights(pressed, values)
    ring = np.floor(_radius(pressed)).astype(int)
    within = ring < pressed.density.shape[0] // 2
    means = np.bincount(ring[within], height[within]) / np.bincount(ring[within])
    return float(max(means.max(), 0.0)) / float(scenes.depths(pressed)[-1])


def heights(pressed: Scene, values: np.ndarray) -> np.ndarray:
    """The surface d = d0/2 over where it was, voxels (nx, ny)."""
    whole = float(pressed.density.max())
    return errors.surface(values / whole, 2, 1) - (scenes.face(pressed) - 0.5)
