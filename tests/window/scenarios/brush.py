# SPDX-License-Identifier: GPL-3.0-or-later
"""The brush's settings by hand: F and Shift F, the direction of the push, two views, and all that is drawn of it."""

import bpy
import numpy as np
from mathutils import Vector

from ..clay import heights, in_file, new_block, new_slab
from ..scenario import Steps, scenario
from ..sculpting import assert_at_rest, begin, end, live_grid, ready, recorded, stroke
from ..window import THREE_QUARTERS, Window


def radial(window: Window, pixels: int, *modifiers: str) -> Steps:
    """Press F, move so many pixels to the right, and confirm."""
    x, y = window.pixel((0.0, 0.0, 0.0))
    yield from window.move((x, y))
    yield from window.tap("F", *modifiers)
    yield from window.drawn()
    yield from window.drag_to((x + pixels, y), 5)
    yield from window.picture()
    yield from window.press()
    yield from window.release()
    yield from window.drawn()


@scenario()
def f_sets_the_radius(window: Window) -> Steps:
    volume = new_slab(window)
    yield from ready(window)
    settings, start = bpy.context.scene.repousse, in_file(volume)
    yield from stroke(window, (-0.3, 0.3, 0.0), (0.3, 0.3, 0.0))
    before = recorded(volume).tool.radius
    yield from radial(window, 20)
    assert settings.radius == 60, settings.radius
    yield from stroke(window, (-0.3, -0.3, 0.0), (0.3, -0.3, 0.0))
    assert np.isclose(recorded(volume).tool.radius, 1.5 * before, rtol=0.02)
    assert start.voxel_size == live_grid().voxel_size


@scenario()
def shift_f_sets_the_strength(window: Window) -> Steps:
    volume = new_slab(window)
    yield from ready(window)
    settings = bpy.context.scene.repousse
    yield from radial(window, -40, "LEFT_SHIFT")
    weak = settings.strength
    assert 0.0 <= weak < 0.5, weak
    yield from stroke(window, (-0.3, 0.0, 0.0), (0.3, 0.0, 0.0))
    edge = live_grid().voxel_size
    depth = np.median([-heights(live_grid(), x, 0.0) / edge for x in np.linspace(-0.2, 0.2, 9)])
    pressed = weak * recorded(volume).tool.radius
    assert depth <= 1.1 * pressed + 0.1, f"{depth:.2f} voxels deep, pressed {pressed:.2f}"


@scenario()
def the_push_goes_the_way_that_is_set(window: Window) -> Steps:
    """On the top of a block that is seen aslant: away from the viewer, straight down, or along the stroke."""
    volume = new_slab(window)
    wanted = {}
    yield from ready(window, THREE_QUARTERS)
    away = np.array(window.view.view_rotation @ Vector((0.0, 0.0, -1.0)))
    for press in ("view", "normal", "stroke"):
        bpy.context.scene.repousse.press = press
        yield from stroke(window, (-0.2, 0.0, 0.0), (0.2, 0.0, 0.0))
        wanted[press] = [sample.direction for sample in recorded(volume).samples]
    assert np.dot(np.mean(wanted["view"], axis=0), away) > 0.98
    assert np.median([direction[2] for direction in wanted["normal"]]) < -0.95
    assert set(wanted["stroke"]) == {None}


@scenario()
def two_views_show_the_stroke(window: Window) -> Steps:
    volume = new_block(window)
    with window.context():
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
    yield from window.drawn()
    assert len(window.areas) == 2
    other = window.areas[1]
    other.spaces.active.region_3d.view_rotation = THREE_QUARTERS
    yield from ready(window)
    drawn = {area.as_pointer(): 0 for area in window.areas}

    def count():
        drawn[bpy.context.area.as_pointer()] += 1

    yield from window.drawn()
    handler = bpy.types.SpaceView3D.draw_handler_add(count, (), "WINDOW", "POST_PIXEL")
    try:
        yield from begin(window, (-0.3, 0.0, 1.0))
        yield from window.drag_to(window.pixel((0.3, 0.0, 1.0)), 24)
        yield from window.until(lambda: min(drawn.values()) > 0, "both views to be drawn in the stroke")
        yield from end(window)
    finally:
        bpy.types.SpaceView3D.draw_handler_remove(handler, "WINDOW")
    assert_at_rest(volume)
    yield from window.picture()


@scenario(vulkan=True)
def the_panels_are_drawn(window: Window) -> Steps:
    volume = new_block(window)
    yield from ready(window, THREE_QUARTERS)
    yield from stroke(window, (-0.5, 0.0, 1.0), (0.5, 0.0, 1.0))
    window.area.spaces.active.show_region_ui = True
    sidebar = next(region for region in window.area.regions if region.type == "UI")
    yield from window.until(lambda: sidebar.active_panel_category not in {"", "UNSUPPORTED"}, "the sidebar to be drawn")
    for category in ("Tool", "Repoussé"):
        sidebar.active_panel_category = category
        yield from window.drawn()
        assert sidebar.active_panel_category == category
        yield from window.picture(f"-{category.lower().replace('é', 'e')}")
    properties = next(area for area in window.blender.screen.areas if area.type == "PROPERTIES")
    properties.spaces.active.context = "TOOL"
    yield from window.drawn()
    assert_at_rest(volume)
