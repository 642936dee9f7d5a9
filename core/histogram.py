# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of a volume has which density."""

from __future__ import annotations

import numpy as np

BINS = 32
"""Of density: as many as one property of Blender's holds."""
SAMPLE = 1 << 20
"""Voxels looked at, at most: it takes as long for any larger grid, and a picture shows no more."""


def histogram(density: np.ndarray) -> np.ndarray:
    """Voxels by density, shape (BINS,) float64: the n-th of those with n / BINS < density <= (n + 1) / BINS.

    Empty voxels are not counted. Of more than SAMPLE voxels every k-th along each axis is looked at, and stands
    for k**3.
    """
    stride = 1
    while density[::stride, ::stride, ::stride].size > SAMPLE:
        stride += 1
    levels = np.ceil(density[::stride, ::stride, ::stride] * np.float32(BINS)).astype(np.uint8)
    return np.bincount(levels.ravel(), minlength=BINS + 1)[1:].astype(np.float64) * float(stride) ** 3
