# SPDX-License-Identifier: GPL-3.0-or-later
"""What is kept of a press: force, contact and rim over depth, and at some depths the surface and the density.

Lengths are in radii R of the sphere, forces in E R^2, stresses in E. z = 0 is the surface at first, up is positive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from .solid import Solid

CELL = 1.0 / 16.0
"""Edge of a cell of the density's raster: that of a voxel under a sphere of 16 voxels."""
TOP, ROWS, COLUMNS = 0.5, 48, 48
"""The raster reaches from z = TOP down by ROWS cells, and from the axis outward by COLUMNS."""
PROFILE_R = np.linspace(0.0, 3.0, 241)
"""Where the surface is kept."""


@dataclass(frozen=True)
class Press:
    """On one mesh; fields as in Indentation, ``rim`` and ``edge`` (m,) over the depth."""

    size: float
    depth: np.ndarray
    force: np.ndarray
    contact_radius: np.ndarray
    kinetic: float
    depths: np.ndarray
    rim: np.ndarray
    rim_radius: np.ndarray
    edge: np.ndarray
    profile_z: np.ndarray
    density: np.ndarray


def contact_radius(r: np.ndarray, z: np.ndarray, touching: np.ndarray, depth: float) -> float:
    """Where the surface, nodes (n,), leaves the sphere, told between nodes.

    The gap opens as (r - a)^(3/2) (Johnson, Contact Mechanics, 4.3), so its power 2/3 is a line: that through the first
    two free nodes, kept between the last that touches and the first that does not.
    """
    if not touching.any():
        return 0.0
    last = int(np.nonzero(touching)[0][-1])
    gap = np.maximum(np.hypot(r[last + 1 : last + 3], z[last + 1 : last + 3] - (1.0 - depth)) - 1.0, 0.0) ** (2.0 / 3.0)
    inner, outer = r[last + 1], r[last + 2]
    a = inner - gap[0] * (outer - inner) / (gap[1] - gap[0]) if gap[1] > gap[0] else inner
    return float(np.clip(a, r[last], inner))


def rim(r: np.ndarray, z: np.ndarray) -> tuple[float, float]:
    """Height and place of the highest point of the surface (n,), told between nodes by a spline through the free part.

    The far field sinks a little and comes back to 0: where nothing stands above it, (0, nan).
    """
    highest = int(np.argmax(z))
    if z[highest] <= 0.0 or r[highest] > PROFILE_R[-1]:
        return 0.0, np.nan
    near = slice(max(highest - 3, 0), highest + 4)
    fine = np.linspace(r[max(highest - 1, 0)], r[highest + 1], 65)
    heights = CubicSpline(r[near], z[near])(fine)
    return float(heights.max()), float(fine[heights.argmax()])


def volumes(r: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Of the rings with the elements between nodes (across, down) as sections: area x 2 pi x its centroid's radius."""
    r0, r1, r2, r3 = r[:-1, 1:], r[1:, 1:], r[1:, :-1], r[:-1, :-1]
    z0, z1, z2, z3 = z[:-1, 1:], z[1:, 1:], z[1:, :-1], z[:-1, :-1]
    first = 0.5 * ((r1 - r0) * (z2 - z0) - (r2 - r0) * (z1 - z0))
    second = 0.5 * ((r2 - r0) * (z3 - z0) - (r3 - r0) * (z2 - z0))
    return 2.0 * np.pi / 3.0 * (first * (r0 + r1 + r2) + second * (r0 + r2 + r3))


def filled(r: np.ndarray, z: np.ndarray) -> np.ndarray:
    """How much of each ring of the raster, (ROWS, COLUMNS), lies under the surface (n,)."""
    across = (np.arange(32 * COLUMNS) + 0.5) * CELL / 32
    height = np.interp(across, r, z)
    bottom = TOP - CELL * (np.arange(ROWS) + 1.0)
    share = np.clip((height - bottom[:, None]) / CELL, 0.0, 1.0) * across
    return share.reshape(ROWS, COLUMNS, 32).sum(axis=2) / across.reshape(COLUMNS, 32).sum(axis=1)


def crushed(r: np.ndarray, z: np.ndarray, ratio: np.ndarray, solid: Solid) -> np.ndarray:
    """Mean over each ring of the raster of rho / rho0, ``ratio`` (across - 1, down - 1) in the elements.

    1 where no element is, and for a dense solid, whose volume changes by its elastic strain only. Each element is cut
    into so many equal parts that they are a tenth of a cell; a part counts where its middle lies.
    """
    if solid.alpha == 0.0:
        return np.ones((ROWS, COLUMNS))
    held, volume = np.zeros(ROWS * COLUMNS), np.zeros(ROWS * COLUMNS)
    wide = (r[:-1, 0] < COLUMNS * CELL)[:, None] & (z[:-1, :-1] > TOP - ROWS * CELL)
    for i, j in zip(*np.nonzero(wide)):
        rs, zs = r[i : i + 2, j : j + 2], z[i : i + 2, j : j + 2]
        parts = int(np.ceil(10.0 * max(np.ptp(rs), np.ptp(zs)) / CELL))
        u = (np.arange(parts) + 0.5) / parts
        blend = np.array([1.0 - u, u])
        at_r, at_z = blend.T @ rs @ blend, blend.T @ zs @ blend
        # Jacobian of the bilinear map, at each part: across (v,) and down (u, 1).
        r_across, z_across = (rs[1] - rs[0]) @ blend, (zs[1] - zs[0]) @ blend
        r_down, z_down = ((rs[:, 1] - rs[:, 0]) @ blend)[:, None], ((zs[:, 1] - zs[:, 0]) @ blend)[:, None]
        size = at_r * abs(r_across * z_down - z_across * r_down) / parts**2
        row, column = np.floor((TOP - at_z) / CELL).astype(int), np.floor(at_r / CELL).astype(int)
        inside = (row >= 0) & (row < ROWS) & (column < COLUMNS)
        cells = row[inside] * COLUMNS + column[inside]
        held += np.bincount(cells, size[inside] * ratio[i, j], ROWS * COLUMNS)
        volume += np.bincount(cells, size[inside], ROWS * COLUMNS)
    return np.where(volume > 0.0, held / np.maximum(volume, 1e-300), 1.0).reshape(ROWS, COLUMNS)
