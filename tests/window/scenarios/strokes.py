# SPDX-License-Identifier: GPL-3.0-or-later
"""What strokes do to the voxels: each is what the core makes of its record, and what an artist means by it."""

import numpy as np
from bl_ext.user_default.repousse.core.stroke import hash_of

from ..clay import assert_same, file_of, heights, in_file, new_block, new_slab
from ..scenario import Steps, scenario
from ..sculpting import assert_at_rest, begin, copy_of, end, equal, live_grid, ready, recorded, replayed, stroke
from ..window import THREE_QUARTERS, Window


def assert_as_recorded(volume, start) -> None:
    """The voxels in memory and in the file are those to which the core leads the stroke's record."""
    told = recorded(volume)
    assert len(told.samples) > 10, f"only {len(told.samples)} poses were solved"
    assert told.grid_hash == hash_of(start)
    wanted = replayed(told, start)
    assert not equal(wanted, start), "nothing has changed"
    assert_same(live_grid(), wanted)
    assert_same(in_file(volume), wanted)
    assert_at_rest(volume)


@scenario(vulkan=True)
def a_push_is_what_the_core_makes_of_its_record(window: Window) -> Steps:
    volume = new_block(window)
    yield from ready(window, THREE_QUARTERS)
    start, former = in_file(volume), file_of(volume)
    yield from stroke(window, (-0.5, -0.3, 1.0), (0.5, 0.3, 1.0))
    assert file_of(volume) != former
    assert_as_recorded(volume, start)
    assert abs(live_grid().mass - start.mass) <= 1e-7 * start.mass
    yield from window.picture()


@scenario()
def a_drag_ploughs_an_even_groove(window: Window) -> Steps:
    volume = new_slab(window)
    yield from ready(window)
    edge = in_file(volume).voxel_size
    yield from stroke(window, (-0.45, 0.0, 0.0), (0.45, 0.0, 0.0), moves=40)
    told = recorded(volume)
    pressed = 0.5 * told.tool.radius
    depths = np.array([-heights(live_grid(), x, 0.0) / edge for x in np.linspace(-0.3, 0.3, 13)])
    yield from window.picture()
    window.figures(pressed=pressed, shallowest=depths.min(), deepest=depths.max())
    assert np.ptp(depths) <= 0.5, f"the groove is {depths.round(2)} voxels deep"
    assert 0.6 * pressed <= np.median(depths) <= 1.1 * pressed, f"{np.median(depths):.2f} voxels of {pressed:.2f}"


@scenario()
def holding_still_does_not_dig(window: Window) -> Steps:
    volume = new_slab(window)
    yield from ready(window)
    yield from begin(window, (0.0, 0.0, 0.0))
    yield 0.2
    early = copy_of(live_grid())
    yield 1.0
    assert_same(live_grid(), early)
    yield from end(window)
    assert_at_rest(volume)


@scenario()
def ctrl_raises_a_ridge(window: Window) -> Steps:
    volume = new_slab(window)
    yield from ready(window)
    start = in_file(volume)
    yield from stroke(window, (-0.4, 0.0, 0.0), (0.4, 0.0, 0.0), "LEFT_CTRL")
    told = recorded(volume)
    assert told.verb == "pull"
    assert_as_recorded(volume, start)
    raised = np.array([heights(live_grid(), x, 0.0) / start.voxel_size for x in np.linspace(-0.25, 0.25, 9)])
    yield from window.picture()
    window.figures(lowest=raised.min(), highest=raised.max())
    assert raised.min() > 0.5, f"the ridge is {raised.round(2)} voxels high"
    assert abs(live_grid().mass - start.mass) <= 1e-7 * start.mass


@scenario()
def shift_smooths_and_keeps_the_mass(window: Window) -> Steps:
    volume = new_slab(window)
    yield from ready(window)
    yield from stroke(window, (-0.4, 0.0, 0.0), (0.4, 0.0, 0.0))
    before = in_file(volume)
    yield from stroke(window, (-0.4, 0.0, 0.0), (0.4, 0.0, 0.0), "LEFT_SHIFT")
    assert recorded(volume).verb == "smooth"
    assert_as_recorded(volume, before)
    after = live_grid()
    assert abs(after.mass - before.mass) <= 1e-7 * before.mass
    roughness = [sum(float((np.diff(grid.density, axis=a) ** 2).sum()) for a in range(3)) for grid in (before, after)]
    assert roughness[1] < roughness[0], f"it got rougher: {roughness}"


@scenario()
def both_sides_of_a_mirror_are_pushed(window: Window) -> Steps:
    volume = new_slab(window)
    yield from ready(window, mirror_x=True, radius=20)
    start = in_file(volume)
    yield from stroke(window, (0.4, -0.3, 0.0), (0.5, 0.3, 0.0))  # so far that the two do not meet
    assert recorded(volume).symmetry == "x"
    assert_as_recorded(volume, start)
    yield from window.picture()
    density, shape = live_grid().density, np.array(live_grid().shape)
    assert (shape == start.shape).all(), "the slab has room enough"
    difference = float(np.abs(density - density[::-1]).max())
    changed = np.argwhere(density != start.density)[:, 0]
    assert changed.min() < shape[0] / 2 < changed.max()
    assert difference <= 1e-4, f"the sides differ by up to {difference:g}"
