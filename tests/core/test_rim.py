# SPDX-License-Identifier: GPL-3.0-or-later
"""The rim against the figures that finite elements gave it (facts/rim.md, DESIGN 7)."""

from functools import cache

import numpy as np
import pytest

from repousse.core import BoxTool, DensityGrid, Material, Push, SphereTool, native

from .volumes import TINY, half_space, line, walk

RADIUS, FIRST, N = 16, 36, 96
MIDDLE = (N - 1) / 2
SURFACE = FIRST - 0.5
DEPTHS = (0.156, 0.5, 1.0)


def heights(density, first=FIRST):
    """Height of the d = 1/2 surface over where it was, for material that fills from ``first`` on along axis 0."""
    top = (density >= 0.5).argmax(axis=0)
    j, k = np.indices(top.shape)
    inside = density[top, j, k].astype(float)
    outside = np.where(top > 0, density[np.maximum(top - 1, 0), j, k], 0.0).astype(float)
    part = (inside - 0.5) / np.maximum(inside - outside, 1e-6)
    return (first - 0.5) - (top - part)


def rings(height):
    """Mean height in rings one voxel wide around the middle."""
    j, k = np.indices(height.shape)
    radius = np.hypot(j - MIDDLE, k - MIDDLE).astype(int)
    return np.bincount(radius.ravel(), height.ravel()) / np.bincount(radius.ravel())


@cache
def pressed(density, **options):
    """Heights after pressing a ball into a block, for each of DEPTHS (in radii)."""
    grid = half_space(N, density, first=FIRST)
    push = Push(grid, SphereTool(RADIUS), Material(3.3, TINY), border="wall", band=RADIUS, **options)
    found, depth = {}, -0.25
    for wanted in DEPTHS:
        while depth < wanted * RADIUS - 1e-9:
            depth = min(depth + 0.25, wanted * RADIUS)
            push.move_to((SURFACE - RADIUS + depth, MIDDLE, MIDDLE))
        found[wanted] = heights(grid.density)
    return found


def press(density):
    """Ring heights of the same."""
    return {depth: rings(height) for depth, height in pressed(density).items()}


def off_smooth(height, reach=4):
    """How far heights are off the paraboloid that fits them best within ``reach`` voxels; zero at the border."""
    offsets = np.arange(-reach, reach + 1)
    y, z = (a.ravel().astype(float) for a in np.meshgrid(offsets, offsets, indexing="ij"))
    fit = np.linalg.pinv(np.stack([np.ones(y.size), y, z, y * y, y * z, z * z], axis=1))[0]
    around = np.lib.stride_tricks.sliding_window_view(height, (offsets.size, offsets.size))
    off, inner = np.zeros(height.shape), (slice(reach, -reach),) * 2
    off[inner] = height[inner] - around.reshape(*around.shape[:2], -1) @ fit
    return off


