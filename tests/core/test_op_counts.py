# SPDX-License-Identifier: GPL-3.0-or-later
"""What a step costs, counted: it depends on tool and flow, not on the grid, and is less where whole bricks tell."""

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.bricks import BRICK
from repousse.core.grid import union

from .volumes import line

SCENES = {  # density of a slab, what its preset does with it, and the axis of the push
    "packed": (1.0, {"band": 6.0}, 0),
    "packed along 2": (1.0, {"band": 6.0}, 2),
    "saturated": (1.0, {}, 0),
    "foam": (0.6, {}, 0),
    "foam along 1": (0.6, {}, 1),
    "pulled": (1.0, {"verb": "pull"}, 0),
    "smoothed": (1.0, {"verb": "smooth"}, 1),
}
SURFACE, THICK = 20, 34


def pushed(n, scene, known=True, thick=THICK):
    """A push into a slab that lies alike in any grid of ``n`` voxels along each edge; and its counts."""
    density, how, axis = SCENES[scene]
    grid = DensityGrid(np.zeros((n, n, n), np.float32), copy=False)
    inside = [slice(0, 64)] * 3
    inside[axis] = slice(SURFACE, SURFACE + thick)
    grid.density[tuple(inside)] = density
    push = Push(grid, SphereTool(6), Material(3.3, 0.02), border="wall", **how)
    if not known:
        push._work.attach(grid.density, None)
    history = push.remember()
    started = grid.bricks.looked_at
    start, end = np.full(3, 31.0), np.full(3, 31.0)
    start[axis], end[axis] = 10.0, 24.0
    read, dirty = 0, None
    for point in line(start, end, 0.5)[:: -1 if scene == "pulled" else 1]:
        dirty = union(dirty, push.move_to(point).dirty)
        read += push._work.estimate.read
    sweep = push._work.sweep
    counts = {
        "read by estimates": read,
        "flux visited": push.voxels_visited,
        "read by sweeps": sweep.read,
        "bricks settled": grid.bricks.looked_at - started,
        "bricks kept": history.bricks,
        "images kept": history.images,
        "bytes kept": history.nbytes,
    }
    return push, counts, dirty


@pytest.mark.parametrize("scene", SCENES)
def test_a_step_does_not_depend_on_the_grid(kernels, scene):
    """The same scene in the corner of a larger grid costs the same, to the last voxel."""
    sizes = (64, 128, 256) if kernels == "compiled" else (64, 128)
    found = [pushed(n, scene) for n in sizes]
    part = (slice(0, 64),) * 3
    for push, counts, dirty in found[1:]:
        assert np.array_equal(push.grid.density[part], found[0][0].grid.density)
        assert counts == found[0][1]
        assert dirty == found[0][2]
    assert found[0][1]["bricks kept"] > 0 and found[0][1]["bricks settled"] > 0


@pytest.mark.parametrize("scene", ["packed", "packed along 2"])
def test_beyond_the_band_nothing_is_swept(kernels, scene):
    """How far full material goes on behind the band costs nothing: there is no flux."""
    _, thin, _ = pushed(128, scene)
    _, thick, _ = pushed(128, scene, thick=100)
    assert thick["flux visited"] == thin["flux visited"] > 0


@pytest.mark.parametrize("scene", SCENES)
def test_a_step_is_bounded_by_tool_and_flow(kernels, scene):
    """Estimates read the boxes around tool and reach, sweeps what the flux passes, and a step settles what it wrote."""
    push, counts, dirty = pushed(64, scene)
    steps = len(line((0, 0, 0), (14, 0, 0), 0.5)) + 1
    tool, reach = (int(2 * (radius + 2)) ** 3 for radius in (push.tool.radius, push.tool.reach))
    assert counts["read by estimates"] <= 2 * steps * (2 * tool + reach)  # a smoothing estimates twice
    assert counts["read by sweeps"] <= counts["flux visited"]
    written = np.prod([-(-b // BRICK) - a // BRICK for a, b in zip(*dirty)])
    assert counts["images kept"] <= counts["bricks kept"] <= written + 27
    assert counts["bricks settled"] <= steps * (written + 27) * 4


@pytest.mark.parametrize(
    "scene, count, share",
    [
        ("packed", "read by estimates", 0.65),
        ("packed along 2", "read by estimates", 0.7),
        ("foam", "read by estimates", 0.65),
        ("packed", "read by sweeps", 0.7),
        ("packed along 2", "read by sweeps", 0.7),
        ("saturated", "read by sweeps", 0.6),
        ("pulled", "read by sweeps", 0.8),
        ("pulled", "images kept", 0.75),
        ("smoothed", "images kept", 0.35),
    ],
)
def test_what_the_map_saves(scene, count, share, monkeypatch):
    """A count with the map, as a share of that without."""
    monkeypatch.setenv("REPOUSSE_KERNELS", "")
    with_map, without = (pushed(64, scene, known)[1] for known in (True, False))
    assert with_map[count] <= share * without[count]
    assert with_map["flux visited"] == without["flux visited"]


def test_a_stroke_begins_without_a_look_at_the_grid(kernels):
    """The next push of a grid, and its history, read no voxel: the map knows whether there is anything."""
    push, _, _ = pushed(64, "packed")
    grid = push.grid
    looked_at = grid.bricks.looked_at
    hidden = grid.density.view()
    grid.density.fill(0.0)  # who reads it now finds nothing
    Push(grid, SphereTool(6), Material(3.3, 0.02)).remember()
    assert grid.bricks.looked_at == looked_at and not hidden.any()
    grid.bricks.changed(None)
    with pytest.raises(ValueError, match="empty"):
        Push(grid, SphereTool(6), Material(3.3, 0.02))
