# SPDX-License-Identifier: GPL-3.0-or-later
"""The live view by its texels and its pixels: where a shape is seen, how deep, how bright, and at what cost."""

import weakref
from dataclasses import replace
from types import SimpleNamespace

import bpy
import gpu
import numpy as np
import pytest
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix

from repousse.core import DensityGrid, Material, Push, Regime, SphereTool
from repousse.core.bricks import BRICK, BrickMap
from repousse.core.symmetry import SymmetricPush
from repousse.operators import session
from repousse.ui import cursor, give, live_view, shaders, texture
from repousse.ui.bricks import all_maxima, all_means, bricks_of, maxima, means, uneven
from repousse.ui.give import Give
from repousse.ui.live_view import LiveView
from repousse.ui.sight import Sight

from .offscreen import GROUND, HEIGHT, WIDTH, Camera, Stage, as_array, drawing, no_graphics
from .sculpting import new_clay

HALF_FLOAT = 2.0**-10
"""Relative error of what is stored in half floats, rounded to nearest or cut off, as drivers please."""
FROM_ABOVE = Camera((20.0, 20.0, 100.0), (20.0, 20.0, 0.0), 20.0, perspective=False, up=(0.0, 1.0, 0.0))


@pytest.fixture(scope="module", autouse=True)
def graphics(addon):
    missing = no_graphics()
    if missing:
        pytest.skip(missing)


@pytest.fixture
def stage():
    return Stage()


def showing(density) -> LiveView:
    view = LiveView()
    view.texture.upload(BrickMap(np.ascontiguousarray(density, np.float32)))
    return view


def distance_from(centre, shape):
    return np.linalg.norm(np.moveaxis(np.indices(shape), 0, -1) - np.array(centre), axis=-1)


def ball(centre=(20.0, 17.0, 22.0), radius=10.0, shape=(41, 37, 45)):
    return np.clip(radius + 0.5 - distance_from(centre, shape), 0.0, 1.0)


def layer(top=20.0, shape=(41, 41, 32)):
    """Full below a plane across z."""
    return np.broadcast_to(np.clip(top + 0.5 - np.arange(shape[2]), 0.0, 1.0), shape)


