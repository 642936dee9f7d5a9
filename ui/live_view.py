# SPDX-License-Identifier: GPL-3.0-or-later
"""The live view: the volume that is sculpted, marched on the graphics card from the array that the kernels write into.

A stroke sends only the box that it changed. The march goes into a picture of its own, which is drawn again as it is
for as long as nothing in it would change: a cursor that moves costs no march, and a stroke only that of the part of the
picture in which it is seen.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from weakref import WeakKeyDictionary

import bpy
import gpu
import numpy as np
from gpu.types import Buffer, GPUFrameBuffer, GPUTexture, GPUUniformBuf

from ..core.engine import Engine
from ..core.grid import Box
from ..operators.automatic_level import level_of
from ..operators.session import Session, give_back_displays, live
from . import give, programs, shaders
from .give import Give
from .programs import Screen
from .sight import Sight
from .texture import DensityTexture

FOG_OPACITY = 0.06
"""Optical depth of a full voxel in fog."""
PATIENCE = 0.008
"""Seconds for which a frame waits for the poses that it is to show."""
MOST_VIEWS = 8
"""Views whose pictures are kept."""


@dataclass(frozen=True)
class Frame:
    """All that a picture depends on but the voxels.

    ``projection`` and ``to_view``: (4, 4) matrices from the view to clip space and from voxels to the view, as bytes of
    float64, so that frames can be compared. ``width`` and ``height`` in marched pixels; ``level``: the density that is
    seen as the surface; ``gives``: how that gives under tools.
    """

    projection: bytes
    to_view: bytes
    width: int
    height: int
    level: float
    fog: bool = False
    gives: tuple[Give, ...] = ()

    @classmethod
    def of(cls, projection: np.ndarray, to_view: np.ndarray, width: int, height: int, level: float, **more) -> Frame:
        """From matrices that are arrays."""
        matrices = (np.ascontiguousarray(m, np.float64).tobytes() for m in (projection, to_view))
        return cls(*matrices, width, height, level, **more)

    def sight(self, shape: tuple[int, int, int]) -> Sight | None:
        """How it is seen; None when it is not, flat as it is."""
        return Sight.of(*(np.frombuffer(m).reshape(4, 4) for m in (self.projection, self.to_view)), shape)


class LiveView:
    """One grid's texture, and the pictures that 3D views have of it.

    ``marches`` and ``marched_pixels`` count what was marched. Everything on the graphics card goes with it.
    """

    def __init__(self) -> None:
        self.texture = DensityTexture()
        self.marches = self.marched_pixels = 0
        self._pictures: dict[int, _Picture] = {}
        self._block: GPUUniformBuf | None = None

    def update(self, session: Session) -> None:
        """Send what has changed since this was last asked."""
        everything, boxes = session.take_changes()
        density = session.grid.density
        if everything or self.texture.shape != density.shape:
            self.texture.upload(session.grid.bricks)
            for picture in self._pictures.values():
                picture.frame = None
            return
        for box in boxes:
            self.texture.patch(density, box)
            for picture in self._pictures.values():
                picture.stale.append(box)

    def draw(self, key: int, frame: Frame) -> None:
        """Draw into what is bound, by the depth that is there; ``key`` stands for the 3D view."""
        if frame.width < 1 or frame.height < 1:
            return
        picture = self._picture(key, (frame.width, frame.height))
        if not self._bring_up_to_date(picture, frame):
            return
        with _state("LESS_EQUAL", True, "ALPHA_PREMULT"):
            screen = programs.composite()
            screen.shader.bind()
            screen.shader.uniform_sampler("colours", picture.colours)
            screen.shader.uniform_sampler("depths", picture.depths)
            screen.draw()

    def _picture(self, key: int, size: tuple[int, int]) -> _Picture:
        picture = self._pictures.pop(key, None)
        if picture is None or picture.size != size:
            picture = _Picture(size)
        self._pictures[key] = picture  # the newest is the last
        if len(self._pictures) > MOST_VIEWS:
            del self._pictures[next(iter(self._pictures))]
        return picture

    def _bring_up_to_date(self, picture: _Picture, frame: Frame) -> bool:
        """March what is not yet as it is to be; False when there is nothing to see."""
        former, boxes = picture.frame, picture.stale
        picture.frame, picture.stale = frame, []
        if former == frame and not boxes:
            return True
        sight = frame.sight(self.texture.shape)
        if sight is None:
            picture.frame = None
            return False
        parts = [(0, 0, frame.width, frame.height)]
        if former is not None and replace(former, gives=frame.gives) == frame:
            if former.gives != frame.gives:
                boxes += [one.box for one in (*former.gives, *frame.gives)]
            seen = (sight.rectangle(box, shaders.AROUND, frame.width, frame.height) for box in boxes)
            parts = _joined([part for part in seen if part is not None])
        if parts:
            self._tell(frame, sight)
        programs.march(frame.fog, True)  # now: a stroke that begins must not wait for a compiler
        screen = programs.march(frame.fog, bool(frame.gives))
        for part in parts:
            self._march_part(screen, picture, part)
        return True

    def _tell(self, frame: Frame, sight: Sight) -> None:
        block = uniforms(frame, sight, self.texture.shape)
        data = Buffer("FLOAT", block.size, block.ravel())
        if self._block is None:
            self._block = GPUUniformBuf(data)
        else:
            self._block.update(data)

    def _march_part(self, screen: Screen, picture: _Picture, part: tuple[int, int, int, int]) -> None:
        shader = screen.shader
        # One of its own for each march, for it belongs to the window that it is made in, as textures do not.
        target = GPUFrameBuffer(color_slots=(picture.colours, picture.depths))
        with _state("NONE", False, "NONE"), target.bind():
            gpu.state.scissor_test_set(True)
            gpu.state.scissor_set(*part)
            shader.bind()
            shader.uniform_block("march", self._block)
            for name in ("density", "bricks", "eased", "fillings"):
                shader.uniform_sampler(name, getattr(self.texture, name))
            screen.draw()
            gpu.state.scissor_test_set(False)
        self.marches += 1
        self.marched_pixels += part[2] * part[3]


@dataclass(eq=False)
class _Picture:
    """A march's colour and depth: what they show, and the boxes of voxels that have changed since."""

    size: tuple[int, int]
    frame: Frame | None = None
    stale: list[Box] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.colours = GPUTexture(self.size, format="RGBA16F")
        self.depths = GPUTexture(self.size, format="R32F")


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


