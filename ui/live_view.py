# SPDX-License-Identifier: GPL-3.0-or-later
"""The live view: the volume that is sculpted, marched on the graphics card from the array that the kernels write into.

A stroke sends only the box that it changed. The march goes into a picture of its own, which is drawn again as it is
for as long as nothing in it would change: a cursor that moves costs no march.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import sqrt
from weakref import WeakKeyDictionary

import bpy
import gpu
import numpy as np
from gpu.types import Buffer, GPUFrameBuffer, GPUShader, GPUTexture, GPUUniformBuf
from gpu_extras.batch import batch_for_shader

from ..core.engine import Engine
from ..core.tool import Vector, vector
from ..operators.automatic_level import level_of
from ..operators.session import Session, give_back_displays, live
from . import shaders
from .texture import DensityTexture

FOG_OPACITY = 0.06
"""Optical depth of a full voxel in fog."""
PATIENCE = 0.008
"""Seconds for which a frame waits for the poses that it is to show."""
MOST_VIEWS = 8
"""Views whose pictures are kept."""
GIVE_WIDTH = 0.7
"""Width of the bow under a loaded tool, in its radii."""


@dataclass(frozen=True)
class Give:
    """How the surface bows under a tool that loads it elastically, in voxels: by what, where, and how wide."""

    by: Vector = (0.0, 0.0, 0.0)
    at: Vector = (0.0, 0.0, 0.0)
    width: float = 1.0

    @classmethod
    def under(cls, engine: Engine, origin) -> Give:
        """Of a running push: as deep as a cap of the ball that holds the mass which the tool has not moved."""
        push, contact = engine.push, engine.contact
        if contact.stress <= 0.0 or not engine.solved or push.verb != "push":
            return NO_GIVE
        sample, force = engine.solved[-1], float(np.linalg.norm(contact.force))
        way = sample.direction or (vector(-contact.force / force) if force > 0.0 else None)
        if way is None:
            return NO_GIVE
        radius = push.tool.radius
        deep = cap_height(contact.stress / push.k_t, radius)
        tip = [p + u * radius - o for p, u, o in zip(sample.position, way, origin)]
        return cls(vector(deep * u for u in way), vector(tip), GIVE_WIDTH * radius)


NO_GIVE = Give()


def cap_height(volume: float, radius: float) -> float:
    """Height of the cap of a ball that has this volume, V = pi h^2 (3 R - h) / 3, up to a radius."""
    share = min(max(3.0 * volume / (np.pi * radius**3), 0.0), 2.0)
    height = sqrt(share / 3.0)
    for _ in range(4):  # Newton on h^2 (3 - h) = share, from below; half a ball at the most
        height += (share - height**2 * (3.0 - height)) / max(height * (6.0 - 3.0 * height), 1e-9)
    return radius * min(height, 1.0)


@dataclass(frozen=True)
class Frame:
    """All that a picture depends on but the voxels: two that are equal look the same.

    ``to_clip``: the (4, 4) matrix from voxels to clip space, and ``to_world``: to the world, as bytes of float64.
    ``to_view``: that of the view; ``fog``, ``level`` and ``give`` as the voxels are to look.
    """

    to_clip: bytes
    to_view: bytes
    width: int
    height: int
    fog: bool
    level: float
    give: Give


class LiveView:
    """One volume's texture, and the pictures that 3D views have of it. ``marches`` counts those that were made."""

    def __init__(self) -> None:
        self.texture = DensityTexture()
        self.marches = 0
        self._version = 0
        self._pictures: dict[int, _Picture] = {}
        self._march: GPUShader | None = None
        self._composite: GPUShader | None = None

    def update(self, session: Session) -> None:
        """Send what has changed since this was last asked."""
        everything, boxes = session.take_changes()
        density = session.grid.density
        if everything or self.texture.shape != density.shape:  # it may have grown since
            self.texture.upload(density)
            self._version += 1
        elif boxes:
            for box in boxes:
                self.texture.patch(density, box)
            self._version += 1

    def draw(self, key: int, frame: Frame) -> None:
        """Draw into what is bound, by the depth that is there; ``key`` stands for the 3D view."""
        if self._march is None or self._composite is None:
            self._march, self._composite = shaders.march_shader(), shaders.composite_shader()
        picture = self._pictures.get(key)
        if picture is None or picture.size != (frame.width, frame.height):
            self._pictures.pop(key, None)
            if len(self._pictures) >= MOST_VIEWS:
                self._pictures.pop(next(iter(self._pictures)))
            picture = self._pictures[key] = _Picture(frame.width, frame.height)
        if picture.shows != (frame, self._version):
            with _state("NONE", False, "NONE"):
                self._make(picture, frame)
            picture.shows = (frame, self._version)
        with _state("LESS_EQUAL", True, "ALPHA_PREMULT"):
            self._show(picture)

    def _make(self, picture: _Picture, frame: Frame) -> None:
        block = GPUUniformBuf(uniforms(frame, self.texture.shape))
        shader = self._march
        # One of its own for each march, for it belongs to the window that it is made in, as textures do not.
        with GPUFrameBuffer(color_slots=(picture.colours, picture.depths)).bind():
            shader.bind()
            shader.uniform_block("march", block)
            shader.uniform_sampler("density", self.texture.density)
            shader.uniform_sampler("bricks", self.texture.bricks)
            _triangle(shader).draw(shader)
        self.marches += 1

    def _show(self, picture: _Picture) -> None:
        shader = self._composite
        shader.bind()
        shader.uniform_sampler("colours", picture.colours)
        shader.uniform_sampler("depths", picture.depths)
        _triangle(shader).draw(shader)


