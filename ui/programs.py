# SPDX-License-Identifier: GPL-3.0-or-later
"""What the graphics card runs for the live view, compiled once and kept until the add-on goes.

A program that is freed and made again now and then draws nothing at first (seen with OpenGL: what the context knows of
it is kept by its address), and compiling takes longer than a frame.
"""

from __future__ import annotations

import functools

from gpu.types import GPUBatch, GPUShader
from gpu_extras.batch import batch_for_shader

from . import shaders


class Screen:
    """A program that covers what is bound, and the triangle that it does so with."""

    def __init__(self, shader: GPUShader) -> None:
        self.shader = shader
        self._triangle: GPUBatch = batch_for_shader(shader, "TRIS", {"corner": shaders.COVERING})

    def draw(self) -> None:
        """With what the shader has been told."""
        self._triangle.draw(self.shader)


@functools.cache
def march(fog: bool, gives: bool) -> Screen:
    """See `shaders.march_shader`."""
    return Screen(shaders.march_shader(fog, gives))


@functools.cache
def composite() -> Screen:
    """See `shaders.composite_shader`."""
    return Screen(shaders.composite_shader())


@functools.cache
def patch(texture_format: str) -> GPUShader:
    """See `shaders.patch_shader`."""
    return shaders.patch_shader(texture_format)


def free() -> None:
    """Let go of all of them."""
    for made in (march, composite, patch):
        made.cache_clear()
