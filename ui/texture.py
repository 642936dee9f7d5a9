# SPDX-License-Identifier: GPL-3.0-or-later
"""A grid's density on the graphics card, kept up box by box, and the greatest density of each brick beside it."""

from __future__ import annotations

import gpu
import numpy as np
from gpu.types import Buffer, GPUShader, GPUTexture

from ..core.grid import BRICK, Box
from . import shaders

DENSITY_FORMAT = "R16F"
"""11 bits, enough to look at, and half the memory of the array."""
BRICK_FORMAT = "R16F"
ROUNDED = 1.0 + 2.0**-9
"""Half floats round, and some drivers cut off; what is asked of a brick is an upper bound."""


class DensityTexture:
    """Texture x is the grid's axis 2, so that arrays are uploaded as they lie.

    ``density`` (nz, ny, nx texels) and ``bricks``, one texel for each brick: no density that is interpolated within the
    brick exceeds it. ``uploads`` and ``patches`` count what was sent.
    """

    def __init__(self) -> None:
        self.density: GPUTexture | None = None
        self.bricks: GPUTexture | None = None
        self.shape = (0, 0, 0)
        self.uploads = self.patches = 0
        self._shader: GPUShader | None = None

    def upload(self, density: np.ndarray) -> None:
        """Send a whole grid, float32 (nx, ny, nz), C-contiguous. ValueError where the graphics card cannot hold it."""
        self.density = self.bricks = None  # the former goes first: there may not be room for both
        try:
            self.density = _texture(density, DENSITY_FORMAT)
        except (RuntimeError, OverflowError, MemoryError) as error:
            size = " x ".join(str(n) for n in density.shape)
            raise ValueError(f"The graphics card cannot hold {size} voxels: resample the volume to fewer") from error
        self.shape = density.shape
        self.bricks = _texture(brick_maxima(density, (0, 0, 0), _bricks(density.shape)), BRICK_FORMAT)
        self.uploads += 1

    def patch(self, density: np.ndarray, box: Box) -> None:
        """Send the voxels of a half-open box of the grid that was uploaded."""
        low = [min(max(v, 0), n) for v, n in zip(box[0], self.shape)]
        high = [min(max(v, 0), n) for v, n in zip(box[1], self.shape)]
        if any(a >= b for a, b in zip(low, high)):
            return
        if self._shader is None:
            self._shader = shaders.patch_shader(DENSITY_FORMAT)
        self._store(self.density, density[tuple(slice(a, b) for a, b in zip(low, high))], low)
        # Interpolation reaches one voxel beyond, and with it into the next brick.
        first = [max(v - 1, 0) // BRICK for v in low]
        last = [min(v // BRICK + 1, n) for v, n in zip(high, _bricks(self.shape))]
        self._store(self.bricks, brick_maxima(density, first, last), first)
        self.patches += 1

    def _store(self, texture: GPUTexture, values: np.ndarray, first: list[int]) -> None:
        shader, size, sent = self._shader, values.shape[::-1], _texture(values, "R32F")
        shader.bind()
        shader.uniform_sampler("patch_", sent)
        shader.image("density", texture)
        shader.uniform_int("first", first[::-1])
        shader.uniform_int("size", size)
        gpu.compute.dispatch(shader, *(-(-n // shaders.GROUP) for n in size))


def brick_maxima(density: np.ndarray, first, last) -> np.ndarray:
    """The greatest density of each brick from ``first`` up to ``last`` (indices of bricks) and of the voxels around."""
    low = [max(b * BRICK - 1, 0) for b in first]
    part = density[tuple(slice(a, b * BRICK + 1) for a, b in zip(low, last))]
    for axis, (begin, end) in enumerate(zip(first, last)):
        along = np.moveaxis(part, axis, 0)  # whole planes at a time: numpy's reduceat takes thirteen times as long
        reached = [slice(max(b * BRICK - 1, 0) - low[axis], (b + 1) * BRICK + 1 - low[axis]) for b in range(begin, end)]
        part = np.stack([along[planes].max(axis=0) for planes in reached], axis)
    return part * np.float32(ROUNDED)


def _bricks(shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(-(-n // BRICK) for n in shape)


def _texture(values: np.ndarray, texture_format: str) -> GPUTexture:
    values = np.ascontiguousarray(values, np.float32)
    return GPUTexture(values.shape[::-1], format=texture_format, data=Buffer("FLOAT", values.size, values.ravel()))
