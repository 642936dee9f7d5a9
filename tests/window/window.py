# SPDX-License-Identifier: GPL-3.0-or-later
"""The hand and the eye of a scenario: mouse, keys, waiting, views, pictures and what Blender has reported."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import contextmanager
from pathlib import Path

import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Quaternion, Vector

from .scenario import Steps

OUT = Path(__file__).resolve().parents[2] / "out" / "window"
FROM_ABOVE = Quaternion((1.0, 0.0, 0.0, 0.0))
FROM_THE_FRONT = Quaternion((0.70710678, 0.70710678, 0.0, 0.0))
THREE_QUARTERS = Quaternion((0.820473, 0.424708, 0.176320, 0.339851))
"""Down onto a corner, as one looks at a block on a table."""

MOVES_A_FRAME = 4
QUIET = 0.4
"""Seconds without a frame after which Blender is taken to have nothing to draw."""


class Window:
    """Blender's first window, of which nothing is kept: opening a file makes all of it anew."""

    def __init__(self, name: str, folder: Path, tell: Callable[..., None]):
        self.name = name
        self.folder = folder
        self._tell = tell
        self._pointer = (0, 0)
        self._modifiers: dict[str, bool] = {}

    @property
    def blender(self) -> bpy.types.Window:
        """Blender's own window as it is now."""
        return bpy.context.window_manager.windows[0]

    @property
    def areas(self) -> list[bpy.types.Area]:
        """The 3D views, the largest first."""
        views = [area for area in self.blender.screen.areas if area.type == "VIEW_3D"]
        return sorted(views, key=lambda area: -area.width * area.height)

    @property
    def area(self) -> bpy.types.Area:
        """The largest 3D view."""
        return self.areas[0]

    @property
    def view(self) -> bpy.types.RegionView3D:
        """Where the largest 3D view looks from."""
        return self.area.spaces.active.region_3d

    @contextmanager
    def context(self, area: bpy.types.Area | None = None):
        """Bpy's context as it is with the pointer over a 3D view (the largest), for calls of operators."""
        area = area or self.area
        with bpy.context.temp_override(window=self.blender, area=area, region=_main_region(area)):
            yield bpy.context

    def fresh_file(self) -> Steps:
        """Blender's own start file, without what stands in it, drawn."""
        self._modifiers = {}
        bpy.ops.wm.read_homefile(app_template="")
        yield 0.05
        for thing in list(bpy.data.objects):
            bpy.data.objects.remove(thing)
        overlay = self.area.spaces.active.overlay  # without a graphics card the floor costs more than all else
        overlay.show_floor = overlay.show_axis_x = overlay.show_axis_y = False
        with self.context():
            bpy.ops.ed.undo_push(message="Original")
        yield from self.drawn()

    def look(self, rotation: Quaternion, target: Iterable[float] = (0, 0, 0), distance=6.0, perspective=True) -> Steps:
        """Turn the largest view to look at ``target`` from ``distance``, both in metres."""
        self.view.view_perspective = "PERSP" if perspective else "ORTHO"
        self.view.view_rotation = rotation
        self.view.view_location = target
        self.view.view_distance = distance
        yield from self.drawn()

    def pixel(self, point: Iterable[float], area: bpy.types.Area | None = None) -> tuple[int, int]:
        """Where a point of the world is seen: pixels from the window's lower left, as events count them."""
        area = area or self.area
        region = _main_region(area)
        seen = location_3d_to_region_2d(region, area.spaces.active.region_3d, Vector(point))
        assert seen is not None, f"{point} is behind the view"
        return round(region.x + seen.x), round(region.y + seen.y)

    def until(self, condition: Callable[[], object], what: str, limit: float = 10.0) -> Steps:
        """Go on as soon as a condition holds; AssertionError that says ``what`` was waited for, after a limit."""
        deadline = time.monotonic() + limit
        while not condition():
            assert time.monotonic() < deadline, f"waited {limit:g} s in vain: {what}"
            yield 0.01

    def drawn(self) -> Steps:
        """Wait until every 3D view has been drawn anew."""
        former = {area.as_pointer(): _drawings[area.as_pointer()] for area in self.areas}
        for area in self.areas:
            area.tag_redraw()
        yield from self.until(
            lambda: all(_drawings[pointer] > count for pointer, count in former.items()), "a view to be drawn", 30.0
        )

    def idle(self) -> Steps:
        """Wait until Blender has nothing more to draw."""
        former, since = -1, time.monotonic()
        while time.monotonic() - since < QUIET:
            if _drawings.total() != former:
                former, since = _drawings.total(), time.monotonic()
            yield 0.01

    def event(self, kind: str, value: str) -> None:
        """Send one event at the pointer's place, with the modifiers that are held."""
        x, y = self._pointer
        self.blender.event_simulate(type=kind, value=value, x=x, y=y, **self._modifiers)

    def move(self, pixel: tuple[int, int]) -> Steps:
        """Move the pointer, and let Blender take notice."""
        self._pointer = pixel
        self.event("MOUSEMOVE", "NOTHING")
        yield 0.0

    def press(self, key: str = "LEFTMOUSE") -> Steps:
        """Press a key or a button and hold it."""
        if key in _MODIFIERS:
            self._modifiers[_MODIFIERS[key]] = True
        self.event(key, "PRESS")
        yield 0.0

    def release(self, key: str = "LEFTMOUSE") -> Steps:
        """Let go of a key or a button."""
        if key in _MODIFIERS:
            self._modifiers[_MODIFIERS[key]] = False
        self.event(key, "RELEASE")
        yield 0.0

    def tap(self, key: str, *modifiers: str) -> Steps:
        """Press and release a key, with others held: ``tap("Z", "LEFT_CTRL")``."""
        for modifier in modifiers:
            yield from self.press(modifier)
        yield from self.press(key)
        yield from self.release(key)
        for modifier in reversed(modifiers):
            yield from self.release(modifier)

    def drag_to(self, pixel: tuple[int, int], moves: int = 12) -> Steps:
        """Move the pointer to a place in a straight line of so many events, a few to a frame as from a mouse."""
        x, y = self._pointer
        for n in range(1, moves + 1):
            self._pointer = round(x + (pixel[0] - x) * n / moves), round(y + (pixel[1] - y) * n / moves)
            self.event("MOUSEMOVE", "NOTHING")
            if n % MOVES_A_FRAME == 0 or n == moves:
                yield 0.0

    def picture(self, ending: str = "") -> Steps:
        """Keep what the window shows now as out/window/<scenario><ending>.png."""
        yield from self.drawn()
        OUT.mkdir(parents=True, exist_ok=True)
        path = OUT / f"{self.name}{ending}.png"
        if not _grab(path):
            with self.context():
                bpy.ops.screen.screenshot(filepath=str(path))

    def reports(self) -> list[str]:
        """What Blender has told its user, as its Info editor lists it: reports of this session, newest last."""
        area = self.blender.screen.areas[0]
        former = area.ui_type
        area.ui_type = "INFO"
        try:
            with self.context(area):
                bpy.ops.info.select_all(action="SELECT")
                bpy.ops.info.report_copy()
            return bpy.context.window_manager.clipboard.splitlines()
        finally:
            area.ui_type = former

    def figures(self, **figures: float) -> None:
        """Tell the outside figures, by name."""
        self._tell("figures", figures=figures)


_drawings: Counter[int] = Counter()  # by the pointers of the views


def count_drawings() -> None:
    """Count from now on how often each 3D view is drawn."""
    bpy.types.SpaceView3D.draw_handler_add(
        lambda: _drawings.update([bpy.context.area.as_pointer()]), (), "WINDOW", "POST_PIXEL"
    )


_MODIFIERS = {"LEFT_CTRL": "ctrl", "LEFT_SHIFT": "shift", "LEFT_ALT": "alt"}


def _grab(path: Path) -> bool:
    """Take the picture from the X server, where there are tools for that: Mesa gives Blender's own a black one."""
    if not (shutil.which("xdotool") and shutil.which("import")):
        return False
    search = ["xdotool", "search", "--pid", str(os.getpid())]
    found = subprocess.run(search, stdout=subprocess.PIPE, text=True).stdout.split()
    return bool(found) and subprocess.run(["import", "-window", found[0], str(path)]).returncode == 0


def _main_region(area: bpy.types.Area) -> bpy.types.Region:
    return next(region for region in area.regions if region.type == "WINDOW")
