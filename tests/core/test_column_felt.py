# SPDX-License-Identifier: GPL-3.0-or-later
"""The column test as a hand feels it: the closed forms of DESIGN 2 in what the engine publishes, row by row.

A hand presses slowly into a walled column with a punch as wide as that, and draws back. It feels each pose twice:
early, before the deformation has got there, and late, after it has. The law holds both times, for what is felt is
min(sigma, sigma_f) however late the deformation is. All is over k_t A: voxels of material held per unit of area.
"""

from functools import cache
from threading import Semaphore

import numpy as np
import pytest

from repousse.core import BoxTool, DensityGrid, Engine, Material, Push, Sample
from tests.bench.truths.column import ColumnLaw

from .threads import PATIENCE, until

WITHIN = 0.05
ACROSS, FIRST, HALF, STEP = 8, 100, 48.0, 0.25
BESIDE = 0.1
"""No pose has the punch's face exactly between two voxels: there coverage has a kink, and its gradient is told as 0."""
CASES = [(0.1, 0.5, 30), (0.15, 0.7, 24), (0.3, 0.5, 12)]
WHEN = ("early", "late")

# A punch with walls around it yields far beyond the bound, which is for a tool in a large block.
pytestmark = [
    pytest.mark.filterwarnings("ignore:this material may never yield"),
    pytest.mark.usefixtures("nothing_left"),
]


class Presser:
    """A hand that goes on to its next pose when it has felt one early and late."""

    def __init__(self, push, xs):
        self.early, self.late = [], []
        self._push, self._xs = push, xs
        self._walk, push.walk = push.walk, self._walk_late
        self._felt_early = Semaphore(0)
        self._solved = None

    @property
    def done(self):
        return len(self.late) == len(self._xs)

    def sample(self):
        number = min(len(self.late), len(self._xs) - 1)
        middle = (ACROSS - 1) / 2
        return Sample(0.01 * number, (float(self._xs[number]), middle, middle))

    def feel(self, model):
        if len(self.early) == len(self.late):
            if not self.done:
                self.early.append(model)
                self._felt_early.release()
        elif self._solved == model.position and model.epoch == self._push.epoch:
            self.late.append(model)

    def _walk_late(self, sample):
        """The deformation's: not before the hand has felt that pose."""
        assert self._felt_early.acquire(timeout=PATIENCE)
        contact = self._walk(sample)
        self._solved = sample.position
        return contact


class Column:
    """One push and its retreat by hand: depths, and what is felt there."""

    def __init__(self, kappa, density, reach):
        self.law = law = ColumnLaw(1.0, kappa, density, reach)
        self.yields, self.plateau_begins = law.yield_depth, law.plateau_begins
        depth = np.ceil(1.6 * self.plateau_begins + 6)
        compacted = law.compacted_length(depth)
        values = np.zeros((FIRST + int(depth + compacted) + reach + 8, ACROSS, ACROSS), np.float32)
        values[FIRST:] = density
        punch = BoxTool((HALF, HALF + ACROSS, HALF + ACROSS), reach)
        push = Push(DensityGrid(values), punch, Material(3.3, kappa), border="wall")
        self.deltas = np.arange(0, int(depth / STEP) + 1) * STEP + BESIDE
        self.retreats = np.arange(0, int((self.yields + 4) / STEP) + 1) * STEP
        # The front face stands at the tool's centre + HALF, and the material's at FIRST - 1/2.
        surface = FIRST - 0.5 - HALF
        xs = surface + np.concatenate([self.deltas, self.deltas[-1] - self.retreats[1:]])
        hand = Presser(push, xs)
        with Engine(push, hand=hand) as running:
            until(lambda: hand.done or running.failure)
            samples = running.finish()
        assert [sample.position[0] for sample in samples] == list(xs)
        area, way_in = push.k_t * ACROSS * ACROSS, len(self.deltas)
        self.models = {"early": hand.early, "late": hand.late}
        self.area, self.felt, self.released = area, {}, {}
        for when in WHEN:
            felt = np.array([min(model.stress, model.yield_stress) for model in self.models[when]]) / area
            self.felt[when], self.released[when] = felt[:way_in], felt[way_in - 1 :]
        self.stress = np.array([model.stress for model in hand.early]) / area

    def line(self, when, low, high):
        """(slope, value at 0) of what is felt between two depths."""
        chosen = (self.deltas >= low - 1e-9) & (self.deltas <= high + 1e-9)
        assert chosen.sum() >= 4
        return np.polyfit(self.deltas[chosen], self.felt[when][chosen], 1)

    def elastic(self, when):
        return self.line(when, 1.0, self.yields - 0.5)

    def plastic(self, when):
        return self.line(when, self.yields + 1.0, self.plateau_begins - 2.0)

    def plateau(self, when):
        return self.felt[when][self.deltas > self.plateau_begins + 2.0]


