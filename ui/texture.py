# SPDX-License-Identifier: GPL-3.0-or-later
"""A grid's density on the graphics card, kept up box by box, and what is in each of its bricks beside it."""

from __future__ import annotations

from collections.abc import Sequence

import gpu
import numpy as np
from gpu.types import Buffer, GPUTexture

from ..core.bricks import BRICK, BrickMap
from ..core.grid import Box
from . import programs, shaders
from .bricks import all_maxima, all_means, bricks_of, maxima, means

FORMAT = "R16F"
"""11 bits, enough to look at, and half the memory of the array."""


class DensityTexture:
    """Texture x is the grid's axis 2, so that arrays are uploaded as they lie.

    ``density`` (nz, ny, nx texels) holds the voxels, ``eased`` and ``fillings`` the means of bricks of
    `shaders.EASE` and of BRICK voxels, ``bricks`` the most there is in each of the latter.
    ``uploads`` and ``patches`` count what was sent.
    """

    def __init__(self) -> None:
        self.density: GPUTexture | None = None
        self.eased: GPUTexture | None = None
        self.fillings: GPUTexture | None = None
        self.bricks: GPUTexture | None = None
        self.shape = (0, 0, 0)
        self.uploads = self.patches = 0

    def upload(self, known: BrickMap) -> None:
        """Send a whole grid, which ``known`` is the map of. ValueError where the graphics card cannot hold it."""
        self.density = self.eased = self.fillings = self.bricks = None  # there may not be room for old and new
        size = known.density.shape
        try:
            self.density = _texture(known.density, FORMAT)
        except (RuntimeError, OverflowError, MemoryError) as error:
            voxels = " x ".join(str(n) for n in size)
            raise ValueError(f"The graphics card cannot hold {voxels} voxels: resample the volume to fewer") from error
        self.eased = _texture(all_means(known, shaders.EASE), FORMAT)
        self.fillings = _texture(all_means(known, BRICK), FORMAT)
        self.bricks = _texture(all_maxima(known), FORMAT)
        self.shape = size
        self.uploads += 1

    def patch(self, density: np.ndarray, box: Box) -> None:
        """Send the voxels of a half-open box of the grid that was uploaded."""
        low = [min(max(v, 0), n) for v, n in zip(box[0], self.shape)]
        high = [min(max(v, 0), n) for v, n in zip(box[1], self.shape)]
        if any(a >= b for a, b in zip(low, high)):
            return
        self._store(self.density, density[tuple(slice(a, b) for a, b in zip(low, high))], low)
        for texture, edge in ((self.eased, shaders.EASE), (self.fillings, BRICK)):
            first, last = [v // edge for v in low], [-(-v // edge) for v in high]
            self._store(texture, means(density, edge, first, last), first)
        # Interpolation reaches one voxel beyond, and with it into the next brick.
        first = [max(v - 1, 0) // BRICK for v in low]
        last = [min(v // BRICK + 1, n) for v, n in zip(high, bricks_of(self.shape))]
        self._store(self.bricks, maxima(density, first, last), first)
        self.patches += 1

    def _store(self, texture: GPUTexture, values: np.ndarray, first: Sequence[int]) -> None:
        shader, size, sent = programs.patch(FORMAT), values.shape[::-1], _texture(values, "R32F")
        shader.bind()
        shader.uniform_sampler("sent", sent)  # which must live until the dispatch
        shader.image("kept", texture)
        shader.uniform_int("first", first[::-1])
        shader.uniform_int("size", size)
        gpu.compute.dispatch(shader, *(-(-n // edge) for n, edge in zip(size, shaders.GROUP)))


def _texture(values: np.ndarray, texture_format: str) -> GPUTexture:
    values = np.ascontiguousarray(values, np.float32)
    return GPUTexture(values.shape[::-1], format=texture_format, data=Buffer("FLOAT", values.size, values.ravel()))