@pytest.mark.parametrize("depth", DEPTHS)
def test_rim_of_packed_material(depth):
    """Von Mises finite elements: .33 of the depth at .63 R, when the tool is .15 R deep."""
    ring = press(1.0)[depth]
    rim = ring.max() / (depth * RADIUS)
    assert 0.28 <= rim <= 0.40
    assert -ring.min() == pytest.approx(depth * RADIUS, abs=0.5)
    # It stands around the contact and is gone far away.
    contact = np.sqrt(RADIUS**2 - (RADIUS - depth * RADIUS) ** 2)
    assert 0.7 * contact <= ring.argmax() <= 1.6 * contact + 2
    assert abs(ring[min(int(3.0 * contact), N // 2 - 3) :]).max() < 0.05 * depth * RADIUS


@pytest.mark.parametrize(("depth", "rms"), [(0.5, 0.015), (1.0, 0.037)])
def test_no_terraces(depth, rms):
    """The slope is smooth: with one voxel of a column rising at a time it was .022 and .074 voxel off."""
    height = pressed(1.0)[depth]
    j, k = np.indices(height.shape) - MIDDLE
    radius, crest = np.hypot(j, k), int(rings(height).argmax())
    slope = (radius >= crest + 6) & (radius < 2.2 * RADIUS)
    assert np.sqrt((off_smooth(height)[slope] ** 2).mean()) <= rms


def test_the_crest_is_sharp():
    """What makes the slopes smooth leaves the crest: it stands beside the tool, and falls off at once."""
    ring = press(1.0)[1.0]
    crest = int(ring.argmax())
    assert RADIUS <= crest <= RADIUS + 2
    assert ring[crest] - ring[crest + 5] > 0.2 * ring[crest]


def test_wider_hats_make_a_lower_rim():
    """`rim` works smoothly from 1.2 on: a tenth more lowers the rim, and by no more than a tenth."""
    heights_ = [rings(pressed(1.0, rim=rim)[0.5]).max() for rim in (1.2, 1.32, 1.45, 1.6)]
    falls = np.array(heights_[1:]) / heights_[:-1]
    assert (falls < 0.99).all() and (falls > 0.90).all()


@pytest.mark.skipif(not native.available(), reason="the compiled kernels count")
def test_what_a_search_costs():
    """Hats do not grow with the tool, cells share lines of material, little is asked that is not surface."""
    hats = {}
    for radius in (8, 16):
        grid = half_space((4 * radius, 6 * radius, 6 * radius), 1.0, first=2 * radius)
        push = Push(grid, SphereTool(radius), Material(3.3, TINY), border="wall", band=radius)
        middle = 3 * radius - 0.5
        walk(push, line((radius - 0.5, middle, middle), (2.0 * radius - 0.5, middle, middle), 0.5))
        counts, searches = push._work.rim, []
        for step in range(1, 4):
            before = np.array([counts.hats, counts.asked, counts.sights])
            contact = push.move_to((2.0 * radius - 0.5 + 0.1 * step, middle, middle))
            searches.append((np.array([counts.hats, counts.asked, counts.sights]) - before) / contact.sweeps)
        hats[radius], asked, sights = np.mean(searches, axis=0)
        assert hats[radius] <= 300_000  # each voxel x each source was as many, and 1,100,000 for 32
        assert asked <= 2.0 * counts.count
        assert sights <= 2.5 * counts.count  # one line to a voxel took 14
    assert hats[16] <= 1.5 * hats[8]


@pytest.mark.parametrize("density", [0.95, 0.9])
def test_no_rim_when_there_is_room(density):
    assert press(density)[0.156].max() / (0.156 * RADIUS) == pytest.approx(0.0, abs=0.05)


def test_density_is_the_compressibility():
    """At .98 a third of the rim at 1, as hardening does it."""
    some, whole = press(0.98)[0.156].max(), press(1.0)[0.156].max()
    assert 0.15 <= some / whole <= 0.5
    assert press(0.9)[1.0].max() < press(0.95)[1.0].max() < press(0.98)[1.0].max() < press(1.0)[1.0].max()


def test_without_a_band_nothing_rises():
    grid = half_space((64, 40, 40), 1.0, first=20)
    before = grid.density.copy()
    push = Push(grid, SphereTool(6), Material(3.3, TINY), border="open", band=None)
    walk(push, line((13, 19.5, 19.5), (18, 19.5, 19.5)))
    assert not (grid.density[:20] > before[:20]).any()


@cache
def scrubbed():
    """Depth of a groove along its middle after each of three scrubs forth and back, and the height beside it."""
    n, first, far = (72, 128, 96), 28, 94
    grid = half_space(n, 1.0, first=first)
    push = Push(grid, SphereTool(RADIUS), Material(3.3, TINY), border="wall", band=RADIUS)
    centre = first - 0.5 - RADIUS + 6.0
    walk(push, line((centre - 6.5, 34, MIDDLE), (centre, 34, MIDDLE)))
    depths = []
    for _ in range(3):
        walk(push, line((centre, 34, MIDDLE), (centre, far, MIDDLE), 0.5))
        walk(push, line((centre, far, MIDDLE), (centre, 34, MIDDLE), 0.5))
        height = heights(grid.density, first)
        depths.append(-height[44 : far - 10, N // 2 - 1 : N // 2 + 1].mean(axis=1))
    return depths, height[44 : far - 10]


def test_a_groove_stays():
    """6 voxels deep and scrubbed forth and back three times it is 6.0 +- .1 deep everywhere along its middle."""
    # Midway between two rows the ball's foot is 1/8 R^-1 voxel above its lowest point: nothing.
    for depth in scrubbed()[0]:
        assert np.abs(depth - 6.0).max() <= 0.1


def test_a_groove_has_ridges():
    ridges = scrubbed()[1].mean(axis=0)
    assert ridges.max() > 2.0
    assert abs(ridges.argmax() - MIDDLE) < 1.6 * RADIUS
    assert ridges[: N // 2].max() == pytest.approx(ridges[N // 2 :].max(), rel=0.02)


@pytest.mark.parametrize("beside", [False, True], ids=["one behind the other", "side by side"])
def test_nothing_jumps_a_gap(beside):
    """Of two sheets 4 voxels apart only the one that is pressed gains: the other is within the hats' reach."""
    values = np.zeros((64, 72, 72), np.float32)
    if beside:
        values[20:, 22:36] = values[20:, 40:54] = 1.0
        start, end, other = (9.0, 29.0, 35.5), (14.5, 29.0, 35.5), (slice(None), slice(38, None))
    else:
        values[20:30] = values[34:44] = 1.0
        start, end, other = (9.0, 35.5, 35.5), (14.5, 35.5, 35.5), (slice(32, None),)
    grid = DensityGrid(values)
    push = Push(grid, SphereTool(10), Material(3.3, TINY), border="wall", band=4)
    moved = sum(contact.moved_mass for contact in walk(push, line(start, end)))
    assert moved > 200.0
    jumped = np.abs(grid.density[other] - values[other]).sum(dtype=np.float64)
    assert jumped < 0.01 * moved


@pytest.mark.parametrize("border", ["wall", "open"])
def test_enclosed(border, monkeypatch):
    """No free surface anywhere: at most six searches a dispersion, everything is put back, and the contact says so."""
    from repousse.core import rim  # the module, not the option

    searches = []
    gather = rim.gather
    monkeypatch.setattr(rim, "gather", lambda *arguments: (searches.append(1), gather(*arguments)))
    grid = DensityGrid(np.ones((48, 48, 48), np.float32))
    before = grid.density.copy()
    push = Push(grid, SphereTool(6), Material(3.3, TINY), border=border, band=6)
    push.move_to((23.5, 23.5, 23.5))
    for i in range(1, 9):
        searches.clear()
        contact = push.move_to((23.5 + 0.5 * i, 23.5, 23.5))
        assert len(searches) <= 6 * max(contact.sweeps, 1)
        if contact.sweeps:
            assert contact.blocked
    assert abs(grid.mass - before.sum(dtype=np.float64)) <= 1e-7 * grid.mass
    assert np.abs(grid.density - before).max() < 1e-3
    assert contact.residual == pytest.approx(contact.stress - contact.yield_stress, rel=1e-9)
    assert np.linalg.norm(contact.force) == pytest.approx(contact.yield_stress, rel=1e-9)


def test_edge_of_a_block_bulges():
    """Near an edge the material takes the short way out: its side swells, and evenly."""
    values = np.zeros((64, 64, 72), np.float32)
    values[20:, 16:] = 1.0
    grid = DensityGrid(values)
    push = Push(grid, SphereTool(10), Material(3.3, TINY), border="wall", band=10)
    walk(push, line((8.0, 22.0, 35.5), (14.5, 22.0, 35.5)))
    side = grid.density[:, :16].sum(dtype=np.float64)
    assert side > 20.0
    assert np.allclose(grid.density, grid.density[:, :, ::-1], atol=1e-5)


def test_a_second_press_finds_the_same_pit():
    """What a tool has packed beside itself it leaves alone when it comes again the same way."""
    grid = half_space((56, 48, 48), 1.0, first=20)
    push = Push(grid, SphereTool(8), Material(3.3, TINY), border="wall", band=8)
    path = line((11.0, 23.5, 23.5), (16.0, 23.5, 23.5))
    walk(push, path)
    after = grid.density.copy()
    push.lift()
    again = sum(c.moved_mass for c in walk(push, path))
    assert np.abs(grid.density - after).sum(dtype=np.float64) < 0.05 * np.abs(after[:20]).sum()
    assert again < 0.05 * after[:20].sum(dtype=np.float64)


def test_flat_punch_raises_a_rim_too():
    grid = half_space((64, 56, 56), 1.0, first=24)
    push = Push(grid, BoxTool((5, 8, 8), 5), Material(3.3, TINY), border="wall", band=8)
    walk(push, line((17.0, 27.5, 27.5), (23.0, 27.5, 27.5)))
    height = heights(grid.density, 24)
    assert height.max() > 0.5
    assert -height[27:29, 27:29].mean() == pytest.approx(23.0 + 5 - 23.5, abs=0.1)