@cache
def pressed(case):
    return Column(*case)


@pytest.fixture(params=CASES, ids="kappa{0[0]}-density{0[1]}-reach{0[2]}".format)
def column(request):
    """Pressed once for all tests."""
    return pressed(request.param)


def close(value, expected):
    assert value == pytest.approx(expected, rel=WITHIN)


@pytest.mark.parametrize("when", WHEN)
def test_elastic_slope(column, when):
    close(column.elastic(when)[0], column.law.elastic_slope)


@pytest.mark.parametrize("when", WHEN)
def test_yield_depth(column, when):
    """Where the elastic line meets the plastic one."""
    (elastic, a), (plastic, b) = column.elastic(when), column.plastic(when)
    close((b - a) / (elastic - plastic), column.yields)


@pytest.mark.parametrize("when", WHEN)
def test_plastic_slope(column, when):
    """The material hardens under the hand."""
    close(column.plastic(when)[0], column.law.plastic_slope)


@pytest.mark.parametrize("when", WHEN)
def test_plateau(column, when):
    for felt in column.plateau(when):
        close(felt, column.law.plateau)


@pytest.mark.parametrize("when", WHEN)
def test_plateau_begins(column, when):
    """Where the fitted line meets it."""
    slope, at_zero = column.plastic(when)
    close((column.plateau(when).mean() - at_zero) / slope, column.plateau_begins)


@pytest.mark.parametrize("when", WHEN)
def test_unloading(column, when):
    """Slope E / d0 over the first m voxels of retreat, for the front is compacted; then nothing."""
    m = column.yields
    assert m >= 3.0
    released, on_the_way = column.released[when], (column.retreats >= 0.25) & (column.retreats <= m - 1.0)
    slope, at_zero = np.polyfit(column.retreats[on_the_way], released[on_the_way], 1)
    close(-slope, column.law.stiffness)
    close(at_zero, m)
    assert (released[column.retreats > m + 1.0] == 0.0).all()


@pytest.mark.parametrize("when", WHEN)
def test_the_whole_curve(column, when):
    """Every pose on the way in, not the fits alone: within 5 % of what the plateau bears."""
    law = column.law.pressed(column.deltas)
    assert column.felt[when] == pytest.approx(law, abs=WITHIN * column.law.plateau)


def test_early_the_stress_alone_is_more_than_the_law(column):
    """Why the lesser of the two is felt: before the deformation gets there sigma overshoots by a step of elastic
    material, compacted on the plateau, and would fall back by as much when it does."""
    plateau = column.stress[: len(column.deltas)][column.deltas > column.plateau_begins + 2.0]
    assert plateau - column.yields == pytest.approx(np.full(len(plateau), STEP), rel=WITHIN)


@pytest.mark.parametrize("when", WHEN)
def test_the_force_points_out_of_the_material(column, when):
    touching = [model.normal for model in column.models[when] if model.stress > 0.05 * column.area * column.yields]
    assert np.array(touching) == pytest.approx(np.tile([-1.0, 0.0, 0.0], (len(touching), 1)), abs=1e-6)


def test_the_local_model_is_felt_on_the_way_to_the_next_pose(column):
    """A loop that has the model of one pose renders at the next what is felt there: 5 % of the plateau apart."""
    told, felt = [], []
    for model, after in zip(column.models["late"], column.models["early"][1:]):
        ahead = sum(g * (b - a) for g, a, b in zip(model.gradient, model.position, after.position))
        told.append(min(max(model.stress + ahead, 0.0), model.yield_stress))
        felt.append(min(after.stress, after.yield_stress))
    assert np.array(told) == pytest.approx(np.array(felt), abs=WITHIN * column.yields * column.area)
