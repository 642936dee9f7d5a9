# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures without a window: a camera, a stage to draw on, and what was drawn as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import gpu
import numpy as np
from mathutils import Matrix

from repousse.ui.live_view import Frame, LiveView

WIDTH, HEIGHT = 160, 120
NEAR, FAR = 1.0, 1000.0
GROUND = 0.05
"""What the stage shows where nothing is drawn."""


def no_graphics() -> str | None:
    """Why this Blender cannot draw here; None where it can."""
    if not hasattr(gpu, "init"):
        return f"Blender {bpy.app.version_string} draws nothing without a window"
    try:
        gpu.init()
        gpu.types.GPUOffScreen(8, 8)
    except (SystemError, RuntimeError) as error:
        return f"Blender has no graphics here: {error}"
    return None


@dataclass(frozen=True)
class Camera:
    """Looks from ``eye`` at ``target``; ``half``: half of what it sees from below to above, as a tangent.

    Without ``perspective`` it is a length.
    """

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    half: float = 0.45
    perspective: bool = True
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @property
    def view(self) -> np.ndarray:
        towards = np.subtract(self.eye, self.target) / np.linalg.norm(np.subtract(self.eye, self.target))
        right = np.cross(self.up, towards)
        right /= np.linalg.norm(right)
        matrix = np.eye(4)
        matrix[:3, :3] = right, np.cross(towards, right), towards
        matrix[:3, 3] = -matrix[:3, :3] @ self.eye
        return matrix

    @property
    def projection(self) -> np.ndarray:
        matrix = np.diag([HEIGHT / WIDTH / self.half, 1.0 / self.half, 0.0, 0.0])
        if self.perspective:
            matrix[2] = 0.0, 0.0, -(FAR + NEAR) / (FAR - NEAR), -2.0 * FAR * NEAR / (FAR - NEAR)
            matrix[3, 2] = -1.0
        else:  # as Blender's own views: what is behind them is seen too
            matrix[2, 2], matrix[3, 3] = -1.0 / FAR, 1.0
        return matrix


@dataclass(frozen=True)
class Picture:
    """Rows from below. ``colour`` (HEIGHT, WIDTH, 4), linear; ``depth`` (HEIGHT, WIDTH), 1: as far as can be."""

    colour: np.ndarray
    depth: np.ndarray
    camera: Camera

    @property
    def seen(self) -> np.ndarray:
        """Where something was drawn."""
        return self.depth < 1.0

    @property
    def luminance(self) -> np.ndarray:
        return self.colour[..., :3] @ (0.2126, 0.7152, 0.0722)

    def unprojected(self, depth: np.ndarray | float, to_world: np.ndarray) -> np.ndarray:
        """Voxel coordinates (HEIGHT, WIDTH, 3) of the middles of pixels at a depth from 0 to 1."""
        y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
        clip = [2.0 * x / WIDTH - 1.0, 2.0 * y / HEIGHT - 1.0, 2.0 * depth - 1.0 + 0.0 * x, np.ones_like(x)]
        points = np.stack(clip, -1) @ np.linalg.inv(self.camera.projection @ self.camera.view @ to_world).T
        return points[..., :3] / points[..., 3:]

    def points(self, to_world: np.ndarray) -> np.ndarray:
        """Voxel coordinates (HEIGHT, WIDTH, 3) of what is seen in each pixel."""
        return self.unprojected(self.depth, to_world)


class Stage:
    """Something to draw on, with the matrices of a camera set as Blender sets them for its views."""

    def __init__(self) -> None:
        self._buffers = gpu.types.GPUOffScreen(WIDTH, HEIGHT, format="RGBA16F")

    def picture(self, camera: Camera, *drawings) -> Picture:
        """What one after the other of these functions draws."""
        with self._buffers.bind(), gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
            buffer = gpu.state.active_framebuffer_get()
            buffer.clear(color=(GROUND, GROUND, GROUND, 1.0), depth=1.0)
            gpu.matrix.load_matrix(Matrix(camera.view.tolist()))
            gpu.matrix.load_projection_matrix(Matrix(camera.projection.tolist()))
            for draw in drawings:
                draw()
            colour = as_array(buffer.read_color(0, 0, WIDTH, HEIGHT, 4, 0, "FLOAT"), (HEIGHT, WIDTH, 4))
            depth = as_array(buffer.read_depth(0, 0, WIDTH, HEIGHT), (HEIGHT, WIDTH))
        return Picture(colour, depth, camera)


def drawing(view: LiveView, camera: Camera, to_world=None, fog=False, level=0.5, gives=(), key=1):
    """A function that draws a view's texture."""
    to_view = camera.view @ (np.eye(4) if to_world is None else to_world)
    frame = Frame.of(camera.projection, to_view, WIDTH, HEIGHT, level, fog=fog, gives=gives)
    return lambda: view.draw(key, frame)


def as_array(buffer: gpu.types.Buffer, shape: tuple[int, ...]) -> np.ndarray:
    """What was read back, without the lists that Blender makes of it."""
    buffer.dimensions = int(np.prod(shape))
    return np.array(buffer, np.float32).reshape(shape)
