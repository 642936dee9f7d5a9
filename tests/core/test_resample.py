# SPDX-License-Identifier: GPL-3.0-or-later
"""Finer and coarser voxels: what is kept, what lies where, and that old voxels are not seen in the new."""

import numpy as np
import pytest

from repousse.core import DensityGrid
from repousse.core.formats.base import MAX_VOXELS
from repousse.core.resample import resample, resampled_shape
from repousse.core.surface import Surface

from .volumes import speckled

SIZES = (0.1, 0.19, 0.25, 0.3, 0.49, 0.51, 0.7, 1.0, 1.7, 3.0)


def placed(shape=(11, 8, 13), seed=0, values=None):
    """Noise up to the faces, on voxels of half a unit, turned and moved in the world."""
    noise = np.random.default_rng(seed).random(shape, dtype=np.float32) if values is None else values
    c, s = np.cos(0.4), np.sin(0.4)
    transform = np.eye(4)
    transform[:3, :3] = 0.5 * np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    transform[:3, 3] = (3.0, -7.0, 11.0)
    return DensityGrid(noise, transform, "smoke", {"source": "there"}, ["before"])


def integral(grid):
    return grid.mass * abs(np.linalg.det(grid.transform[:3, :3]))


def corner(grid, at):
    """Where in the world a corner of the grid's box lies: (0, 0, 0) the first, (1, 1, 1) the last."""
    return (grid.transform @ [*(np.array(at) * grid.shape - 0.5), 1.0])[:3]


@pytest.mark.parametrize("size", SIZES)
def test_the_integral_is_kept_and_densities_are_densities(size):
    grid = placed()
    there = resample(grid, size)
    assert integral(there) == pytest.approx(integral(grid), rel=1e-6)
    assert there.density.dtype == np.float32 and there.density.flags.c_contiguous
    assert there.density.min() >= 0.0 and there.density.max() <= 1.0
    assert there.shape == resampled_shape(grid, size)
    assert there.voxel_size == pytest.approx(size)


@pytest.mark.parametrize("size", SIZES)
def test_the_outer_faces_stay(size):
    """The first exactly; the last where the size divides the side, else the last voxel is partly filled."""
    grid = placed()
    there = resample(grid, size)
    assert corner(there, (0, 0, 0)) == pytest.approx(corner(grid, (0, 0, 0)), abs=1e-9)
    over = np.array(there.shape) * size - np.array(grid.shape) * 0.5
    assert (over > -1e-6).all() and (over < size).all()
    if size in (0.1, 0.25):
        assert corner(there, (1, 1, 1)) == pytest.approx(corner(grid, (1, 1, 1)), abs=1e-9)


def test_a_size_that_divides_the_side_but_for_rounding_adds_no_voxel():
    for size in (0.5 / 3.0, float(np.float32(0.1)), float(np.float32(0.7)) / 7.0):
        ratio = round(0.5 / size)
        assert resampled_shape(placed(), size) == tuple(ratio * n for n in (11, 8, 13))


@pytest.mark.parametrize("size", [0.1, 0.3, 0.7, 1.0])
def test_mass_stays_where_it_was(size):
    """The centre of mass in the world, to a few hundredths of a voxel; mass does not run together at the faces."""
    grid = placed(values=speckled((24, 20, 28)).density)
    there = resample(grid, size)

    def centre(g):
        at = np.indices(g.shape).reshape(3, -1) @ g.density.ravel().astype(float) / g.mass
        return (g.transform @ [*at, 1.0])[:3]

    assert centre(there) == pytest.approx(centre(grid), abs=0.01)


@pytest.mark.parametrize("size", [0.1, 0.3, 0.25, 1.0])
def test_a_full_block_stays_full(size):
    """Up to its faces, but for the voxels that reach beyond them."""
    there = resample(placed(values=np.ones((12, 10, 14), np.float32)), size)
    inside = tuple(slice(0, int(n * 0.5 / size + 1e-6)) for n in (12, 10, 14))
    assert there.density[inside] == pytest.approx(1.0, abs=2e-6)


def test_the_same_size_is_the_same_grid():
    """Bit for bit, as a copy; also when the size has gone through a float32."""
    grid = placed()
    for size in (0.5, float(np.float32(grid.voxel_size)), 0.5 * (1 + 4e-7)):
        same = resample(grid, size)
        assert (same.density == grid.density).all() and (same.transform == grid.transform).all()
        assert not np.shares_memory(same.density, grid.density)
        assert same.notes == ["before"]


def test_what_a_grid_is_called_goes_along():
    grid = placed()
    there = resample(grid, 0.25)
    assert (there.name, there.metadata) == ("smoke", {"source": "there"})
    assert there.notes[0] == "before" and "0.25" in there.notes[1] and grid.notes == ["before"]