@contextmanager
def _state(depth_test: str, depth_mask: bool, blend: str) -> Iterator[None]:
    """What others draw after us is drawn as before."""
    former = gpu.state.depth_test_get(), gpu.state.depth_mask_get(), gpu.state.blend_get()
    setters = gpu.state.depth_test_set, gpu.state.depth_mask_set, gpu.state.blend_set
    try:
        for put, value in zip(setters, (depth_test, depth_mask, blend)):
            put(value)
        yield
    finally:
        for put, value in zip(setters, former):
            put(value)


class _Picture:
    """A march's colour and depth."""

    def __init__(self, width: int, height: int) -> None:
        self.size = (width, height)
        self.colours = GPUTexture(self.size, format="RGBA16F")
        self.depths = GPUTexture(self.size, format="R32F")
        self.shows: tuple | None = None


def _triangle(shader: GPUShader):
    return batch_for_shader(shader, "TRIS", {"corner": shaders.COVERING})


def uniforms(frame: Frame, shape: tuple[int, int, int]) -> Buffer:
    """The uniform block of a march, by name as `shaders.MARCH_FIELDS` says."""
    to_clip = np.frombuffer(frame.to_clip).reshape(4, 4)
    axes = np.frombuffer(frame.to_view).reshape(4, 4)[:3, :3]
    axes = axes / np.cbrt(abs(np.linalg.det(axes)))
    from_clip = np.linalg.inv(to_clip)
    middle = to_clip @ (*((n - 1) / 2.0 for n in shape), 1.0)
    depth = np.clip(middle[2] / middle[3], -0.999, 0.9999) if middle[3] > 0.0 else 0.0

    def at(x: float, y: float, z: float) -> np.ndarray:
        point = from_clip @ (x, y, z, 1.0)
        return point[:3] / point[3]

    plane = at(0.0, 0.0, depth)
    perspective = bool(np.abs(to_clip[3, :3]).max() > 1e-12)
    if perspective:  # the eye is where clip x, y and w are zero
        eye = np.linalg.solve(to_clip[[0, 1, 3], :3], -to_clip[[0, 1, 3], 3])
    else:
        eye = at(0.0, 0.0, 1.0) - at(0.0, 0.0, -1.0)
        eye /= np.linalg.norm(eye)
        plane = plane - eye * (np.linalg.norm(shape) + np.linalg.norm(plane - (np.array(shape) - 1) / 2.0))
    middle_of_plane, give = at(0.0, 0.0, depth), frame.give
    told = {
        "eye": (*eye, float(perspective)),
        "plane": (*plane, 0.0),
        "across": (*(at(1.0, 0.0, depth) - middle_of_plane), 0.0),
        "up": (*(at(0.0, 1.0, depth) - middle_of_plane), 0.0),
        "shape": (*shape, frame.level),
        "to_view_x": (*axes[0], 0.0),
        "to_view_y": (*axes[1], 0.0),
        "to_view_z": (*axes[2], 0.0),
        "give": (*give.by, float(any(give.by))),
        "give_at": (*give.at, give.width),
        "look": (float(frame.fog), FOG_OPACITY, 0.0, 0.0),
        "clip_z": to_clip[2],
        "clip_w": to_clip[3],
    }
    block = np.array([told[name] for name in shaders.MARCH_FIELDS], np.float32)
    return Buffer("FLOAT", block.size, block.ravel())


