# SPDX-License-Identifier: GPL-3.0-or-later
"""At which density a volume's surface is seen, where nobody has said."""

from __future__ import annotations

import numpy as np

BINS = 256
SAMPLE = 1 << 20
"""Voxels looked at, at most: every k-th along each axis of a larger grid."""
DISTINCT = 0.8
"""Share of the densities' variance that two classes must explain to be empty and full: one cluster, cut in two, gives
.64 (a Gaussian) to .75 (an even spread)."""


def automatic_level(density: np.ndarray) -> float:
    """The density in (0, 1) that best parts the empty from the full voxels of (nx, ny, nz) float32 in [0, 1].

    That is Otsu's threshold, the middle of the range in which it is equally good. Where the densities do not fall into
    two classes (all alike, or spread evenly), and so no threshold parts them, half the mean of those above 0.
    """
    stride = 1
    while density[::stride, ::stride, ::stride].size > SAMPLE:
        stride += 1
    levels = np.rint(density[::stride, ::stride, ::stride] * np.float32(BINS - 1)).astype(np.uint8)
    counts = np.bincount(levels.ravel(), minlength=BINS).astype(np.float64)
    values = np.arange(BINS) / (BINS - 1)
    share = counts / counts.sum()
    below, moment = np.cumsum(share), np.cumsum(share * values)
    mean = moment[-1]
    parts = below * (1.0 - below)
    parted = np.flatnonzero(parts > 1e-12)
    variance = float((share * (values - mean) ** 2).sum())
    if len(parted):
        between = (mean * below[parted] - moment[parted]) ** 2 / parts[parted]
        best = parted[between >= between.max() * (1.0 - 1e-9)]
        if between.max() > DISTINCT * variance and best[0] < BINS - 1:
            return float(0.5 * (values[best[0]] + values[min(best[-1] + 1, BINS - 1)]))
    filled = 1.0 - share[0]
    return float(0.5 * mean / filled) if filled else 0.5