def texels(view_texture):
    shape = view_texture.shape
    return as_array(view_texture.density.read(), shape), as_array(
        view_texture.bricks.read(), tuple(-(-n // BRICK) for n in shape)
    )


def assert_shows(view_texture, density):
    """Every texel is the voxel's density, and every brick bounds what is interpolated in it, closely."""
    stored, bricks = texels(view_texture)
    assert np.all(np.abs(stored - density) <= HALF_FLOAT * density + 1e-7)
    around = np.pad(stored, [(1, 1 + -n % BRICK) for n in density.shape])
    for brick in np.ndindex(bricks.shape):
        reached = around[tuple(slice(BRICK * b, BRICK * b + BRICK + 2) for b in brick)].max()
        assert reached <= bricks[brick] <= reached * 1.005 + 1e-7, brick


# Texels


@pytest.mark.parametrize("shape", [(16, 24, 8), (13, 21, 30), (1, 9, 5)])
def test_what_is_uploaded_is_the_array(shape):
    density = np.random.default_rng(1).random(shape, np.float32) ** 8
    view_texture = texture.DensityTexture()
    view_texture.upload(BrickMap(density))
    assert_shows(view_texture, density)


def test_patches_of_any_box_leave_every_texel_right():
    random = np.random.default_rng(2)
    density = random.random((29, 18, 35), np.float32) ** 8
    view_texture = texture.DensityTexture()
    view_texture.upload(BrickMap(density))
    boxes = [((8, 8, 8), (16, 16, 16)), ((7, 8, 15), (8, 9, 16)), ((28, 17, 34), (29, 18, 35)), ((0, 0, 0), (1, 1, 1))]
    for _ in range(20):
        corners = np.sort(random.integers(0, np.add(density.shape, 1), (2, 3)), axis=0)
        boxes.append((tuple(corners[0]), tuple(corners[1])))
    boxes += [((-5, -9, 30), (4, 99, 40)), ((5, 5, 5), (5, 9, 9)), ((40, 0, 0), (50, 9, 9))]
    for number, (low, high) in enumerate(boxes):
        part = density[tuple(slice(max(a, 0), max(b, 0)) for a, b in zip(low, high))]
        part[...] = random.random(part.shape) ** (8 if number % 2 else 1)
        view_texture.patch(density, (low, high))
        assert_shows(view_texture, density)
    assert view_texture.uploads == 1


def test_only_what_changed_is_sent():
    density = np.zeros((20, 20, 20), np.float32)
    source = SimpleNamespace(grid=DensityGrid(density, copy=False), changes=(True, []))
    source.take_changes = lambda: source.changes
    view = LiveView()
    for changes, sent in (((True, []), (1, 0)), ((False, []), (1, 0)), ((False, [((1, 1, 1), (4, 4, 4))]), (1, 1))):
        source.changes = changes
        view.update(source)
        assert (view.texture.uploads, view.texture.patches) == sent
    source.grid.density = np.zeros((20, 20, 28), np.float32)
    source.changes = (False, [((1, 1, 1), (4, 4, 4))])
    view.update(source)  # another shape is another texture, whatever is said of boxes
    assert view.texture.uploads == 2 and view.texture.shape == (20, 20, 28)


@pytest.mark.parametrize("edge", [2, 3, 8])
@pytest.mark.parametrize("shape", [(16, 24, 8), (13, 21, 30), (1, 9, 5)])
def test_means_are_those_of_bricks_padded_with_nothing(shape, edge):
    density = np.random.default_rng(3).random(shape, np.float32)
    padded = np.pad(density, [(0, -n % edge) for n in shape]).astype(np.float64)
    split = [length for n in bricks_of(shape, edge) for length in (n, edge)]
    expected = padded.reshape(split).mean(axis=(1, 3, 5))
    assert np.allclose(means(density, edge, (0, 0, 0), bricks_of(shape, edge)), expected, atol=1e-6)
    first, last = (0, 1, 0), tuple(max(b, n + 1) for b, n in zip(bricks_of(shape, edge), (0, 1, 0)))
    part = tuple(slice(a, b) for a, b in zip(first, last))
    if all(n > a for n, a in zip(bricks_of(shape, edge), first)):
        assert np.allclose(means(density, edge, first, last), expected[part], atol=1e-6)


@pytest.mark.parametrize("shape", [(40, 48, 64), (41, 37, 30), (1, 9, 5)])
def test_what_the_map_tells_of_a_grid_is_what_its_voxels_do(shape):
    """Whatever of it is empty, full or neither, and where the border cuts bricks."""
    begin, x = (0, 0, 0), np.arange(shape[0])[:, None, None]
    some = np.zeros(shape, np.float32)
    some[shape[0] // 3 : shape[0] // 2, 4:9, 3:20] = 0.7
    slab = np.broadcast_to((x < 17).astype(np.float32), shape)
    for density in (some, 1.0 - some, slab, np.minimum(slab, 1.0 - some), np.zeros(shape), np.ones(shape)):
        known = BrickMap(np.ascontiguousarray(density, np.float32))
        assert np.array_equal(all_maxima(known), maxima(known.density, begin, bricks_of(shape)))
        for edge in (shaders.EASE, BRICK):
            expected = means(known.density, edge, begin, bricks_of(shape, edge))
            assert np.allclose(all_means(known, edge), expected, rtol=0.0, atol=1e-6)


def test_a_sight_of_a_block_reads_its_dent_alone():
    """Not the rest of the grid, however large that is."""
    for n in (64, 128):
        clay = np.ones((n, n, n), np.float32)
        clay[20:30, 9:15, 33:40] = 0.5
        assert uneven(BrickMap(clay).states) == ((1, 0, 3), (5, 3, 6))


# Where it is seen

CENTRE, RADIUS = (20.0, 17.0, 22.0), 10.0
TURNED = np.array(
    [[0.0, -0.6, 0.8, 1.0], [1.0, 0.0, 0.0, -2.0], [0.0, 0.8, 0.6, 3.0], [0.0, 0.0, 0.0, 1.0]],
) @ np.diag([2.0, 2.0, 2.0, 1.0])
MIRRORED = np.diag([-0.5, 0.5, 0.5, 1.0])


def seen_from(to_world, offset, half=0.45, perspective=True, up=(0.0, 0.0, 1.0)):
    """A camera ``offset`` voxels (along the world's axes) from the ball."""
    middle = to_world[:3, :3] @ CENTRE + to_world[:3, 3]
    scale = np.cbrt(abs(np.linalg.det(to_world[:3, :3])))
    return Camera(tuple(middle + scale * np.array(offset)), tuple(middle), half, perspective, up)


@pytest.mark.parametrize("to_world", [np.eye(4), TURNED, MIRRORED], ids=["plain", "turned", "mirrored"])
@pytest.mark.parametrize(
    ("offset", "half", "perspective"),
    [((40, -25, 30), 0.45, True), ((0.1, 0, 60), 0.3, True), ((9, 7, 8), 0.8, True), ((40, -25, 30), 18.0, False)],
    ids=["perspective", "along an axis", "inside the box", "orthographic"],
)
def test_a_ball_is_seen_where_it_is(stage, to_world, offset, half, perspective):
    scale = np.cbrt(abs(np.linalg.det(to_world[:3, :3])))
    camera = seen_from(to_world, offset, half if perspective else half * scale, perspective)
    picture = stage.picture(camera, drawing(showing(ball()), camera, to_world))
    near, far = picture.unprojected(0.0, to_world), picture.unprojected(1.0, to_world)
    way = (far - near) / np.linalg.norm(far - near, axis=-1, keepdims=True)
    along = np.sum((CENTRE - near) * way, axis=-1)
    missed = np.linalg.norm(near + along[..., None] * way - CENTRE, axis=-1)
    sure = np.abs(missed - RADIUS) > 0.25
    assert np.array_equal(picture.seen[sure], (missed < RADIUS)[sure])
    assert np.count_nonzero(picture.seen) > 500
    points = picture.points(to_world)[missed < RADIUS - 0.25]
    assert np.abs(np.linalg.norm(points - CENTRE, axis=-1) - RADIUS).max() < 0.15
    facing = np.sum((points - CENTRE) * way[missed < RADIUS - 0.25], axis=-1)
    assert facing.max() < 0.0  # it is the near side that is seen


def quad(left, right, depth, colour=(0.0, 0.0, 1.0, 1.0)):
    """A function that draws a rectangle as high as the picture; left, right and depth from 0 to 1."""

    def draw():
        shader = gpu.shader.from_builtin("UNIFORM_COLOR")
        corners = [(2.0 * x - 1.0, y, 2.0 * depth - 1.0) for x in (left, right) for y in (-1.0, 1.0)]
        gpu.state.depth_test_set("LESS_EQUAL")
        gpu.state.depth_mask_set(True)
        gpu.state.blend_set("NONE")
        with gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
            gpu.matrix.load_identity()
            gpu.matrix.load_projection_matrix(Matrix.Identity(4))
            shader.bind()
            shader.uniform_float("color", colour)
            batch_for_shader(shader, "TRI_STRIP", {"pos": corners}).draw(shader)

    return draw


def test_things_before_it_hide_it_and_things_behind_it_do_not(stage):
    camera = seen_from(np.eye(4), (40, -25, 30))
    draw = drawing(showing(ball()), camera)
    alone = stage.picture(camera, draw)
    before, behind = alone.depth.min() - 1e-3, alone.depth[alone.seen].max() + 1e-4
    picture = stage.picture(camera, quad(0.0, 0.5, before), quad(0.5, 1.0, behind), draw)
    left = np.arange(WIDTH) < WIDTH // 2
    blue = np.all(picture.colour[..., :3] == (0, 0, 1), axis=-1)
    assert blue[:, left].all()
    assert np.array_equal(blue[:, ~left], ~alone.seen[:, ~left])
    whole = inner(alone.seen) & ~left
    assert np.array_equal(picture.colour[whole], alone.colour[whole])
    later = stage.picture(camera, draw, quad(0.0, 1.0, behind))  # it has left its own depth for what comes after it
    assert np.array_equal(np.all(later.colour[..., :3] == (0, 0, 1), axis=-1), ~alone.seen)


def inner(seen):
    """Pixels with all four neighbours seen."""
    around = np.pad(seen, 1)
    return seen & around[2:, 1:-1] & around[:-2, 1:-1] & around[1:-1, 2:] & around[1:-1, :-2]


def test_silhouettes_fade_into_what_is_behind_them(stage):
    camera = seen_from(np.eye(4), (40, -25, 30))
    draw = drawing(showing(ball()), camera)
    black, white = (
        stage.picture(camera, quad(0.0, 1.0, 1.0 - 1e-6, (shade, shade, shade, 1.0)), draw) for shade in (0.0, 1.0)
    )
    through = (white.colour - black.colour)[..., 0]
    seen = stage.picture(camera, draw).seen
    edge = seen & ~inner(seen)
    assert np.all(through[inner(seen)] == 0.0) and np.all(through[~seen] == 1.0)
    assert through[edge].min() > 0.2 and through[edge].max() < 0.8


def test_a_volume_behind_the_viewer_is_not_seen(stage):
    for height in (60.0, 40.0):  # the lower one is in the grid's box
        camera = Camera((20.0, 17.0, height), (20.0, 17.0, 100.0), up=(0.0, 1.0, 0.0))
        picture = stage.picture(camera, drawing(showing(ball()), camera))
        assert not picture.seen.any() and np.allclose(picture.luminance, GROUND, atol=1e-3)


@pytest.mark.parametrize("eye", [(20.0, -60.0, 45.0), (20.0, 19.0, 90.0)])
def test_a_sheet_of_one_voxel_has_no_holes(stage, eye):
    density = np.zeros((41, 41, 41))
    density[:, :, 20] = 1.0
    camera = Camera(eye, (20.0, 20.0, 20.0))
    picture = stage.picture(camera, drawing(showing(density), camera))
    near, far = picture.unprojected(0.0, np.eye(4)), picture.unprojected(1.0, np.eye(4))
    share = (20.5 - near[..., 2]) / (far - near)[..., 2]
    crossing = near + share[..., None] * (far - near)
    sheet = np.all((crossing[..., :2] > 0.5) & (crossing[..., :2] < 39.5), axis=-1)
    assert sheet.sum() > 1000 and picture.seen[sheet].all()


def test_what_is_before_the_near_plane_is_cut_away(stage):
    """From within the material: its inside is seen where the view begins."""
    camera = Camera((20.0, 20.0, 30.0), (20.0, 20.0, 0.0), up=(0.0, 1.0, 0.0))
    picture = stage.picture(camera, drawing(showing(layer(top=35.0, shape=(41, 41, 40))), camera))
    assert picture.seen.all()
    assert np.allclose(picture.points(np.eye(4))[..., 2], 29.0, atol=0.05)


def test_normals_follow_a_transform_as_slopes_do():
    """Turned, mirrored and stretched: the normal of a plane stays across what lies in it."""
    random = np.random.default_rng(4)
    camera = Camera((50.0, -20.0, 30.0), (0.0, 0.0, 0.0))
    for _ in range(20):
        to_world = np.eye(4)
        to_world[:3, :3] = random.normal(size=(3, 3))
        to_view = camera.view @ to_world
        slope = random.normal(size=3)
        inside = np.linalg.svd(slope[None])[2][1:]  # two ways along which nothing changes
        seen = Sight.of(camera.projection, to_view, (40, 40, 40)).normals @ slope
        assert np.allclose(inside @ to_view[:3, :3].T @ seen, 0.0, atol=1e-9)
        assert (to_view[:3, :3] @ slope) @ seen > 0.0  # up the slope stays up


def test_what_is_beyond_the_far_plane_is_not_seen(stage):
    camera = Camera((20.0, 17.0, 1500.0), (20.0, 17.0, 0.0), 0.01, up=(0.0, 1.0, 0.0))
    assert np.allclose(stage.picture(camera, drawing(showing(ball()), camera)).luminance, GROUND, atol=1e-3)


def test_a_grid_that_is_full_to_its_border_ends_there(stage):
    """Half way between its last voxels and those that there are not."""
    picture = stage.picture(FROM_ABOVE, drawing(showing(np.ones((41, 41, 30))), FROM_ABOVE))
    assert picture.points(np.eye(4))[HEIGHT // 2, WIDTH // 2, 2] == pytest.approx(29.5, abs=0.02)
    across = picture.points(np.eye(4))[HEIGHT // 2][picture.seen[HEIGHT // 2], 0]
    pixel = 40.0 / HEIGHT
    assert across.min() == pytest.approx(-0.5, abs=pixel) and across.max() == pytest.approx(40.5, abs=pixel)


@pytest.mark.parametrize("perspective", [True, False])
def test_a_box_is_seen_in_its_rectangle(perspective):
    """Every point of the box that is in view is, also where the box reaches behind the viewer."""
    random = np.random.default_rng(5)
    box, margin = ((5, 8, 2), (30, 20, 31)), 3.0
    low, high = np.array(box[0]) - 1.0 - margin, np.array(box[1]) + margin
    found = 0
    for _ in range(200):
        half = random.uniform(0.2, 1.5) if perspective else random.uniform(10.0, 60.0)
        eye, target = random.uniform(low - 20.0, high + 20.0), random.uniform(low, high)
        camera = Camera(tuple(eye), tuple(target), half, perspective)
        sight = Sight.of(camera.projection, camera.view, (40, 40, 40))
        points = random.uniform(low, high, (500, 3))
        clip = np.column_stack([points, np.ones(len(points))]) @ sight.to_clip.T
        clip = clip[clip[:, 3] > 0.0]
        pixels = (clip[:, :2] / clip[:, 3:] + 1.0) * (WIDTH / 2, HEIGHT / 2)
        pixels = pixels[((pixels >= 0.0) & (pixels <= (WIDTH, HEIGHT))).all(axis=1)]
        found += len(pixels)
        if len(pixels):
            x, y, width, height = sight.rectangle(box, margin, WIDTH, HEIGHT)
            assert np.all((pixels >= (x, y)) & (pixels <= (x + width, y + height)))
    assert found > 20000


def test_flat_or_broken_transforms_draw_nothing(stage):
    camera = Camera((50.0, -20.0, 30.0), (0.0, 0.0, 0.0))
    for matrix in (np.diag([1.0, 1.0, 0.0, 1.0]), np.full((4, 4), np.nan)):
        picture = stage.picture(camera, drawing(showing(ball()), camera, matrix))
        assert not picture.seen.any()


@pytest.mark.parametrize("level", [0.2, 0.5, 0.8])
def test_the_level_says_where_the_surface_is(stage, level):
    ramp = np.broadcast_to(1.0 - np.arange(32) / 31.0, (41, 41, 32))
    picture = stage.picture(FROM_ABOVE, drawing(showing(ramp), FROM_ABOVE, level=level))
    heights = picture.points(np.eye(4))[..., 2]
    assert heights[HEIGHT // 2, WIDTH // 2] == pytest.approx(31.0 * (1.0 - level), abs=0.05)


# Fog


@pytest.mark.parametrize(("density", "thick"), [(0.3, 5), (0.6, 20), (1.0, 28)])
def test_fog_is_as_opaque_as_what_is_in_it(stage, density, thick):
    voxels = np.zeros((41, 41, 40))
    voxels[:, :, 6 : 6 + thick] = density
    camera = Camera((20.0, 20.0, 100.0), (20.0, 20.0, 0.0), 10.0, perspective=False, up=(0.0, 1.0, 0.0))
    ground = quad(0.0, 1.0, 1.0 - 1e-6, (1.0, 1.0, 1.0, 1.0))
    light = stage.picture(camera, ground, drawing(showing(voxels), camera, fog=True))
    dark = stage.picture(
        camera, quad(0.0, 1.0, 1.0 - 1e-6, (0.0, 0.0, 0.0, 1.0)), drawing(showing(voxels), camera, fog=True)
    )
    passed = (light.colour - dark.colour)[HEIGHT // 2, WIDTH // 2, 0]
    assert 1.0 - passed == pytest.approx(1.0 - np.exp(-live_view.FOG_OPACITY * density * thick), rel=0.01)


# Elastic give


def test_the_surface_bows_as_deep_as_it_is_told_and_only_there(stage):
    view = showing(layer(top=20.0))
    stored, _ = texels(view.texture)

    def heights(*gives):
        return stage.picture(FROM_ABOVE, drawing(view, FROM_ABOVE, gives=gives)).points(np.eye(4))[..., 2]

    flat = heights()
    bowed = heights(Give((20.0, 20.0, 17.0), (0.0, 0.0, -3.0), 4.0))
    middle = HEIGHT // 2, WIDTH // 2
    assert (flat - bowed)[middle] == pytest.approx(3.0, abs=0.05)
    places = stage.picture(FROM_ABOVE, drawing(view, FROM_ABOVE)).points(np.eye(4))[..., :2]
    away = np.linalg.norm(places - (20.0, 20.0), axis=-1)
    on_it = np.all((places > 0.5) & (places < 39.5), axis=-1)
    assert np.abs(flat - bowed)[on_it & (away > 16.0)].max() < 0.02
    near = (flat - bowed)[on_it & (away < 8.0)]
    assert np.all(np.diff(near[np.argsort(away[on_it & (away < 8.0)])]) < 0.1)  # shallower outwards
    assert np.array_equal(heights(), flat)
    assert np.array_equal(texels(view.texture)[0], stored)


def test_a_bow_into_bricks_that_are_empty_is_seen(stage):
    top = 14.4  # no density reaches the brick above, which begins at 16
    view = showing(layer(top))
    assert texels(view.texture)[1][2, 2, 2] == 0.0
    draw = drawing(view, FROM_ABOVE, gives=(Give((20.0, 20.0, top + 11.0), (0.0, 0.0, 11.0), 8.0),))
    middle = stage.picture(FROM_ABOVE, draw).points(np.eye(4))[HEIGHT // 2, WIDTH // 2]
    assert middle[2] == pytest.approx(top + 11.0, abs=0.05)


@pytest.mark.parametrize("density", [1.0, 0.5])
@pytest.mark.parametrize("deep", [0.5, 2.0, 3.5])
def test_the_bow_under_a_loaded_tool_reaches_its_tip_and_is_gone_without_load(stage, deep, density):
    """What holds the mass of a cap as high as the tool is deep bows as deep, whatever its density."""
    grid = DensityGrid(np.array(density * layer(top=20.0), np.float32))
    before = grid.density.copy()
    push = Push(grid, SphereTool(6.0), Material(full_force=5.0, yield_ratio=0.41))
    view = showing(grid.density)

    def height():
        gives = live_view.gives_of(SimpleNamespace(push=push))
        picture = stage.picture(FROM_ABOVE, drawing(view, FROM_ABOVE, level=0.5 * density, gives=gives))
        return picture.points(np.eye(4))[HEIGHT // 2, WIDTH // 2, 2]

    assert push.move_to((20.0, 20.0, 26.0 - deep)).regime is Regime.ELASTIC
    assert height() == pytest.approx(20.0 - deep, abs=0.25)  # coverage is half a voxel vague
    assert push.move_to((20.0, 20.0, 27.0)).regime is Regime.NONE
    assert live_view.gives_of(SimpleNamespace(push=push)) == ()
    assert height() == pytest.approx(20.0, abs=0.02)
    push.lift()
    assert give.under(push) is None
    assert np.array_equal(grid.density, before)


def test_what_pulls_or_smooths_bows_nothing():
    for verb in ("pull", "smooth"):
        grid = DensityGrid(np.array(layer(top=20.0), np.float32))
        push = Push(grid, SphereTool(6.0), Material(full_force=5.0, yield_ratio=0.4), verb=verb)
        push.move_to((20.0, 20.0, 18.0), direction=(0.0, 0.0, 1.0), strength=0.01)
        assert give.under(push) is None


def test_the_surface_bows_under_mirrored_tools_as_well(stage):
    """In an array that has grown, whose first voxel is not that of the poses."""
    grid = DensityGrid(np.array(layer(top=20.0), np.float32))
    material = Material(full_force=5.0, yield_ratio=0.41)
    push = SymmetricPush(grid, SphereTool(4.0), material, axes="x", centre=(20.0, 20.0, 20.0))
    grid.grow((8, 0, 0), (0, 8, 0))
    push.move_to((12.0, 20.0, 22.5))
    gives = live_view.gives_of(SimpleNamespace(push=push))
    picture = stage.picture(FROM_ABOVE, drawing(showing(grid.density), FROM_ABOVE, gives=gives))
    places = picture.points(np.eye(4))
    for x in (12.0, 28.0):
        at = np.hypot(places[..., 0] - x - 8.0, places[..., 1] - 20.0).argmin()
        assert places[..., 2].flat[at] == pytest.approx(18.5, abs=0.2)
    far = np.hypot(places[..., 0] - 28.0, places[..., 1] - 5.0).argmin()
    assert places[..., 2].flat[far] == pytest.approx(20.0, abs=0.1)


@pytest.mark.parametrize("deep", [0.3, 2.0, 6.0])
def test_the_bow_is_that_of_a_half_space_under_a_ball(stage, deep):
    """The shader and `Give.at` say the same; at the edge of the contact, a^2 = R h, it is half as deep (Hertz)."""
    view, one = showing(layer(top=24.0)), Give((20.0, 20.0, 24.0 - deep), (0.0, 0.0, -deep), 7.0)
    assert one.at(np.sqrt(7.0 * deep)) == pytest.approx(0.5 * deep)
    picture = stage.picture(FROM_ABOVE, drawing(view, FROM_ABOVE, gives=(one,)))
    places = picture.points(np.eye(4))
    away = np.hypot(places[..., 0] - 20.0, places[..., 1] - 20.0)
    for distance in (0.0, 2.0, 4.0, 6.0):
        there = np.abs(away - distance) < 0.3
        assert 24.0 - places[there, 2].mean() == pytest.approx(one.at(distance), abs=0.06 + 0.03 * deep)


@pytest.mark.parametrize("radius", [1.0, 12.0])
@pytest.mark.parametrize("height", [0.0, 0.01, 0.3, 0.8, 1.0])
def test_the_cap_of_a_ball_has_the_height_that_its_volume_asks(radius, height):
    deep = height * radius
    volume = np.pi * deep**2 * (3.0 * radius - deep) / 3.0
    assert give.cap_height(volume, radius) == pytest.approx(deep, abs=1e-3 * radius)
    assert give.cap_height(9.0 * radius**3, radius) == radius


# How it looks


def test_a_dent_is_darker_than_what_surrounds_it_and_than_its_rim(stage):
    shape = (81, 81, 40)
    x, y, z = np.indices(shape)
    away = np.hypot(x - 40.0, y - 40.0)
    height = 25.0 + 2.0 * np.exp(-(((away - 12.0) / 2.5) ** 2))
    body = np.minimum(height - z, distance_from((40.0, 40.0, 27.0), shape) - 10.0)
    camera = Camera((40.0, 40.0, 200.0), (40.0, 40.0, 0.0), 30.0, perspective=False, up=(0.0, 1.0, 0.0))
    picture = stage.picture(camera, drawing(showing(np.clip(body + 0.5, 0.0, 1.0)), camera))
    place = picture.points(np.eye(4))
    away = np.hypot(place[..., 0] - 40.0, place[..., 1] - 40.0)
    dent, rim, plain = (picture.luminance[(away > a) & (away < b)] for a, b in ((0, 6), (11, 13), (22, 29)))
    assert dent.mean() < 0.75 * plain.mean()
    assert dent.mean() < 0.75 * rim.mean()
    assert rim.std() > 3.0 * plain.std()  # light falls on one side of it


def test_an_even_face_is_evenly_lit(stage):
    camera = Camera((0.0, -20.0, 60.0), (20.0, 20.0, 20.0))
    picture = stage.picture(camera, drawing(showing(layer()), camera))
    place = picture.points(np.eye(4))
    top = picture.seen & np.all((place[..., :2] > 12) & (place[..., :2] < 28), axis=-1) & (place[..., 2] > 19)
    assert top.sum() > 500
    assert np.ptp(picture.luminance[top]) < 0.02 * picture.luminance[top].mean()


# What it costs, and what it leaves


def test_the_same_picture_is_marched_once(stage):
    view, camera = showing(ball()), seen_from(np.eye(4), (40, -25, 30))
    state = cursor.CursorState((20, 17, 32), (0, 0, 1), 6.0, 9.0, Regime.NONE, 0.0, "")
    first = stage.picture(camera, drawing(view, camera))
    again = stage.picture(camera, drawing(view, camera))
    stage.picture(camera, drawing(view, camera), lambda: cursor.draw_rings(state))
    stage.picture(camera, drawing(view, camera), lambda: cursor.draw_rings(replace(state, position=(22, 17, 32))))
    assert view.marches == 1 and np.array_equal(first.colour, again.colour)
    marches = 1
    for other in (
        drawing(view, replace(camera, half=0.4)),
        drawing(view, camera),
        drawing(view, camera, level=0.4),
        drawing(view, camera, fog=True),
        drawing(view, camera, gives=(Give(CENTRE, (0.0, 0.0, -1.0), 3.0),)),
        drawing(view, camera, key=2),
    ):
        stage.picture(camera, other)
        marches += 1
        assert view.marches == marches
    source = SimpleNamespace(grid=DensityGrid(ball()))
    source.take_changes = lambda: (False, [((1, 1, 1), (2, 2, 2))])
    view.update(source)
    stage.picture(camera, drawing(view, camera, key=2))
    assert view.marches == marches + 1


def changing(density):
    """A stand-in for a session, and a function that changes a box of its voxels."""
    source = SimpleNamespace(grid=DensityGrid(density, copy=False), changes=[])

    def take_changes():
        taken, source.changes = source.changes, []
        return False, taken

    def change(low, high, value):
        density[tuple(slice(a, b) for a, b in zip(low, high))] = value
        source.changes.append((low, high))

    source.take_changes = take_changes
    return source, change


@pytest.mark.parametrize("fog", [False, True], ids=["surface", "fog"])
@pytest.mark.parametrize(
    "camera",
    [
        Camera((170.0, -90.0, 190.0), (60.0, 60.0, 40.0), 0.3),
        Camera((60.0, 60.0, 300.0), (60.0, 60.0, 0.0), 70.0, perspective=False, up=(0.0, 1.0, 0.0)),
        Camera((60.0, 20.0, 70.0), (60.0, 100.0, 30.0), 0.6),
    ],
    ids=["perspective", "orthographic", "over the box that changes"],
)
def test_what_is_marched_of_a_change_makes_the_picture_of_all(stage, camera, fog):
    density = np.ascontiguousarray(layer(top=40.0, shape=(120, 120, 80)), np.float32)
    source, change = changing(density)
    view = showing(density)
    bow = Give((90.0, 60.0, 38.0), (0.0, 0.0, -2.0), 8.0)
    stage.picture(camera, drawing(view, camera, fog=fog))
    for low, high, value, gives in (
        ((30, 30, 30), (42, 40, 44), 0.0, ()),
        ((80, 80, 41), (85, 84, 52), 1.0, ()),
        ((5, 5, 60), (9, 9, 64), 1.0, (bow,)),
        ((55, 15, 30), (65, 25, 41), 0.0, ()),
    ):
        change(low, high, value)
        view.update(source)
        picture = stage.picture(camera, drawing(view, camera, fog=fog, gives=gives))
        afresh = stage.picture(camera, drawing(showing(density), camera, fog=fog, gives=gives))
        # But for half floats, which are rounded when a box is sent and cut off when all is.
        assert np.allclose(picture.colour, afresh.colour, atol=4e-3)
        assert np.allclose(picture.depth, afresh.depth, atol=1e-5)


def test_another_grid_of_the_same_shape_is_seen_at_once(stage):
    camera = seen_from(np.eye(4), (40, -25, 30))
    view = showing(ball())
    stage.picture(camera, drawing(view, camera))
    other = ball(radius=6.0).astype(np.float32)
    view.update(SimpleNamespace(grid=DensityGrid(other, copy=False), take_changes=lambda: (True, [])))
    picture = stage.picture(camera, drawing(view, camera))
    assert np.array_equal(picture.colour, stage.picture(camera, drawing(showing(other), camera)).colour)


def test_a_small_change_costs_a_small_march(stage):
    density = np.array(layer(top=100.0, shape=(400, 400, 120)), np.float32)
    camera = Camera((200.0, 200.0, 600.0), (200.0, 200.0, 0.0), 200.0, perspective=False, up=(0.0, 1.0, 0.0))
    source, change = changing(density)
    view = showing(density)
    stage.picture(camera, drawing(view, camera))
    whole = view.marched_pixels
    assert whole == WIDTH * HEIGHT
    change((100, 100, 90), (116, 116, 100), 0.0)
    view.update(source)
    stage.picture(camera, drawing(view, camera))
    assert 0 < view.marched_pixels - whole < 0.06 * whole
    change((2, 2, 2), (4, 4, 4), 0.5)
    view.update(source)
    away = replace(camera, target=(200.0, 201.0, 1200.0), eye=(200.0, 200.0, 500.0))
    stage.picture(away, drawing(view, away, key=2))
    marches = view.marches
    change((2, 2, 2), (4, 4, 4), 1.0)
    view.update(source)
    out_of_sight = replace(camera, eye=(300.0, 300.0, 600.0), target=(300.0, 300.0, 0.0), half=50.0)
    stage.picture(out_of_sight, drawing(view, out_of_sight, key=3))
    assert view.marches == marches + 1
    change((2, 2, 2), (4, 4, 4), 0.0)
    view.update(source)
    stage.picture(out_of_sight, drawing(view, out_of_sight, key=3))
    assert view.marches == marches + 1  # it is not in that picture


def test_views_that_take_turns_keep_their_pictures(stage):
    view, camera = showing(ball()), seen_from(np.eye(4), (40, -25, 30))
    cameras = [camera, replace(camera, half=0.6), replace(camera, half=20.0, perspective=False)]
    for _ in range(3):
        for key, other in enumerate(cameras):
            stage.picture(other, drawing(view, other, key=key))
    assert view.marches == len(cameras)


@pytest.mark.parametrize(("test", "mask", "blend"), [("NONE", False, "NONE"), ("GREATER", True, "ADDITIVE")])
def test_others_draw_after_it_as_before(stage, test, mask, blend):
    view, camera = showing(ball()), seen_from(np.eye(4), (40, -25, 30))
    state = cursor.CursorState((20, 17, 32), (0, 0, 1), 6.0, 9.0, Regime.NONE, 0.5, "")
    found = []

    def around(draw):
        gpu.state.depth_test_set(test)
        gpu.state.depth_mask_set(mask)
        gpu.state.blend_set(blend)
        draw()
        found.append((gpu.state.depth_test_get(), gpu.state.depth_mask_get(), gpu.state.blend_get()))

    stage.picture(
        camera, lambda: around(drawing(view, camera)), lambda: around(lambda: cursor.draw_rings(state)), quad(0, 1, 0.1)
    )
    assert found == [(test, mask, blend)] * 2


def test_the_size_of_a_pixel_is_blenders_own_setting():
    assert [live_view.pixel_size(choice) for choice in ("1", "2", "4", "8")] == [1, 2, 4, 8]
    software = gpu.platform.device_type_get() == "SOFTWARE"
    assert live_view.pixel_size("AUTO") == (2 if software else 1)


def test_where_it_cannot_be_shown_is_said():
    window = bpy.context.window_manager.windows[0]
    space = next(area for area in window.screen.areas if area.type == "VIEW_3D").spaces.active
    told = {}
    for shading in ("WIREFRAME", "SOLID", "MATERIAL"):
        for overlays in (True, False):
            space.shading.type, space.overlay.show_overlays = shading, overlays
            told[shading, overlays] = live_view.cannot_show(space)
    assert [where for where, why in told.items() if why] == [("MATERIAL", False)]
    assert "overlays" in told["MATERIAL", False]


# In Blender's views


@pytest.fixture
def clay():
    """A block that is sculpted, and shown live, in a 3D view."""
    obj = new_clay(name="Clay")
    session.open_session(obj).take_display(obj)
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    bpy.context.view_layer.update()
    with bpy.context.temp_override(window=window, area=area, region=region):
        yield obj
        session.close_session()
    if bpy.app.timers.is_registered(session.give_back_displays):
        bpy.app.timers.unregister(session.give_back_displays)


LOOK = Camera((4.0, -5.0, 4.0), (0.0, 0.0, 0.0))


def whole_frame():
    """What Blender calls for a 3D view: before its scene, and after."""
    live_view._send()
    live_view._draw()


def in_its_place(stage, live):
    """What is to be seen of a session's grid, and how bright."""
    view = showing(live.grid.density)
    to_world = np.array(bpy.data.objects["Clay"].matrix_world) @ live.grid.transform
    return stage.picture(LOOK, drawing(view, LOOK, to_world, level=live.auto_level)).luminance


def test_the_volume_is_drawn_where_its_object_is(stage, clay):
    bpy.context.scene.render.preview_pixel_size = "1"
    live = session.live()
    first = stage.picture(LOOK, whole_frame)
    assert first.seen.sum() > 300
    assert np.allclose(first.luminance, in_its_place(stage, live), atol=0.01)
    clay.location, clay.rotation_euler, clay.scale = (0.5, 0.2, -0.3), (0.4, 0.5, 0.6), (1.2, 1.2, 1.2)
    bpy.context.view_layer.update()
    moved = stage.picture(LOOK, whole_frame)
    assert not np.allclose(moved.luminance, first.luminance, atol=0.1)
    assert np.allclose(moved.luminance, in_its_place(stage, live), atol=0.01)


def test_a_grid_that_grew_is_drawn_where_it_now_is(stage, clay):
    bpy.context.scene.render.preview_pixel_size = "1"
    live = session.live()
    stage.picture(LOOK, whole_frame)
    shape = live.grid.shape
    push = Push(live.grid, SphereTool(4.0), Material())
    push.move_to((12.0, 12.0, 3.0))
    push.move_to((12.0, 12.0, 1.0), continuous=True)
    assert live.grid.shape != shape
    grown = stage.picture(LOOK, whole_frame)
    assert np.allclose(grown.luminance, in_its_place(stage, live), atol=0.01)


def test_another_volume_takes_the_place_of_the_former(stage, clay):
    bpy.context.scene.render.preview_pixel_size = "1"
    stage.picture(LOOK, whole_frame)
    former = weakref.ref(live_view._views[session.live()].texture)
    other = new_clay(name="Other")
    other.location = (-1.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    session.open_session(other).take_display(other)
    assert former() is None  # what it had on the card went with its session
    picture = stage.picture(LOOK, whole_frame)
    bpy.data.objects["Clay"].location = other.location
    bpy.context.view_layer.update()
    assert np.allclose(picture.luminance, in_its_place(stage, session.live()), atol=0.01)


def test_what_is_hidden_or_in_another_scene_is_not_drawn(stage, clay, capsys):
    def drawn():
        return bool(stage.picture(LOOK, whole_frame).seen.any())

    assert drawn()
    clay.hide_set(True)
    assert not drawn()
    clay.hide_set(False)
    bpy.context.space_data.show_object_viewport_volume = False
    assert not drawn()
    bpy.context.space_data.show_object_viewport_volume = True
    collection = clay.users_collection[0]
    collection.objects.unlink(clay)
    bpy.context.view_layer.update()
    assert not drawn()
    collection.objects.link(clay)
    bpy.context.view_layer.update()
    assert drawn()
    session.close_session()
    assert not drawn()
    assert capsys.readouterr().err == ""


def test_what_goes_wrong_is_said_once_and_blender_draws_the_volume_again(stage, clay, monkeypatch, capsys):
    def fails(*_):
        raise RuntimeError("the card is on fire\nand so is the desk")

    assert clay.display_type == "BOUNDS"
    monkeypatch.setattr(LiveView, "draw", fails)
    for _ in range(3):
        assert not stage.picture(LOOK, whole_frame).seen.any()
    assert capsys.readouterr().err == "Repoussé: The live view is off: the card is on fire\n"
    assert live_view.cannot_show(bpy.context.space_data) == "The live view is off: the card is on fire"
    assert bpy.app.timers.is_registered(session.give_back_displays)
    session.give_back_displays()
    assert clay.display_type == "TEXTURED"
    monkeypatch.undo()
    session.close_session()
    session.open_session(clay).take_display(clay)  # as by choosing the tool again
    assert stage.picture(LOOK, whole_frame).seen.any()
    assert live_view.cannot_show(bpy.context.space_data) is None


def test_a_volume_too_long_for_the_graphics_card_is_refused_in_one_line():
    longest = 1 << 15
    with pytest.raises(ValueError, match=f"cannot hold 1 x 1 x {longest} voxels"):
        texture.DensityTexture().upload(BrickMap(np.zeros((1, 1, longest), np.float32)))


# The cursor


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0.6, 0, -0.8), (0.36, 0.48, 0.8)])
def test_a_circle_lies_in_its_plane(normal):
    centre = np.array((1.0, -2.0, 3.0))
    points = cursor.circle(centre, normal, 2.5) - centre
    assert np.allclose(points @ normal, 0.0, atol=1e-12)
    assert np.allclose(np.linalg.norm(points, axis=1), 2.5)
    assert np.allclose(points[0], points[-1]) and np.allclose(points[:-1].sum(axis=0), 0.0, atol=1e-9)
    arc = cursor.circle(centre, normal, 2.5, 0.25) - centre
    assert np.allclose(arc[0], points[0]) and arc[0] @ arc[-1] == pytest.approx(0.0, abs=1e-9)
    turned = np.cross(arc[:-1], arc[1:]) @ normal
    assert np.all(turned > 0.0) or np.all(turned < 0.0)


def test_the_rings_are_those_of_tool_and_reach_and_the_arc_shows_the_share():
    state = cursor.CursorState((1.0, 2.0, 3.0), (0.0, 1.0, 0.0), 2.0, 3.0, Regime.PLASTIC, 0.0, "")
    radii = [np.linalg.norm(points - points[:-1].mean(axis=0), axis=1).max() for points, _ in cursor.strokes(state)]
    assert radii == pytest.approx([2.0, 3.0])
    for points, _ in cursor.strokes(state):
        lifted = points[:, 1] - 2.0
        assert np.all((lifted > 0.0) & (lifted <= 0.05 * state.radius))
    for share in (0.1, 0.5, 1.0):
        *_, (arc, _) = cursor.strokes(replace(state, share=share))
        length = np.linalg.norm(np.diff(arc, axis=0), axis=1).sum()
        assert length == pytest.approx(2.0 * np.pi * share * cursor.ARC_RADIUS * state.radius, rel=0.01)


def test_rings_are_full_in_sight_and_faint_behind(stage):
    camera = Camera((0.0, 0.0, 100.0), (0.0, 0.0, 0.0), 20.0, perspective=False, up=(0.0, 1.0, 0.0))
    state = cursor.CursorState((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 10.0, 15.0, Regime.PLASTIC, 0.0, "")
    # Nearer than the rings, which are 100 of 1000 away.
    hidden = quad(0.0, 0.5, 0.51, (0.0, 0.0, 0.0, 1.0))
    picture = stage.picture(camera, hidden, lambda: cursor.draw_rings(state))
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    away = np.hypot(x - WIDTH / 2, y - HEIGHT / 2) * 40.0 / HEIGHT
    ring, reach = np.abs(away - 10.0) < 0.17, np.abs(away - 15.0) < 0.17
    elsewhere = (np.abs(away - 10.0) > 1.0) & (np.abs(away - 15.0) > 1.0)
    orange = np.array(cursor.COLOURS[Regime.PLASTIC])
    colour = picture.colour[..., :3]
    behind, in_sight = x < WIDTH / 2 - 1, x > WIDTH / 2 + 1
    full, faint = np.median(colour[ring & in_sight], axis=0), np.median(colour[ring & behind], axis=0)
    assert full[0] > 0.8 and np.allclose(full / full[0], orange / orange[0], atol=0.1)
    assert np.allclose(faint, cursor.BEHIND * full, atol=0.08)
    assert colour[reach & in_sight, 0].mean() > 2.0 * colour[reach & behind, 0].mean() > 0.05
    assert np.allclose(colour[elsewhere & in_sight], GROUND, atol=1e-3)
    assert np.array_equal(picture.depth[:, : WIDTH // 2], np.full((HEIGHT, WIDTH // 2), np.float32(0.51)))
