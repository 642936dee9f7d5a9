# SPDX-License-Identifier: GPL-3.0-or-later
"""Where lines of sight meet a density: against closed forms, and against the definition, walked in tiny steps."""

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.surface import Surface

from .volumes import half_space, line, speckled, walk


def ball(n, radius, ramp=1.0, centre=None):
    """A ball whose density falls from 1 to 0 over ``ramp`` voxels; its radius at density 1/2 is ``radius``."""
    centre = np.full(3, (n - 1) / 2 + 0.2) if centre is None else np.array(centre)
    at = np.indices((n, n, n)).transpose(1, 2, 3, 0) - centre
    values = np.clip(0.5 + (radius - np.linalg.norm(at, axis=-1)) / ramp, 0.0, 1.0)
    return DensityGrid(values.astype(np.float32)), centre


def rays_at(centre, aside, count=200, seed=0):
    """Lines of sight from afar that pass up to ``aside`` voxels beside a point, in all directions."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        off = np.cross(way, rng.normal(size=3))
        off *= aside * rng.uniform() / np.linalg.norm(off)
        yield centre + off - 150.0 * way, way


def angle(first, second):
    """Degrees between two unit vectors."""
    return np.degrees(2.0 * np.arcsin(min(1.0, np.linalg.norm(np.subtract(first, second)) / 2.0)))


def density_at(grid, points):
    """Trilinear density at points (..., 3), one corner after the other."""
    points = np.asarray(points, float)
    low = np.floor(points).astype(int)
    total = np.zeros(points.shape[:-1])
    for corner in np.ndindex(2, 2, 2):
        at = low + corner
        inside = ((at >= 0) & (at < grid.shape)).all(axis=-1)
        density = np.where(inside, grid.density[tuple(np.moveaxis(np.where(inside[..., None], at, 0), -1, 0))], 0.0)
        total += density * np.prod(1.0 - np.abs(points - at), axis=-1)
    return total


def first_by_definition(grid, level, origin, way, length, step=0.005):
    """The first point of a ray, in small steps, that has the level; None without one."""
    points = origin + np.arange(0.0, length, step)[:, None] * way
    has = density_at(grid, points) >= level
    return points[has.argmax()] if has.any() else None


def test_ball():
    """To .05 voxel and 2 degrees, wherever and from wherever it is hit."""
    grid, centre = ball(64, 22.0, ramp=2.0)
    surface = Surface(grid, 0.5)
    for origin, way in rays_at(centre, 20.0):
        hit = surface.hit(origin, way)
        out = np.array(hit.position) - centre
        assert np.linalg.norm(out) == pytest.approx(22.0, abs=0.05)
        assert angle(hit.normal, out / np.linalg.norm(out)) < 2.0
        assert np.linalg.norm(np.cross(hit.position - origin, way)) < 1e-9  # it lies on the ray
        assert out @ way < 0.0


@pytest.mark.parametrize("offset", [0.0, 0.23, 0.61])
def test_tilted_plane_of_partly_filled_voxels(offset):
    """To .07 voxel, .035 on the mean: trilinear density in voxels that are just as full as the plane leaves them."""
    n, normal = 48, np.array([0.5, -0.3, 0.81])
    normal /= np.linalg.norm(normal)
    above = (np.indices((n, n, n)).transpose(1, 2, 3, 0) - (n - 1) / 2) @ normal - offset
    parts = (np.array(list(np.ndindex(5, 5, 5))) - 2.0) / 5.0 @ normal  # of each voxel
    filled = np.mean([np.clip(0.5 - 5.0 * (above + part), 0.0, 1.0) for part in parts], axis=0)
    grid = DensityGrid(filled)
    surface, errors = Surface(grid, 0.5), []
    for origin, way in rays_at(np.full(3, (n - 1) / 2), 10.0, count=400):
        hit = surface.hit(origin, way)
        if hit is None or way @ normal > 0.0 or np.abs(np.array(hit.position) - (n - 1) / 2).max() > n / 2 - 8:
            continue  # the sides of the block are not the plane
        errors.append((np.array(hit.position) - (n - 1) / 2) @ normal - offset)
        assert angle(hit.normal, normal) < 2.0
    assert len(errors) > 80
    assert np.abs(errors).max() < 0.07
    assert np.abs(errors).mean() < 0.035


def test_the_definition_on_noise():
    """In a density without any order, the first crossing and no other: from outside, from inside, along the axes."""
    rng = np.random.default_rng(3)
    grid = DensityGrid(rng.random((9, 10, 11), dtype=np.float32) ** 2)
    level = 0.6
    surface = Surface(grid, level)
    ways = [*np.eye(3), *-np.eye(3), (1, 1, 0), (0, -1, 1), *rng.normal(size=(40, 3))]
    found = 0
    for number, way in enumerate(ways):
        way = np.array(way) / np.linalg.norm(way)
        origin = rng.uniform(0.0, 9.0, 3) - (0.0 if number % 2 else 15.0) * way
        if number % 3 == 0:
            origin = np.round(origin)  # on the planes between cells
        wanted, position = first_by_definition(grid, level, origin, way, 40.0), surface.meet(origin, way)
        assert (wanted is None) == (position is None)
        if position is not None:
            found += 1
            assert -1e-9 <= (wanted - position) @ way <= 0.00501
            assert density_at(grid, np.array(position)) >= level - 1e-6
    assert found > 20


@pytest.mark.parametrize("slope", [90.0, 30.0, 5.0, 1.0, 0.2])
@pytest.mark.parametrize("level", [0.1, 0.5, 0.97])
def test_a_sheet_of_one_voxel_is_never_missed(slope, level):
    """Not at a level that it has only in a thirtieth of a voxel, and not at a grazing angle."""
    values = np.zeros((60, 20, 21), np.float32)
    values[:, :, 10] = 1.0
    surface = Surface(DensityGrid(values), level)
    fall = np.radians(slope)
    way = np.array([np.cos(fall), 0.0, -np.sin(fall)])
    for start in np.linspace(-0.4, 0.4, 9):
        aim = np.array([30.0 + start, 9.5 + start, 10.0])
        hit = surface.hit(aim - 200.0 * way, way)
        if slope > 2.0:
            assert hit.position[2] == pytest.approx(11.0 - level, abs=1e-5)
            assert angle(hit.normal, (0, 0, 1)) < 2.0
        else:  # so flat that it comes in over the rim of the sheet
            assert density_at(surface.grid, np.array(hit.position)) == pytest.approx(level, abs=1e-5)


def test_diagonal_sheets_and_threads():
    """Voxels that touch by edges and corners alone hold together where trilinear density has the level."""
    values = np.zeros((24, 24, 24), np.float32)
    for i in range(24):
        values[i, 23 - i, :] = 1.0
    sheet = Surface(DensityGrid(values), 0.45)
    for shift in np.linspace(0.0, 1.0, 23):
        hit = sheet.hit((-30.0 + shift, -30.0, 11.3), (1, 1, 0))
        assert hit is not None and hit.position[0] + hit.position[1] < 23.0
    thread = np.zeros((24, 24, 24), np.float32)
    thread[12, 12, :] = 0.6
    met = Surface(DensityGrid(thread), 0.59).hit((12.0, -40.0, 7.7), (0, 1, 0))
    assert met.position[1] == pytest.approx(12.0 - 1.0 / 60.0, abs=1e-5)
    assert Surface(DensityGrid(thread), 0.61).hit((12.0, -40.0, 7.7), (0, 1, 0)) is None


def test_a_sheet_before_a_block_has_its_own_normal():
    """Where the smoothed density rises the other way, the normal still faces who looks."""
    values = np.zeros((24, 24, 24), np.float32)
    values[:, :, 14] = 1.0  # thin, then air, then thick above it: seen from below the gap
    values[:, :, 16:] = 1.0
    hit = Surface(DensityGrid(values), 0.5).hit((11.5, 11.5, 15.0), (0, 0, -1))
    assert hit.position[2] == pytest.approx(14.5, abs=1e-5)
    assert angle(hit.normal, (0, 0, 1)) < 1e-3


def test_a_ray_that_begins_in_material_meets_it_there():
    grid, centre = ball(40, 12.0)
    inside = centre + np.array((3.0, 4.0, 0.0))
    hit = Surface(grid, 0.5).hit(inside, (0, 0, 3))
    assert hit.position == pytest.approx(tuple(inside))
    assert hit.normal == pytest.approx((0, 0, -1))  # uniform density has no way out: against the ray


def test_a_camera_in_the_box():
    """In the air of a hollow: what lies ahead of it, not what lies behind."""
    grid, centre = ball(48, 18.0, ramp=2.0)
    hollow = DensityGrid(1.0 - grid.density)
    surface = Surface(hollow, 0.5)
    for _, way in rays_at(centre, 0.0, count=50):
        hit = surface.hit(centre, way)
        assert np.array(hit.position) == pytest.approx(centre + 18.0 * way, abs=0.05)
        assert angle(hit.normal, -way) < 2.0


def test_a_viewpoint_at_a_million_voxels():
    grid, centre = ball(48, 18.0)
    surface = Surface(grid, 0.5)
    for origin, way in rays_at(centre, 15.0, count=50):
        near, far = surface.hit(origin, way), surface.hit(origin - 1e6 * way, way)
        assert far.position == pytest.approx(near.position, abs=1e-6)
        assert far.normal == pytest.approx(near.normal, abs=1e-6)


def test_what_meets_nothing():
    grid, _ = ball(40, 12.0)
    surface = Surface(grid, 0.5)
    assert surface.hit((-50.0, 80.0, 20.0), (1, 0, 0)) is None  # beside the box
    assert surface.hit((60.0, 20.0, 20.0), (1, 0, 0)) is None  # the box is behind
    assert surface.hit((-50.0, 1.0, 1.0), (1, 0, 0)) is None  # through a corner of the box
    assert surface.hit((-50.0, -1.0, 20.0), (1, 0, 0)) is None  # along the edge of what trilinear density reaches
    assert Surface(DensityGrid(np.full((8, 8, 8), 0.4)), 0.5).hit((-5, 4, 4), (1, 0, 0)) is None
    assert surface.voxels_read < 8 * 3 * 120


@pytest.mark.parametrize(
    "ray",
    [((0, 0, np.nan), (1, 0, 0)), ((0, 0, np.inf), (1, 0, 0)), ((0, 0, 0), (0, 0, 0)), ((0, 0, 0), (np.nan, 0, 1))],
)
def test_a_ray_that_is_none(ray):
    grid, _ = ball(16, 5.0)
    with pytest.raises(ValueError, match=r"^a ray"):
        Surface(grid, 0.5).hit(*ray)


def test_the_length_of_a_direction_is_no_matter():
    grid, _ = ball(40, 12.0)
    surface = Surface(grid, 0.5)
    assert surface.hit((-9, 20, 21), (3e4, 1e3, 0)) == surface.hit((-9, 20, 21), (30, 1, 0))


def test_with_a_history_the_old_surface_is_seen(kernels):
    """To the bit, while a push dents it and the grid grows; without one the dent is."""
    grid = half_space(48, 0.9, first=20)
    push = Push(grid, SphereTool(7.0), Material(3.3, 0.05), band=7.0)
    before = Surface(grid, 0.5)
    rays = [((-30.0, y, z), (1.0, 0.1 * (y - 24) / 24, 0.05)) for y in range(12, 38, 5) for z in range(3, 40, 6)]
    wanted = [before.hit(*ray) for ray in rays]
    history = push.remember()
    surface = Surface(grid, 0.5, history)
    for points in (line((10, 24, 24), (24, 24, 24)), line((24, 24, 24), (24, 24, -4), 1.0)):
        walk(push, points)
        assert [surface.hit(*ray) for ray in rays] == wanted
    assert push.origin[2] < 0  # the grid has grown
    x, y, z = push.origin
    now = Surface(grid, 0.5).hit((-30.0 - x, 24.0 - y, 20.0 - z), (1, 0, 0))
    assert now.position[0] + x > wanted[0].position[0] + 3.0


def test_normals_of_noisy_data_are_steady():
    """4 % noise on a ball: within 8 degrees of the truth, and neighbours within 5 of each other."""
    grid = speckled(64)
    surface, centre = Surface(grid, 0.22), np.full(3, 31.5)
    for origin, way in rays_at(centre, 12.0, count=60):
        aside = np.cross(way, (0.3, 0.4, 0.5))
        hit, beside = surface.hit(origin, way), surface.hit(origin + 0.5 * aside / np.linalg.norm(aside), way)
        out = np.array(hit.position) - centre
        assert angle(hit.normal, out / np.linalg.norm(out)) < 8.0
        assert angle(hit.normal, beside.normal) < 5.0


def test_a_ray_reads_what_it_passes_and_no_more():
    """The same count in a grid that is eight times as wide; and a surface that is near costs no more in a deep grid."""
    small, large = np.zeros((40, 16, 16), np.float32), np.zeros((40, 128, 128), np.float32)
    small[30:], large[30:] = 1.0, 1.0
    counts = []
    for values in (small, large):
        surface = Surface(DensityGrid(values), 0.5)
        assert surface.hit((-10.0, 8.2, 7.9), (1.0, 0.01, 0.02)).position[0] == pytest.approx(29.5, abs=1e-5)
        counts.append(surface.voxels_read)
    assert counts[0] == counts[1] < 8 * 3 * 40 + 12**3
    deep = np.zeros((4000, 8, 8), np.float32)
    deep[30:] = 1.0
    surface = Surface(DensityGrid(deep), 0.5)
    surface.hit((-10.0, 4.0, 4.0), (1, 0, 0))
    assert surface.voxels_read < 8 * 130 + 12**3


def test_level_zero_is_all_that_is_not_empty():
    values = np.zeros((12, 12, 12), np.float32)
    values[6, 6, 6] = 0.01
    hit = Surface(DensityGrid(values), 0.0).hit((-3, 6, 6), (1, 0, 0))
    assert hit.position[0] == pytest.approx(5.0, abs=1e-3)
