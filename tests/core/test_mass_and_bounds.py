# SPDX-License-Identifier: GPL-3.0-or-later
"""Mass before = mass after + mass out to 1e-7 of the total in a thousand steps, and every voxel stays in [0, 1]."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from repousse.core import BoxTool, CapsuleTool, DensityGrid, Material, Push, SphereTool

from .volumes import TINY, half_space, line, net_moved, speckled

DRIFT = 1e-7

MATERIALS = {
    "compressible": (lambda: half_space(48, 0.5), {}),
    "saturated": (lambda: half_space((64, 40, 40), 1.0, first=16), {}),
    "packed, with a band": (lambda: half_space(48, 1.0), {"band": 6.0}),
    "nearly packed, with a band": (lambda: half_space(48, 0.95), {"band": 6.0}),
    "noise": (lambda: speckled(48), {}),
    "noise, with a band": (lambda: speckled(48), {"band": 6.0}),
}


def wander(steps, shape, seed=7):
    """A path that goes in, about and out again through a grid, most steps shorter than half a voxel."""
    random = np.random.default_rng(seed)
    phase = random.uniform(0.0, 2.0 * np.pi, 3)
    frequency = np.array([7.0, 11.0, 13.0]) * 2.0 * np.pi / 1000.0
    swing = np.array(shape) * [0.45, 0.35, 0.35]
    middle = (np.array(shape) - 1) / 2
    return [tuple(middle + swing * np.sin(frequency * i / 2.0 + phase)) for i in range(steps)]


def check(push, points):
    """Walk, and hold mass and bounds to what DESIGN 7 says."""
    before, values = push.grid.mass, push.grid.density.copy()
    out = moved = 0.0
    for point in points:
        contact = push.move_to(point)
        out += contact.mass_out
        moved += contact.moved_mass
    after = push.grid.density
    assert np.isfinite(after).all()
    assert after.min() >= 0.0
    assert after.max() <= 1.0
    assert out == 0.0 or push.border == "open"
    assert abs(push.grid.mass + out - before) <= DRIFT * before
    if after.shape == values.shape:
        assert net_moved(values, after) > 0.002 * before, "the tool hardly moved anything: this shows nothing"
    assert moved > 0.002 * before


@pytest.mark.parametrize("material", MATERIALS)
def test_a_thousand_steps(material):
    grid, options = MATERIALS[material][0](), MATERIALS[material][1]
    check(Push(grid, SphereTool(6), Material(3.3, 0.05), **options), wander(1000, grid.shape))


@pytest.mark.parametrize("border", ["wall", "open"])
@pytest.mark.parametrize("material", MATERIALS)
def test_borders(material, border):
    grid, options = MATERIALS[material][0](), MATERIALS[material][1]
    push = Push(grid, SphereTool(6), Material(3.3, 0.05), border=border, **options)
    check(push, wander(1000, grid.shape)[::4])


@pytest.mark.parametrize("material", MATERIALS)
def test_in_numpy(material, monkeypatch):
    monkeypatch.setenv("REPOUSSE_KERNELS", "numpy")
    grid, options = MATERIALS[material][0](), MATERIALS[material][1]
    check(Push(grid, SphereTool(5), Material(3.3, 0.05), **options), line((-1.0, 20.0, 22.0), (24.0, 24.0, 23.0), 0.5))


@pytest.mark.parametrize("tool", [BoxTool((3, 6, 5), 4), CapsuleTool((4, 0, 2), 4)], ids=lambda tool: tool.kind)
@pytest.mark.parametrize("band", [None, 5.0])
def test_other_tools(tool, band):
    grid = half_space(48, 0.9)
    check(Push(grid, tool, Material(3.3, 0.02), band=band), wander(400, grid.shape))


@pytest.mark.filterwarnings("ignore:this material may never yield")
@pytest.mark.parametrize("density", [0.3, 0.7])  # neither is a float32
def test_rounding_does_not_add_up(density):
    """A punch as wide as the grid does the same to all columns, so float32 rounds all alike: the worst case."""
    grid = half_space((160, 24, 24), density)
    push = Push(grid, BoxTool((8, 30, 30), 4), Material(3.3, 0.05), border="wall")
    before = grid.mass
    for i in range(1000):
        push.move_to((44.0 + 0.03 * i, 11.5, 11.5))
    assert abs(grid.mass - before) <= DRIFT * before


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(*[st.integers(5, 20)] * 3),
    fill=st.sampled_from([0.2, 0.7, 1.0]),
    border=st.sampled_from(["grow", "wall", "open"]),
    method_band=st.sampled_from([None, 0.0, 2.0, 5.0]),
    kappa=st.sampled_from([TINY, 0.02, 0.1]),
    points=st.lists(st.tuples(*[st.floats(-6.0, 26.0)] * 3), min_size=2, max_size=6),
)
def test_any_volume_and_path(seed, shape, fill, border, method_band, kappa, points):
    random = np.random.default_rng(seed)
    values = np.where(random.random(shape) < fill, random.random(shape) ** (1.0 - fill), 0.0).astype(np.float32)
    values[tuple(n // 2 for n in shape)] = 1.0
    grid = DensityGrid(values)
    before, out = grid.mass, 0.0
    push = Push(grid, SphereTool(3.5, 6.0), Material(1.0, kappa), border=border, band=method_band)
    for point in points:
        out += push.move_to(point, continuous=True).mass_out
    assert grid.density.min() >= 0.0
    assert grid.density.max() <= 1.0
    # Each of up to 100 solves may round: a small grid has no more than a few hundred voxels' worth to hide that in.
    assert abs(grid.mass + out - before) <= DRIFT * max(before, 100.0)
    assert out >= 0.0
