# SPDX-License-Identifier: GPL-3.0-or-later
"""The column test: a flat punch as wide as a walled grid, against the closed forms of DESIGN 2, row by row.

Per unit of cross-section the tool holds M_t / A voxels of material, and the law is about that number against the depth
delta. The punch is wider than the grid, so that its shells lie across the push and the column stays one-dimensional.
"""

import importlib.util
from functools import cache

import numpy as np
import pytest

from repousse.core import BoxTool, DensityGrid, Material, Push, Regime
from tests.bench.truths.column import ColumnLaw

from .volumes import kernels_chosen

WITHIN = 0.01
ACROSS, FIRST, HALF, STEP = 8, 100, 48.0, 0.25
CASES = [(0.1, 0.5, 30), (0.1, 0.3, 30), (0.15, 0.7, 24), (0.3, 0.5, 12), (0.05, 0.4, 60)]
WALKS = [("compiled", case) for case in CASES] + [("numpy", CASES[2]), ("numpy", CASES[3])]

# A punch with walls around it yields far beyond the bound, which is for a tool in a large block.
pytestmark = pytest.mark.filterwarnings("ignore:this material may never yield")


@pytest.fixture(params=WALKS, ids=lambda walk: "{}-kappa{}-density{}-reach{}".format(walk[0], *walk[1]))
def column(request, monkeypatch):
    """Walked once for all tests."""
    name, case = request.param
    if name == "compiled" and not importlib.util.find_spec("repousse_kernels"):
        pytest.skip("the compiled kernels are not installed")
    with kernels_chosen(monkeypatch, name):
        return walked(name, case)


@cache
def walked(_kernels, case):
    return Column(*case)


class Column:
    """One push and its retreat: depths, stresses over k_t A (the mass in the tool per unit area), and what is left."""

    def __init__(self, kappa, density, reach, half=HALF, exponent=1.0):
        self.law = law = ColumnLaw(1.0, kappa, density, reach)
        self.kappa, self.density, self.reach = kappa, density, reach
        self.yields, self.plateau_begins = law.yield_depth, law.plateau_begins
        self.depth = np.ceil(1.6 * law.plateau_begins + 6)
        compacted = law.compacted_length(self.depth)
        values = np.zeros((FIRST + int(self.depth + compacted) + reach + 8, ACROSS, ACROSS), np.float32)
        values[FIRST:] = density
        self.grid = DensityGrid(values)
        punch = BoxTool((half, half + ACROSS, half + ACROSS), reach)
        push = Push(self.grid, punch, Material(3.3, kappa, exponent), border="wall")
        self.deltas = np.arange(0, int(self.depth / STEP) + 1) * STEP
        middle = (ACROSS - 1) / 2
        self.area = area = push.k_t * ACROSS * ACROSS
        # The front face stands at the tool's centre + half, and the material's at FIRST - 1/2.
        surface = FIRST - 0.5 - half
        way_in = [push.move_to((surface + delta, middle, middle)) for delta in self.deltas]
        self.regimes = [contact.regime for contact in way_in]
        self.held = np.array([contact.stress for contact in way_in]) / area
        self.allowed = np.array([contact.yield_stress for contact in way_in]) / area
        self.left = self.grid.density.copy()
        self.retreats = np.arange(0, int((law.yield_depth + 4) / STEP) + 1) * STEP
        way_out = [push.move_to((surface + self.depth - back, middle, middle)) for back in self.retreats]
        self.released = np.array([contact.stress for contact in way_out]) / area
        self.regimes_out = [contact.regime for contact in way_out]

    def slope(self, low, high):
        """(slope, value at 0) of the line through what is held between two depths."""
        chosen = (self.deltas >= low - 1e-9) & (self.deltas <= high + 1e-9)
        assert chosen.sum() >= 4
        return np.polyfit(self.deltas[chosen], self.held[chosen], 1)


def close(value, expected):
    assert value == pytest.approx(expected, rel=WITHIN)


def test_elastic_slope(column):
    slope, at_zero = column.slope(1.0, column.yields - 0.5)
    close(slope, column.law.elastic_slope)
    assert abs(at_zero) < 0.005 * column.density


def test_yield_depth(column):
    """Where the elastic line meets the plastic one."""
    (elastic, a), (plastic, b) = column.slope(1.0, column.yields - 0.5), plastic_line(column)
    close((b - a) / (elastic - plastic), column.law.yield_depth)


def plastic_line(column):
    return column.slope(column.yields + 1.0, column.plateau_begins - 2.0)


def test_plastic_slope(column):
    close(plastic_line(column)[0], column.law.plastic_slope)


def test_plateau(column):
    slope, _ = column.slope(column.plateau_begins + 2.0, column.depth)
    assert abs(slope) < 0.01 * column.density * column.kappa
    for held in column.held[column.deltas > column.plateau_begins + 2.0]:
        close(held, column.law.plateau)


def test_yield_stress(column):
    """sigma_f = k_s times what lies ahead: d0 D elastic, d0 (D + delta) / (1 + kappa) plastic, then D."""
    yields, plateau_begins = column.yields, column.plateau_begins
    for delta, allowed, law in zip(column.deltas, column.allowed, column.law.allowed(column.deltas)):
        if delta <= yields - 1.0 or yields + 1.0 <= delta <= plateau_begins - 2.0 or delta >= plateau_begins + 2.0:
            close(allowed, law)


def test_plateau_begins(column):
    """Within a voxel of it the law is discrete: it is where the fitted lines meet."""
    slope, at_zero = plastic_line(column)
    plateau = column.held[column.deltas > column.plateau_begins + 2.0].mean()
    close((plateau - at_zero) / slope, column.plateau_begins)


def test_unloading(column):
    """Slope E / d0 over the first m voxels of retreat, for the front is compacted; then nothing."""
    m = column.yields
    assert m >= 3.0
    on_the_way = (column.retreats >= 0.25) & (column.retreats <= m - 1.0)
    slope, at_zero = np.polyfit(column.retreats[on_the_way], column.released[on_the_way], 1)
    close(-slope, column.law.stiffness)
    close(at_zero, m)
    assert np.all(column.released[column.retreats > m + 1.0] == 0.0)
    assert {r for r, back in zip(column.regimes_out, column.retreats) if 0 < back < m - 1.0} == {Regime.UNLOADING}
    assert column.regimes_out[-1] is Regime.NONE
    assert np.array_equal(column.grid.density, column.left), "unloading changed the grid"


def test_compacted_length(column):
    """(d0 delta - m) / (1 - d0) of full material stand ahead of the tool."""
    d0, expected = column.density, column.law.compacted_length(column.depth)
    ahead = column.left[int(FIRST + column.depth) :].mean(axis=(1, 2))
    full = np.count_nonzero(ahead > 0.999)
    partial = ahead[full] if ahead[full] > d0 else d0
    close(full + (partial - d0) / (1 - d0), expected)


def test_regimes_follow_each_other(column):
    yields = column.yields
    for delta, regime in zip(column.deltas, column.regimes):
        if delta == 0.0:
            assert regime is Regime.NONE
        elif delta <= yields - 0.5:
            assert regime is Regime.ELASTIC
        elif delta >= yields + 0.5:
            assert regime is Regime.PLASTIC


def test_mass_stays(column):
    before = column.density * ACROSS * ACROSS * (column.left.shape[0] - FIRST)
    assert column.left.sum(dtype=np.float64) == pytest.approx(before, rel=1e-6)  # that of float32's own density
