# SPDX-License-Identifier: GPL-3.0-or-later
"""The sweep on a grid of half the resolution, whose change is brought back to the fine grid with all of its mass.

Restriction: a coarse voxel has the mean density of its eight. Prolongation: what it gained goes to the eight in
proportion to the room that each has, what it lost is taken from them in proportion to what each holds; since their room
and their mass are eight times the coarse voxel's own, neither ever runs out. Wrong: nothing is sharper than two voxels,
and some of what is pushed out of the tool lands in the fine voxels of its skin.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..method import Method, Scene, Vector
from .sweep import Pushing


def restricted(fine: np.ndarray) -> np.ndarray:
    """Means over blocks of 2 x 2 x 2: float64 (nx/2, ny/2, nz/2) of an array with even sides."""
    nx, ny, nz = (n // 2 for n in fine.shape)
    return fine.reshape(nx, 2, ny, 2, nz, 2).mean(axis=(1, 3, 5), dtype=np.float64)


def repeated(coarse: np.ndarray) -> np.ndarray:
    """Every voxel eight times."""
    return coarse.repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2)


def prolonged(fine: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """``fine`` changed so that its restriction is ``wanted`` (each in [0, 1]): float64, in [0, 1] too."""
    fine = fine.astype(np.float64)
    have = restricted(fine)
    change = wanted - have
    filled = np.divide(change, 1.0 - have, out=np.zeros_like(have), where=change > 0.0)
    emptied = np.divide(-change, have, out=np.zeros_like(have), where=change < 0.0)
    return np.clip(fine + repeated(filled) * (1.0 - fine) - repeated(emptied) * fine, 0.0, 1.0)


class Coarse:
    """A push on the coarse grid, and the fine one that follows it where it changes."""

    def __init__(self, scene: Scene) -> None:
        self._shape = scene.density.shape
        padded = np.pad(scene.density, [(0, n % 2) for n in self._shape])
        self._fine = padded
        band = None if scene.band is None else scene.band / 2.0
        self._inner = Pushing(
            replace(scene, density=restricted(padded).astype(np.float32), radius=scene.radius / 2.0, band=band),
            band=band,
        )

    @property
    def density(self) -> np.ndarray:
        nx, ny, nz = self._shape
        return self._fine[:nx, :ny, :nz]

    def move_to(self, position: Vector) -> float:
        """Newtons against the push."""
        x, y, z = ((p - 0.5) / 2.0 for p in position)  # the first coarse centre lies between fine ones
        force = self._inner.move_to((x, y, z))
        contact = self._inner.contact
        if contact is not None and contact.dirty is not None:
            low, high = contact.dirty
            coarse = tuple(slice(a, b) for a, b in zip(low, high))
            fine = tuple(slice(2 * a, 2 * b) for a, b in zip(low, high))
            self._fine[fine] = prolonged(self._fine[fine], self._inner.density[coarse].astype(np.float64))
        return force


METHODS = [Method("coarse sweep", "half the resolution", Coarse)]
