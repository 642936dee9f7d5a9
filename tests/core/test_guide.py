# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mouse or a pen means: how deep its poses lie, how evenly, whichever way its events come."""

from dataclasses import replace

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.guide import FINEST_STEP, MOST_POSES, SMALLEST_RADIUS, Brush, Guide
from repousse.core.surface import Surface

from .volumes import TINY, half_space, speckled

RADIUS, FIRST = 8.0, 26
HEIGHT = FIRST - 0.5
"""Of the surface of `block` along axis 0, seen from below."""
PLAIN = Brush(RADIUS, strength=0.5)


def block(**how):
    return half_space((56, 120, 64), first=FIRST, **how)


def looking_up(scale=1.0):
    """Parallel lines of sight along +x; ``scale`` voxels are a pixel, pixel (0, 0) is over y = z = 0."""
    return lambda x, y: ((-90.0, x * scale, y * scale), (1.0, 0.0, 0.0))


def from_eye(eye, scale=0.004):
    """Lines of sight that spread from an eye below the block; pixel (0, 0) is straight up."""

    def ray(x, y):
        way = np.array((1.0, x * scale, y * scale))
        return tuple(eye), tuple(way / np.linalg.norm(way))

    return ray


def drag(guide, start, end, events=20, seconds=1.0):
    """All samples of a straight stroke."""
    samples = guide.begin(*start)
    for n in range(1, events + 1):
        x, y = (a + (b - a) * n / events for a, b in zip(start, end))
        samples += guide.move(x, y, 1.0, seconds * n / events)
    return samples


def centres(samples):
    return np.array([s.position for s in samples])