def cannot_show(space: bpy.types.SpaceView3D) -> str | None:
    """Why Blender cannot show the live view in a 3D view as it should, in a sentence; None where it can."""
    session = live()
    if session is not None and session in _troubles:
        return _troubles[session]
    if space.overlay.show_overlays or space.shading.type in {"SOLID", "WIREFRAME"}:
        return None
    return "Turn overlays on to see the volume while you sculpt it"


_views: WeakKeyDictionary[Session, LiveView] = WeakKeyDictionary()  # what is on the card goes when its session does
_troubles: WeakKeyDictionary[Session, str] = WeakKeyDictionary()
_handle = None


def _draw() -> None:
    """In every 3D view, after the scene."""
    session, context = live(), bpy.context
    if session is None or session.shown_uid is None or context.region_data is None:
        return
    obj = next((o for o in context.view_layer.objects if o.session_uid == session.shown_uid), None)
    if obj is None or not obj.visible_get():
        return
    try:
        _draw_volume(session, obj, context)
    except Exception as error:  # else there were a traceback for each frame, and a box for a volume
        _turn_off(session, error)


def _draw_volume(session: Session, obj: bpy.types.Object, context: bpy.types.Context) -> None:
    engine = session.engine
    if engine is not None:
        engine.settle(PATIENCE)
    view = _views.get(session)
    if view is None:
        view = _views[session] = LiveView()
    view.update(session)
    origin = engine.push.origin if engine is not None else (0, 0, 0)
    to_world = np.array(obj.matrix_world, np.float64) @ session.grid.transform
    look_at = np.array(gpu.matrix.get_model_view_matrix(), np.float64) @ to_world
    to_clip = np.array(gpu.matrix.get_projection_matrix(), np.float64) @ look_at
    _, _, width, height = gpu.state.viewport_get()
    coarse = pixel_size(context.scene.render.preview_pixel_size)
    frame = Frame(
        to_clip.tobytes(),
        look_at.tobytes(),
        -(-width // coarse),
        -(-height // coarse),
        context.scene.repousse.shading == "FOG",
        level_of(obj.data) or session.auto_level,
        Give.under(engine, origin) if engine is not None else NO_GIVE,
    )
    view.draw(context.region.as_pointer(), frame)
    _troubles.pop(session, None)


def _turn_off(session: Session, error: Exception) -> None:
    """Say what is wrong, and let Blender draw the volume as soon as it has drawn this frame."""
    what = str(error) or type(error).__name__
    _troubles[session] = f"The live view is off: {what.splitlines()[0]}"
    print(f"Repoussé: {_troubles[session]}", file=sys.stderr)
    _views.pop(session, None)
    session.shown_uid = None
    bpy.app.timers.register(give_back_displays, first_interval=0.0)


def pixel_size(choice: str) -> int:
    """Edge of a marched pixel in those of the screen, as Blender's own render settings choose it.

    Left to us, it is 1; 2 where the processor stands in for a graphics card.
    """
    if choice != "AUTO":
        return int(choice)
    return 2 if gpu.platform.device_type_get() == "SOFTWARE" else 1


def register():
    global _handle
    if not bpy.app.background:
        _handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister():
    global _handle
    if _handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handle, "WINDOW")
    if bpy.app.timers.is_registered(give_back_displays):
        bpy.app.timers.unregister(give_back_displays)
    _handle = None
    _views.clear()
    _troubles.clear()
