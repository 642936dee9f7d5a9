# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines of sight: what a view's matrices mean for one who marches through voxels. In float64, for shaders have less."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.grid import Box

NEAR, AHEAD = -1.0, 0.9
"""Depths, of the -1 .. 1 in view, that give a line of sight its direction: the far plane may be at infinity."""


@dataclass(frozen=True)
class Sight:
    """The view of a volume.

    All (3,) in voxels. The line of sight at (x, y), both from -1 to 1 over the picture, begins at
    start[0] + x start[1] + y start[2], and goes the way way[0] + x way[1] + y way[2], of any length.
    ``normals`` (3, 3): the slope of what is in the voxels into the viewer's axes: right, up, and back.
    ``to_clip`` (4, 4): voxels to clip space.
    """

    start: np.ndarray
    way: np.ndarray
    normals: np.ndarray
    to_clip: np.ndarray

    @classmethod
    def of(cls, projection: np.ndarray, to_view: np.ndarray, shape: tuple[int, int, int]) -> Sight | None:
        """From (4, 4) matrices: view to clip space, and voxels to the view. None when these are flat."""
        to_clip = projection @ to_view
        if not np.isfinite(to_clip).all() or np.linalg.det(to_view[:3, :3]) == 0.0:
            return None
        from_clip = np.linalg.inv(to_clip)

        def at(x: float, y: float, depth: float) -> np.ndarray:
            point = from_clip @ (x, y, depth, 1.0)
            return point[:3] / point[3]

        start, ahead = (
            np.array([at(0.0, 0.0, depth), at(1.0, 0.0, depth), at(0.0, 1.0, depth)]) for depth in (NEAR, AHEAD)
        )
        way = ahead - start
        for planes in (start, way):
            planes[1:] -= planes[0]
        length = np.linalg.norm(way[0])
        if np.abs(way[1:]).max() < 1e-9 * length:  # all go the same way: begin near the volume, however far the viewer
            way[1:] = 0.0
            middle = (np.array(shape) - 1.0) / 2.0
            gap = way[0] @ (middle - start[0]) / length - np.linalg.norm(shape)
            start[0] += max(gap, 0.0) * way[0] / length
        normals = np.linalg.inv(to_view[:3, :3]).T
        return cls(start, way / length, normals / np.cbrt(abs(np.linalg.det(normals))), to_clip)

    def rectangle(self, box: Box, margin: float, width: int, height: int) -> tuple[int, int, int, int] | None:
        """Pixels (x, y, width, height) of a picture in which the voxels of a box are seen, and ``margin`` voxels more.

        All of it when the box reaches behind the viewer; None when it is out of sight.
        """
        ends = np.array(box, np.float64) + np.array([[-margin - 1.0], [margin]])
        corners = np.array([(ends[i][0], ends[j][1], ends[k][2], 1.0) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        clip = corners @ self.to_clip.T
        if clip[:, 3].min() <= 0.0:
            return 0, 0, width, height
        seen = (clip[:, :2] / clip[:, 3:] + 1.0) * (0.5 * width, 0.5 * height)
        low = np.clip(np.floor(seen.min(axis=0)) - 1, 0, (width, height)).astype(int)
        high = np.clip(np.ceil(seen.max(axis=0)) + 1, 0, (width, height)).astype(int)
        if (high <= low).any():
            return None
        (x, y), (w, h) = low.tolist(), (high - low).tolist()
        return x, y, w, h