@pytest.mark.parametrize("press", ["view", "normal", "stroke"])
@pytest.mark.parametrize("strength", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("sight", ["parallel", "perspective"])
def test_over_a_plane_the_tool_rides_at_its_depth(press, strength, sight):
    """R - h from the plane to the tool's centre, for every pose; obliquely seen, the view presses obliquely."""
    ray, start, end = looking_up(), (30, 30), (85, 33)
    if sight == "perspective":
        ray, start, end = from_eye((-90.0, 60.0, 32.0)), (-60, -10), (60, 20)
    guide = Guide(Surface(block(), 0.5), replace(PLAIN, press=press, strength=strength), ray)
    touch, *rest = drag(guide, start, end)
    assert touch.position[0] == pytest.approx(HEIGHT - RADIUS, abs=1e-6)
    for sample in rest:
        pressed = (sample.position[0] - (HEIGHT - RADIUS)) / (strength * RADIUS or 1.0)
        if press == "view" and strength:
            slant = np.array(sample.direction)
            assert pressed == pytest.approx(slant[0], abs=1e-6)
            assert np.linalg.norm(slant) == pytest.approx(1.0)
        else:
            assert pressed == pytest.approx(1.0 if strength else 0.0, abs=1e-6)
        if press == "normal":
            assert sample.direction == pytest.approx((1, 0, 0), abs=1e-9)
        assert (sample.direction is None) == (press == "stroke")
        assert sample.radius == RADIUS and sample.strength is None
    assert len(rest) > 20


def test_a_pull_is_below_the_surface_and_flows_outward():
    """One radius under, towards the viewer or out of the surface; it takes half as much as a push of its strength."""
    for press in ("view", "normal", "stroke"):
        brush = replace(PLAIN, verb="pull", press=press, strength=0.6)
        samples = drag(Guide(Surface(block(), 0.5), brush, looking_up()), (30, 30), (60, 30))
        for sample in samples:
            assert sample.position[0] == pytest.approx(HEIGHT + RADIUS, abs=1e-6)
            assert sample.direction == pytest.approx((-1, 0, 0), abs=1e-9)
            assert sample.strength == pytest.approx(0.3)


def test_smoothing_is_on_the_surface():
    samples = drag(Guide(Surface(block(), 0.5), replace(PLAIN, verb="smooth"), looking_up()), (30, 30), (60, 30))
    assert len(samples) > 20
    for sample in samples:
        assert sample.position[0] == pytest.approx(HEIGHT, abs=1e-6)
        assert sample.direction is None and sample.strength == 0.5


def bumps(height=5.0, length=9.0):
    """A surface of hills and valleys of some voxels."""
    y, z = np.meshgrid(np.arange(140), np.arange(48), indexing="ij")
    top = 24.0 + height * np.sin(y / length) + 3.0 * np.cos(z / 7.0 + y / 15.0)
    values = np.clip(np.arange(48)[:, None, None] - top[None] + 0.5, 0.0, 1.0)
    return DensityGrid(values)


def noisy():
    """CT-like; the tool goes all over its ball."""
    return speckled((48, 140, 48))


@pytest.mark.parametrize("volume", [block, bumps, noisy])
def test_the_path_does_not_depend_on_the_rate_of_events(volume):
    """Three coarse events or 400 fine ones: the same poses to a tenth of a voxel, one spacing apart."""
    grid, paths = volume(), []
    for events in (3, 10, 57, 400):
        guide = Guide(Surface(grid, 0.3), replace(PLAIN, radius=6.0, press="view", spacing=0.4), looking_up(0.5))
        paths.append(centres(drag(guide, (50, 40), (220, 52), events)))
    for path in paths[1:]:
        assert len(path) == len(paths[0])
        assert np.abs(path - paths[0]).max() < 0.1


@pytest.mark.parametrize("volume", [block, bumps])
def test_poses_are_one_spacing_apart_on_the_surface(volume):
    """Smoothing's poses lie on the surface itself: each is a spacing from the last, on slopes as well."""
    brush = replace(PLAIN, verb="smooth", spacing=0.25)
    for ray, start, end in ((looking_up(), (20, 20), (110, 26)), (from_eye((-90.0, 60.0, 24.0)), (-70, -9), (70, 9))):
        guide = Guide(Surface(volume(), 0.5), brush, ray)
        steps = np.linalg.norm(np.diff(centres(drag(guide, start, end, 7)), axis=0), axis=1)
        assert len(steps) > 25
        assert steps == pytest.approx(0.25 * RADIUS, abs=0.01)


def test_on_slopes_that_are_nearly_along_the_view_poses_stay_near_each_other():
    """Up to 75 degrees: nearly all a spacing apart, none two, and not many rays for it."""
    rays = []

    def ray(x, y):
        rays.append((x, y))
        return looking_up(0.5)(x, y)

    brush = replace(PLAIN, verb="smooth", radius=6.0, spacing=0.4)
    guide = Guide(Surface(bumps(14.0, 4.0), 0.3), brush, ray)
    steps = np.linalg.norm(np.diff(centres(drag(guide, (50, 40), (220, 52), 10)), axis=0), axis=1)
    assert np.median(steps) == pytest.approx(2.4, abs=0.01)
    assert steps.max() < 2 * 2.4
    assert len(rays) < 10 * len(steps)


def test_a_fast_move_has_at_most_so_many_poses():
    """They are farther apart then, evenly, and the tool keeps up."""
    guide = Guide(Surface(half_space((40, 900, 24), first=20), 0.5), replace(PLAIN, spacing=0.05), looking_up())
    guide.begin(20, 12)
    samples = guide.move(880, 12)
    assert MOST_POSES - 1 <= len(samples) <= MOST_POSES
    steps = np.linalg.norm(np.diff(centres(samples), axis=0), axis=1)
    assert steps == pytest.approx(860 / MOST_POSES, rel=1e-3)
    assert samples[-1].position[1] > 880 - 860 / MOST_POSES - 1e-6


def test_each_pose_is_a_hit_of_its_own():
    """A fast move over hills follows them: no chord cuts a corner."""
    grid = bumps()
    brush = replace(PLAIN, verb="smooth", radius=4.0, spacing=0.5)
    guide = Guide(Surface(grid, 0.5), brush, looking_up())
    guide.begin(15, 24)
    for sample in guide.move(125, 24):
        _, y, z = sample.position
        met = Surface(grid, 0.5).meet((-90.0, y, z), (1, 0, 0))
        assert sample.position == pytest.approx(met, abs=1e-6)


def test_holding_still_gives_nothing():
    guide = Guide(Surface(block(), 0.5), PLAIN, looking_up())
    guide.begin(40, 30)
    for n in range(100):
        assert guide.hold(n / 10) == []
        assert guide.move(40 + 0.3 * (n % 2), 30, 1.0 - n / 200, n / 10) == []


def test_the_way_of_small_moves_adds_up():
    """A hundred moves of a tenth of a pixel go as far as one of ten."""
    guide = Guide(Surface(block(), 0.5), replace(PLAIN, spacing=0.5), looking_up())
    samples = drag(guide, (40, 30), (50, 30), 100)
    assert [round(s.position[1], 2) for s in samples] == [40, 40, 44, 48]


@pytest.mark.parametrize("verb, sign", [("push", 1.0), ("pull", -1.0)])
@pytest.mark.parametrize("press", ["view", "normal", "stroke"])
def test_a_drill_goes_ahead_whatever_the_ticks(verb, sign, press):
    """Strength x radius a second, in the same steps at any rate of ticks, and a drag takes the depth along."""
    brush, paths = replace(PLAIN, drill=True, verb=verb, press=press), []
    for ticks in (3, 60, 977):
        guide = Guide(Surface(block(), 0.5), brush, looking_up())
        first = guide.begin(40, 30)[-1].position[0]
        path = [sample for n in range(1, ticks + 1) for sample in guide.hold(2.0 * n / ticks)]
        assert path[-1].position[0] == pytest.approx(first + sign * 0.5 * RADIUS * 2.0, abs=FINEST_STEP + 1e-9)
        assert np.diff([first, *(s.position[0] for s in path)]) == pytest.approx(sign * FINEST_STEP, abs=1e-9)
        paths.append([(round(s.time, 6), *np.round(s.position, 6)) for s in path])
        deep = guide.move(60, 30, 1.0, 2.0)[-1]
        assert deep.position[0] == pytest.approx(first + sign * 0.5 * RADIUS * 2.0, abs=1e-6)
    assert paths[0] == paths[1] == paths[2]


def test_a_drill_goes_ahead_while_it_is_dragged():
    guide = Guide(Surface(block(), 0.5), replace(PLAIN, drill=True), looking_up())
    for sample in drag(guide, (40, 30), (80, 30), events=8, seconds=2.0)[1:]:
        assert sample.position[0] == pytest.approx(HEIGHT - RADIUS + 4.0 + 4.0 * sample.time, abs=1e-6)


def test_a_drill_does_not_smooth_on_and_on():
    guide = Guide(Surface(block(), 0.5), replace(PLAIN, drill=True, verb="smooth"), looking_up())
    guide.begin(40, 30)
    assert guide.hold(5.0) == []


def test_pressure():
    """On the radius, the strength, both or none; between two events it changes with the way, not at once."""
    surface = Surface(block(), 0.5)
    for on_radius in (False, True):
        for on_strength in (False, True):
            brush = replace(PLAIN, pressure_radius=on_radius, pressure_strength=on_strength)
            pressed = Guide(surface, brush, looking_up()).begin(40, 30, 0.5)[-1]
            radius, share = (4.0 if on_radius else 8.0), (0.25 if on_strength else 0.5)
            assert pressed.radius == radius
            assert pressed.position[0] == pytest.approx(HEIGHT - radius * (1.0 - share), abs=1e-6)
            light = Guide(surface, brush, looking_up()).begin(40, 30, 0.0)[-1]
            assert light.radius == (SMALLEST_RADIUS if on_radius else 8.0)
    guide = Guide(surface, replace(PLAIN, pressure_strength=True), looking_up())
    guide.begin(40, 30, 0.0)
    for sample in guide.move(60, 30, 1.0):
        share = (sample.position[1] - 40.0) / 20.0
        assert sample.position[0] == pytest.approx(HEIGHT - RADIUS + 4.0 * share, abs=1e-6)
    pull = Guide(surface, replace(PLAIN, verb="pull", pressure_strength=True), looking_up()).begin(40, 30, 0.5)[-1]
    assert pull.strength == pytest.approx(0.125)


def test_the_string_of_the_stabiliser():
    """What stays within it moves nothing; beyond it the tool is dragged behind, and cuts the corners of a zigzag."""
    surface = Surface(block(), 0.5)
    guide = Guide(surface, replace(PLAIN, stabiliser=12.0), looking_up())
    rng = np.random.default_rng(0)
    guide.begin(40, 30)
    for _ in range(200):
        x, y = rng.uniform(-8.0, 8.0, 2)
        assert guide.move(40 + x, 30 + y) == []
    samples = drag(Guide(surface, replace(PLAIN, stabiliser=12.0, spacing=0.05), looking_up()), (40, 30), (80, 30), 9)
    assert samples[-1].position[1] == pytest.approx(80.0 - 12.0, abs=0.4)
    for string, least, most in ((0.0, 3.0, 4.1), (15.0, 0.0, 1.5)):
        guide = Guide(surface, replace(PLAIN, stabiliser=string), looking_up())
        samples = guide.begin(20, 30)
        for n in range(1, 45):
            samples += guide.move(20 + 2 * n, 30 + (4 if n % 2 else -4))
        wander = np.abs(centres(samples)[-20:, 2] - 30.0).max()
        assert least <= wander <= most


def test_the_string_does_not_depend_on_the_rate_of_events():
    """Round a corner as well: half a voxel, and to a tenth on the straight part after it."""
    ends = []
    for events in (4, 200):
        guide = Guide(Surface(block(), 0.5), replace(PLAIN, stabiliser=10.0, spacing=0.1), looking_up())
        samples = drag(guide, (30, 20), (60, 20), events)
        for n in range(1, events + 1):
            samples += guide.move(60 + 40 * n / events, 20 + 25 * n / events)
        ends.append(centres(samples))
    gaps = [np.linalg.norm(ends[0] - point, axis=1).min() for point in ends[1]]
    assert max(gaps) < 0.5
    assert max(gaps[-10:]) < 0.45  # the spacing's half at most, and no more beside the path


def test_off_the_surface_it_glides_and_comes_back():
    """Over a gap between two blocks it stays on the plane of the last hit, and goes on at even steps."""
    values = np.zeros((56, 160, 40), np.float32)
    values[FIRST:, :60] = 1.0
    values[FIRST + 3 :, 100:] = 1.0
    guide = Guide(Surface(DensityGrid(values), 0.5), PLAIN, looking_up())
    samples = drag(guide, (30, 20), (80, 20), 11)
    assert guide.hit.position == pytest.approx((HEIGHT, 80, 20), abs=0.05)
    assert guide.hit.normal[1] > 0.1  # as it leaned at the edge: the tool does not jump there
    samples += guide.move(130, 20)
    assert guide.hit.position == pytest.approx((FIRST + 2.5, 130, 20), abs=1e-6)
    way = centres(samples)
    gap = way[(way[:, 1] > 64.0) & (way[:, 1] < 96.0)]
    assert len(gap) > 20
    # Near the edge the normal leans, and with it the tool: over the gap it keeps what it had last.
    assert np.ptp(gap[:, 0]) < 1e-6
    assert np.diff(gap[:, 1]) == pytest.approx(0.15 * RADIUS, abs=0.01)
    assert way[-1, 0] == pytest.approx(FIRST + 2.5 - RADIUS / 2, abs=1e-3)
    again = centres(drag(Guide(guide.surface, PLAIN, looking_up()), (30, 20), (130, 20), 300))
    assert np.abs(again - way).max() < 0.2


def test_a_start_off_the_surface():
    """On the plane through the volume's middle that faces the view, until it meets something."""
    grid = block()
    values = np.zeros_like(grid.density)
    values[30:, 60:] = 1.0
    guide = Guide(Surface(DensityGrid(values), 0.5), PLAIN, looking_up())
    assert guide.hit is None
    start = guide.begin(20, 31.5)
    middle = (values.shape[0] - 1) / 2
    assert guide.hit.position == pytest.approx((middle, 20, 31.5))
    assert start[-1].position == pytest.approx((middle - RADIUS / 2, 20, 31.5))
    on = guide.move(90, 31.5)
    assert on[-1].position[0] == pytest.approx(29.5 - RADIUS / 2, abs=1e-3)


def test_a_tool_that_comes_from_afar_touches_first():
    """Over a cliff higher than the tool a push comes down on the other side anew: it does not plunge in."""
    values = np.zeros((80, 100, 40), np.float32)
    values[20:, :50] = 1.0
    values[60:, 50:] = 1.0
    guide = Guide(Surface(DensityGrid(values), 0.5), replace(PLAIN, press="view"), looking_up())
    samples = drag(guide, (30, 20), (75, 20), 9)
    jump = next(n for n in range(2, len(samples)) if samples[n].position[0] > 40)
    touch, pressed = samples[jump], samples[jump + 1]
    assert np.subtract(pressed.position, touch.position) == pytest.approx((RADIUS / 2, 0, 0), abs=1e-9)


def test_times_begin_with_the_stroke():
    guide = Guide(Surface(block(), 0.5), PLAIN, looking_up())
    samples = guide.begin(30, 30, 1.0, 17.0) + guide.move(70, 30, 1.0, 19.0)
    assert samples[0].time == 0.0
    for sample in samples[1:]:
        assert sample.time == pytest.approx((sample.position[1] - 30.0) / 20.0, abs=1e-6)


def groove(press="stroke", density=1.0, scale=1.0, events=20, band=RADIUS, view=None):
    """Depth along the middle of a groove that a guided push ploughs, where it is seen at half of the density."""
    grid = block(density=density)
    push = Push(grid, SphereTool(RADIUS), Material(3.3, TINY), border="wall", band=band)
    surface = Surface(grid, density / 2, push.remember())
    ray, start, end = looking_up(scale), (30 / scale, 31.5 / scale), (90 / scale, 31.5 / scale)
    if view is not None:
        ray, start, end = from_eye(view), (-60, 0), (60, 0)
    for sample in drag(Guide(surface, replace(PLAIN, press=press), ray), start, end, events):
        push.walk(sample)
    now = Surface(grid, density / 2)
    return np.array([now.meet((-9.0, y, 31.5), (1, 0, 0))[0] - HEIGHT for y in range(42, 79)])


def test_a_drag_ploughs_an_even_groove():
    """Packed material, flowing along the stroke: strength x radius deep everywhere, at any zoom and rate of events."""
    depth = groove()
    assert depth == pytest.approx(0.5 * RADIUS, abs=0.05)
    assert depth.std() < 0.01
    assert groove(scale=0.25) == pytest.approx(depth, abs=0.02)
    assert groove(events=3) == pytest.approx(depth, abs=0.02)
    assert groove(view=(-120.0, 60.0, 31.5)) == pytest.approx(depth, abs=0.02)


@pytest.mark.parametrize("press", ["normal", "view"])
def test_a_groove_in_packed_material_stays_open_whichever_way_it_is_pressed(press):
    """The rim leaves the way free that the tool has come: it would fill a quarter of the groove otherwise."""
    depth = groove(press)
    assert depth == pytest.approx(0.5 * RADIUS, abs=0.05)
    assert depth.std() < 0.01


@pytest.mark.parametrize("press", ["normal", "view"])
def test_a_groove_is_even_whichever_way_it_is_pressed(press):
    """Loose material, pushed down: to a hundredth of a voxel. It packs below the tool, so half density lies higher."""
    depth = groove(press, density=0.6, band=None)
    assert depth == pytest.approx(0.5 * RADIUS, abs=0.25)
    assert depth.std() < 0.01


def test_scrubbing_does_not_dig():
    """The tool rides the surface of before: six strokes to and fro in one drag are as deep as one."""
    grid = block()
    push = Push(grid, SphereTool(RADIUS), Material(3.3, TINY), border="wall", band=RADIUS)
    surface = Surface(grid, 0.5, push.remember())
    guide = Guide(surface, replace(PLAIN, press="stroke"), looking_up())
    samples = guide.begin(40, 31.5)
    for n in range(6):
        samples += guide.move(80 if n % 2 == 0 else 40, 31.5)
    for sample in samples:
        push.walk(sample)
    now = Surface(grid, 0.5)
    depth = np.array([now.meet((-9.0, y, 31.5), (1, 0, 0))[0] - HEIGHT for y in range(48, 73)])
    assert depth == pytest.approx(0.5 * RADIUS, abs=0.1)


@pytest.mark.parametrize(
    "wrong",
    [
        {"verb": "dig"},
        {"press": "down"},
        {"radius": 0.5},
        {"radius": np.nan},
        {"strength": -0.1},
        {"strength": 1.1},
        {"spacing": 0.0},
        {"stabiliser": -1.0},
        {"stabiliser": np.inf},
    ],
)
def test_a_brush_that_is_none(wrong):
    with pytest.raises(ValueError, match=r"brush|verb|stabiliser"):
        replace(PLAIN, **wrong)