def test_coarser_is_the_mean_of_what_is_covered():
    grid = placed((12, 8, 10))
    there = resample(grid, 1.0)
    wanted = grid.density.astype(float).reshape(6, 2, 4, 2, 5, 2).mean(axis=(1, 3, 5))
    assert there.density == pytest.approx(wanted, abs=1e-6)
    third = resample(placed(values=np.eye(3, dtype=np.float32)[:, :, None]), 0.75)
    assert third.density[:, :, 0] * 1.5 == pytest.approx(np.array([[5 / 9, 1 / 9], [1 / 9, 5 / 9]]), abs=1e-6)


def ball(n, radius):
    at = np.indices((n, n, n)).transpose(1, 2, 3, 0) - (n - 1) / 2 - 0.13
    return DensityGrid(np.clip(0.5 + radius - np.linalg.norm(at, axis=-1), 0.0, 1.0).astype(np.float32))


def roughness(grid, ratio):
    """Of a ball that had a radius of 12 voxels, in those: how its radius varies; how its faces lean, rms degrees."""
    surface, rng = Surface(grid, 0.5), np.random.default_rng(1)
    centre = np.full(3, ((40 - 1) / 2 + 0.13 + 0.5) * ratio - 0.5)
    radii, leans = [], []
    for _ in range(300):
        out = rng.normal(size=3)
        out /= np.linalg.norm(out)
        position = surface.meet(centre + 20.0 * ratio * out, -out)
        radii.append(np.linalg.norm(position - centre) / ratio)
        cosine = np.dot(surface.normal(position, -out, smoothing=0.7), out)  # of a voxel or two: what shading shows
        leans.append(np.degrees(np.arccos(min(1.0, cosine))))
    return np.std(radii), float(np.sqrt(np.mean(np.square(leans))))


@pytest.mark.parametrize("ratio", [2.0, 2.5, 4.0])
def test_no_stairs_of_old_voxels(ratio):
    """A finer ball is as smooth as it was, and far from the stairs that plainly repeated voxels make."""
    coarse = ball(40, 12.0)
    fine = resample(coarse, 1.0 / ratio)
    unevenness, lean = roughness(fine, ratio)
    at = [np.minimum(((np.arange(n) + 0.5) / ratio).astype(int), 39) for n in fine.shape]
    stairs, slopes = roughness(DensityGrid(coarse.density[np.ix_(*at)]), ratio)
    assert unevenness < 0.04 < 0.1 < stairs
    assert lean < 5.0 < 10.0 < slopes
    assert roughness(coarse, 1.0)[0] > unevenness * 0.8  # nor is it rougher than it came


def test_finer_and_back():
    """A smooth volume comes back; an edge of one voxel is softened, and moved nowhere."""
    x, y, z = np.ogrid[0:3:24j, 0:3:20j, 0:3:28j]
    smooth = DensityGrid((0.5 + 0.3 * np.sin(x) * np.cos(y) * np.sin(z + 0.3)).astype(np.float32))
    back = resample(resample(smooth, 1.0 / 3.0), 1.0)
    assert back.shape == smooth.shape
    assert back.transform == pytest.approx(smooth.transform, abs=1e-12)
    assert back.density == pytest.approx(smooth.density, abs=0.02)
    edge = DensityGrid(np.repeat([0.0, 1.0], 8).astype(np.float32)[:, None, None] * np.ones((1, 8, 8), np.float32))
    there = resample(resample(edge, 0.25), 1.0)
    assert there.density[:, 4, 4] == pytest.approx([0] * 7 + [1 / 6 * 0.5, 1 - 1 / 6 * 0.5] + [1] * 7, abs=0.1)
    for grid in (there, resample(edge, 0.25)):
        met = Surface(grid, 0.5).meet(np.linalg.inv(grid.transform)[:3] @ (-9.0, 3.6, 3.6, 1.0), (1, 0, 0))
        assert (grid.transform @ (*met, 1.0))[0] == pytest.approx(7.5, abs=1e-5)


def test_one_voxel_and_larger_ones_than_the_grid():
    one = DensityGrid(np.full((1, 1, 1), 0.75, np.float32))
    assert resample(one, 0.2).density == pytest.approx(np.full((5, 5, 5), 0.75), abs=1e-6)
    there = resample(placed(), 100.0)
    assert there.shape == (1, 1, 1)
    assert integral(there) == pytest.approx(integral(placed()), rel=1e-6)


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan, np.inf])
def test_sizes_that_are_none(size):
    for refused in (resample, resampled_shape):
        with pytest.raises(ValueError, match=r"^a voxel size is a positive length, not [^\n]*$"):
            refused(placed(), size)


@pytest.mark.parametrize("size", [1e-3, 1e-30])
def test_too_many_voxels_are_told_before_any_is_made(size):
    shape = resampled_shape(placed(), size)
    assert np.prod(shape, dtype=float) > MAX_VOXELS
    with pytest.raises(ValueError, match=rf"^voxels of {size:g} would be [^\n]* more than {MAX_VOXELS}[^\n]*$"):
        resample(placed(), size)
