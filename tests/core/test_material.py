# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials in newtons, the bound below which they are sure to yield, and the presets."""

import numpy as np
import pytest

from repousse.core import PRESETS, BoxTool, CapsuleTool, DensityGrid, Material, Push, Regime, SphereTool
from repousse.core.material import largest_yield_ratio

from .volumes import half_space, line, walk


@pytest.mark.parametrize(
    "tool", [SphereTool(6), BoxTool((4, 5, 6), 4), CapsuleTool((0, 4, 1), 4)], ids=lambda t: t.kind
)
def test_full_force_is_felt_inside_full_material(kernels, tool):
    push = Push(DensityGrid(np.ones((40, 40, 40), np.float32)), tool, Material(2.5, 0.01))
    assert push.move_to((19.5, 19.5, 19.5)).stress == pytest.approx(2.5, rel=0.005 if tool.kind == "sphere" else 0.01)


def test_stiffness():
    k_t, k_s = Material(3.3, 0.1).stiffness(SphereTool(16))
    assert k_t * SphereTool(16).volume.covered_volume == pytest.approx(3.3)
    assert k_s == pytest.approx(0.1 * k_t)


@pytest.mark.parametrize(("radius", "reach"), [(16, 24), (16, 20), (8, 12)])
def test_bound_of_a_sphere(radius, reach):
    """1 / ((R_s / R)^3 - 1), but for the lattice's half voxels."""
    assert largest_yield_ratio(SphereTool(radius, reach)) == pytest.approx(1 / ((reach / radius) ** 3 - 1), rel=0.01)


@pytest.mark.parametrize("ratio", [0.9, 1.1])
def test_the_bound_divides_what_yields_from_what_does_not(ratio):
    """Inside uniform material: under the bound the tool overloads it, over the bound it does not, and is warned of."""
    tool = SphereTool(6)
    material = Material(3.3, ratio * largest_yield_ratio(tool))
    grid = DensityGrid(np.full((40, 40, 40), 0.5, np.float32))
    if ratio < 1.0:
        push = Push(grid, tool, material)
    else:
        with pytest.warns(UserWarning, match=f"{largest_yield_ratio(tool):.3g}"):
            push = Push(grid, tool, material)
    regimes = {contact.regime for contact in walk(push, line((17.0, 19.5, 19.5), (21.0, 19.5, 19.5), 0.5))}
    assert (Regime.PLASTIC in regimes) == (ratio < 1.0)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_do_what_they_say(name):
    """Each yields under a ball, one that has a band raises a rim, and one that has none does not."""
    preset = PRESETS[name]
    assert preset.feel and "\n" not in preset.feel
    assert 0.0 < preset.density <= 1.0
    grid = half_space(56, preset.density, 20)
    band = None if preset.band is None else preset.band * 8
    push = Push(grid, SphereTool(8), preset.material, border="wall", band=band)
    contacts = walk(push, line((11.0, 27.5, 27.5), (19.5, 27.5, 27.5)))
    assert contacts[-1].regime is Regime.PLASTIC
    raised = grid.density[:20].sum(dtype=np.float64)
    moved = sum(contact.moved_mass for contact in contacts)
    assert raised > 0.1 * moved if preset.density >= 0.98 else raised < 0.01 * moved


def test_presets_are_there():
    assert {"clay", "wax", "dough", "foam", "snow"} <= set(PRESETS)


@pytest.mark.parametrize("force", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_force(force):
    with pytest.raises(ValueError, match="full_force"):
        Material(full_force=force)


@pytest.mark.parametrize("ratio", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_yield_ratio(ratio):
    with pytest.raises(ValueError, match="yield_ratio"):
        Material(yield_ratio=ratio)
