# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's recursion, literally, with the budget that core/recursion.py gives it; and the same in a mirror.

In a mirror equally deep voxels come in another order. Nothing in the paper says which, so the distance between the two
is what the recursion does not know about itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..method import Method, Scene, Vector
from .sweep import Pushing


def literal(scene: Scene) -> Pushing:
    """The recursion of section 7."""
    return Pushing(scene, method="recursive")


class Mirrored:
    """The recursion in a scene that is mirrored along all three axes, shown as if it were not."""

    def __init__(self, scene: Scene) -> None:
        self._last = np.array(scene.density.shape) - 1.0
        x, y, z = scene.direction
        self._inner = literal(replace(scene, density=scene.density[::-1, ::-1, ::-1].copy(), direction=(-x, -y, -z)))

    @property
    def density(self) -> np.ndarray:
        return self._inner.density[::-1, ::-1, ::-1]

    def move_to(self, position: Vector) -> float:
        """Newtons against the push."""
        x, y, z = (float(n - p) for n, p in zip(self._last, position))
        return self._inner.move_to((x, y, z))


METHODS = [Method("recursive", "literal", literal), Method("recursive", "ties in another order", Mirrored)]