def _joined(parts: list[tuple[int, int, int, int]]) -> list[tuple[int, int, int, int]]:
    """Rectangles that cover the same, and do not overlap."""
    apart: list[tuple[int, int, int, int]] = []
    for x, y, w, h in parts:
        part = (x, y, w, h)
        while (other := next((o for o in apart if _overlap(o, part)), None)) is not None:
            apart.remove(other)
            low = [min(a, b) for a, b in zip(other[:2], part[:2])]
            high = [max(a + c, b + d) for a, c, b, d in zip(other[:2], other[2:], part[:2], part[2:])]
            part = (*low, high[0] - low[0], high[1] - low[1])
        apart.append(part)
    return apart


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return all(a[n] < b[n] + b[n + 2] and b[n] < a[n] + a[n + 2] for n in (0, 1))


def uniforms(frame: Frame, sight: Sight, shape: tuple[int, int, int]) -> np.ndarray:
    """The uniform block of a march, by name as `shaders.FIELDS` says: (rows, 4) float32."""
    told = {
        "start": sight.start[0],
        "start_x": sight.start[1],
        "start_y": sight.start[2],
        "way": sight.way[0],
        "way_x": sight.way[1],
        "way_y": sight.way[2],
        "normal_x": sight.normals[0],
        "normal_y": sight.normals[1],
        "normal_z": sight.normals[2],
        "clip_z": sight.to_clip[2],
        "clip_w": sight.to_clip[3],
        "shape": (*shape, max(frame.level, 1e-3)),
        "look": (0.0, FOG_OPACITY, float(len(frame.gives))),
    }
    block = np.zeros((len(shaders.FIELDS) + 2 * give.MOST, 4), np.float32)
    for row, name in zip(block, shaders.FIELDS):
        row[: len(told[name])] = told[name]
    tips, ways = block[len(shaders.FIELDS) :].reshape(2, give.MOST, 4)
    for one, tip, way in zip(frame.gives, tips, ways):
        tip[:], way[:3] = (*one.tip, one.radius), one.by
    return block


def gives_of(engine: Engine | None) -> tuple[Give, ...]:
    """How the surface gives under the tools of the stroke that runs."""
    if engine is None:
        return ()
    pushes = getattr(engine.push, "pushes", (engine.push,))
    return tuple(one for one in map(give.under, pushes[: give.MOST]) if one is not None)


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
_handles: list = []


def _shown(context: bpy.types.Context) -> tuple[Session, bpy.types.Object] | None:
    """What is to be seen live in the 3D view that is drawn."""
    session = live()
    if session is None or session.shown_uid is None or context.region_data is None:
        return None
    obj = next((o for o in context.view_layer.objects if o.session_uid == session.shown_uid), None)
    return (session, obj) if obj is not None and obj.visible_get() else None


@contextmanager
def _guarded(session: Session) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # else there were a traceback for each frame, and a box for a volume
        _turn_off(session, error)


def _send() -> None:
    """Before the scene is drawn, or what is sent would wait until the graphics card has drawn it."""
    shown = _shown(bpy.context)
    if shown is None:
        return
    session, _ = shown
    with _guarded(session):
        if session.engine is not None:
            session.engine.settle(PATIENCE)
        view = _views.get(session)
        if view is None:
            view = _views[session] = LiveView()
        view.update(session)


def _draw() -> None:
    """After the scene, for by then its depth is known."""
    shown = _shown(bpy.context)
    view = _views.get(shown[0]) if shown is not None else None
    if view is None:
        return
    session, obj = shown
    with _guarded(session):
        _draw_volume(view, session, obj, bpy.context)


def _draw_volume(view: LiveView, session: Session, obj: bpy.types.Object, context: bpy.types.Context) -> None:
    to_world = np.array(obj.matrix_world, np.float64) @ session.grid.transform
    _, _, width, height = gpu.state.viewport_get()
    coarse = pixel_size(context.scene.render.preview_pixel_size)
    frame = Frame.of(
        np.array(gpu.matrix.get_projection_matrix(), np.float64),
        np.array(gpu.matrix.get_model_view_matrix(), np.float64) @ to_world,
        -(-width // coarse),
        -(-height // coarse),
        level_of(obj.data) or session.auto_level,
        fog=context.scene.repousse.shading == "FOG",
        gives=gives_of(session.engine),
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
    if not bpy.app.background:
        add = bpy.types.SpaceView3D.draw_handler_add
        _handles[:] = [add(_send, (), "WINDOW", "PRE_VIEW"), add(_draw, (), "WINDOW", "POST_VIEW")]


def unregister():
    for handle in _handles:
        bpy.types.SpaceView3D.draw_handler_remove(handle, "WINDOW")
    _handles.clear()
    if bpy.app.timers.is_registered(give_back_displays):
        bpy.app.timers.unregister(give_back_displays)
    _views.clear()
    _troubles.clear()
    programs.free()
