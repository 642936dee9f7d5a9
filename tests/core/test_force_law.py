# SPDX-License-Identifier: GPL-3.0-or-later
"""The exponent of the force: sigma = F (M_t / V_t)^m. What is felt changes with it, and no voxel does."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from repousse.core import CapsuleTool, DensityGrid, Material, Push, Regime, SphereTool, Stroke, SymmetricPush
from repousse.core.local_model import Feeler
from repousse.core.material import EXPONENTS, START

from .test_column_law import FIRST, WITHIN, Column, close
from .volumes import half_space, line, walk

F, R = 3.3, 8
POWERS = (0.5, 0.75, 1.5)
exponents = st.floats(*EXPONENTS)


def law(newtons, m):
    """F (p / F)^m for what the paper's law says to be p newtons, or an array of them."""
    return F * (np.asarray(newtons) / F) ** m


def ball(m, density=0.5, kappa=0.1, **how):
    grid = half_space((44, 40, 40), density, first=16)
    return Push(grid, SphereTool(R), Material(F, kappa, m), border="wall", **how)


def way():
    """In, aside on the way, and out again."""
    return line((7.1, 19.2, 18.7), (13.1, 20.2, 19.0), 0.31) + line((12.9, 20.2, 19.0), (9.0, 19.5, 19.0), 0.4)


# The law by itself


@settings(max_examples=50)
@given(st.floats(0.0, 10.0), st.floats(0.01, 30.0))
def test_with_exponent_1_it_is_the_papers_to_the_last_bit(newtons, full):
    assert Material(full, 0.1).felt(newtons) == (newtons, 1.0)


@given(st.floats(START, 2.0), exponents)
def test_it_is_the_power_from_the_start_on(share, m):
    newtons, rate = Material(F, 0.1, m).felt(F * share)
    assert newtons == pytest.approx(F * share**m, rel=1e-12)
    assert rate == pytest.approx(m * share ** (m - 1.0), rel=1e-12)


@pytest.mark.parametrize("m", [*POWERS, 1.0])
def test_the_start_meets_the_power_without_step_or_kink_and_is_finitely_steep(m):
    clay = Material(F, 0.1, m)
    (below, slope_below), (above, slope_above) = (clay.felt(F * START * part) for part in (1.0 - 1e-12, 1.0 + 1e-12))
    assert below == pytest.approx(above, rel=1e-9)
    assert slope_below == pytest.approx(slope_above, rel=1e-9)
    assert clay.felt(0.0) == (0.0, pytest.approx((2.0 - m) * START ** (m - 1.0)))
    shares = np.linspace(0.0, 1.5 * START, 400)
    slopes = np.array([clay.felt(F * share)[1] for share in shares])
    assert (slopes > 0.0).all()
    assert (np.sign(m - 1.0) * np.diff(slopes) >= -1e-9).all()  # no steeper anywhere than at first touch, for m < 1


def test_what_the_start_costs():
    """At most .06 % of the full force with exponent 3/4 and .8 % with 1/2, and nothing from START on."""
    shares = np.linspace(0.0, START, 500)
    for m, most in ((0.75, 0.0006), (0.5, 0.008)):
        told = np.array([Material(F, 0.1, m).felt(F * share)[0] for share in shares])
        lost = law(F * shares, m) - told
        assert (lost > -1e-12).all()
        assert 0.9 * most < lost.max() / F < most


@given(st.floats(1e-6, 2.0), exponents)
def test_the_rate_is_the_derivative(share, m):
    clay, h = Material(F, 0.1, m), 1e-4 * F * share
    low, high = (clay.felt(F * share + way)[0] for way in (-h, h))
    assert (high - low) / (2.0 * h) == pytest.approx(clay.felt(F * share)[1], rel=2e-4)


@given(st.floats(0.0, 5.0), st.floats(0.0, 5.0), exponents)
def test_it_keeps_the_order_of_stresses(one, other, m):
    clay = Material(F, 0.1, m)
    if one > other * (1.0 + 1e-9) + 1e-12:
        assert clay.felt(one)[0] > clay.felt(other)[0]


def test_a_mass_that_rounding_made_negative_stays_next_to_nothing():
    newtons, rate = Material(F, 0.1, 0.5).felt(-1e-12)
    assert -1e-9 < newtons < 0.0 < rate


@pytest.mark.parametrize("exponent", [0.49, 1.51, 0.0, -1.0, float("nan"), float("inf")])
def test_bad_exponent(exponent):
    with pytest.raises(ValueError, match=r"^exponent is a number from 0\.5 to 1\.5, not [^\n]*$"):
        Material(exponent=exponent)


# The column, row by row


@cache
def column(m):
    """A punch short enough that its column is not all in the start of the law."""
    return Column(0.15, 0.7, 24, half=12.0, exponent=m)


@pytest.mark.filterwarnings("ignore:this material may never yield")
@pytest.mark.parametrize("m", POWERS)
def test_each_row_of_the_column_is_raised_to_the_power(m):
    """DESIGN 2: elastic d0 delta, plastic kappa d0 (D + delta) / (1 + kappa), plateau kappa D, unloading m - back."""
    c = column(m)
    yields, seen = c.kappa * c.reach, set()
    for delta, held, allowed in zip(c.deltas, c.held, c.allowed):
        if 2.0 <= delta <= yields - 0.5:
            row, ahead = c.density * delta, c.density * c.kappa * c.reach
        elif yields + 1.0 <= delta <= c.plateau_begins - 2.0:
            row = ahead = c.kappa * c.density * (c.reach + delta) / (1.0 + c.kappa)
        elif delta >= c.plateau_begins + 2.0:
            row = ahead = yields
        else:
            continue
        assert row * c.area > START * F
        assert c.area * held == pytest.approx(law(c.area * row, m), rel=1.5 * WITHIN)
        assert c.area * allowed == pytest.approx(law(c.area * ahead, m), rel=1.5 * WITHIN)
        seen.add(row == ahead)
    assert seen == {True, False}
    for back, released in zip(c.retreats, c.released):
        if 0.25 <= back <= yields - 1.5:
            assert c.area * released == pytest.approx(law(c.area * (yields - back), m), rel=2.0 * WITHIN)
        elif back > yields + 1.0:
            assert released == 0.0
    ahead = c.left[int(FIRST + c.depth) :].mean(axis=(1, 2))
    full = np.count_nonzero(ahead > 0.999)
    partial = max(ahead[full], c.density)
    close(full + (partial - c.density) / (1 - c.density), (c.density * c.depth - yields) / (1 - c.density))


# What changes and what does not


@pytest.mark.parametrize("verb", ["push", "pull", "smooth"])
@pytest.mark.parametrize(("density", "band"), [(0.35, None), (1.0, 8.0)])
def test_no_voxel_depends_on_it(kernels, density, band, verb):
    """Bit for bit; and each stress is the paper's, raised to the power."""
    runs, flow = {}, (0.0, 0.6, -0.8) if verb == "pull" else None
    for m in (1.0, *POWERS):
        push = ball(m, density, band=band, verb=verb)
        contacts = walk(push, way(), direction=flow)
        masses = [(c.regime, c.moved_mass, c.sweeps, c.tool_mass, c.dirty) for c in contacts]
        runs[m] = push.grid.density.tobytes(), push.carry, masses, contacts
    changed = half_space((44, 40, 40), density, first=16).density.tobytes() != runs[1.0][0]
    assert changed
    for m in POWERS:
        assert runs[m][:3] == runs[1.0][:3]
        for felt, paper in zip(runs[m][3], runs[1.0][3], strict=True):
            for told, newtons in ((felt.stress, paper.stress), (felt.yield_stress, paper.yield_stress)):
                if newtons > START * F:
                    assert told == pytest.approx(law(newtons, m), rel=1e-12)
                else:
                    assert told == Material(F, 0.1, m).felt(newtons)[0]


def test_the_tolerance_of_what_is_overloaded_does_not_depend_on_it():
    """It is a share of the mass: in steps so small that the load creeps up to it, it is reached at the same step."""
    moved = []
    for m in (1.0, *POWERS):
        push = ball(m)
        walk(push, line((7.0, 19.2, 18.7), (11.0, 19.2, 18.7), 0.4))
        moved.append([push.move_to((11.0 + 0.0002 * step, 19.2, 18.7)).moved_mass for step in range(60)])
    assert 0 < np.count_nonzero(moved[0]) < 40  # it waits for more than one step
    assert moved == [moved[0]] * 4


def test_no_voxel_of_the_recursion_and_of_mirrored_tools_depends_on_it():
    runs = []
    for m in (1.0, 0.5):
        clay = Material(F, 0.1, m)
        literal = Push(half_space(24, 0.5, first=10), SphereTool(4), clay, method="recursive", border="wall")
        both = SymmetricPush(
            half_space((32, 44, 24), 0.6, 12), CapsuleTool((0.0, 2.0, 1.0), 4.0), clay, axes="y", centre=(16, 21.5, 12)
        )
        felt = walk(literal, line((6.0, 11.5, 11.5), (9.0, 11.5, 11.5), 0.4))
        felt += walk(both, line((8.0, 15.0, 11.5), (12.0, 17.0, 11.5), 0.4))
        runs.append((literal.grid.density.tobytes(), both.grid.density.tobytes(), [c.stress for c in felt]))
    assert runs[0][:2] == runs[1][:2]
    assert max(runs[0][2]) > START * F
    assert runs[1][2] == [Material(F, 0.1, 0.5).felt(newtons)[0] for newtons in runs[0][2]]


@pytest.mark.parametrize("m", POWERS)
def test_the_force_is_the_lesser_of_the_two_stresses(m):
    push, seen = ball(m), set()
    for contact in walk(push, way()):
        felt = min(contact.stress, contact.yield_stress)
        assert np.linalg.norm(contact.force) == pytest.approx(felt, rel=1e-9, abs=1e-12)
        assert contact.residual == (
            max(0.0, contact.stress - contact.yield_stress) if contact.regime is Regime.PLASTIC else 0.0
        )
        seen.add(contact.regime)
    assert seen == set(Regime)


@pytest.mark.parametrize("m", [*POWERS, 1.0])
@pytest.mark.parametrize("x", [7.93, 8.4, 11.3], ids=["start", "elastic", "plastic"])
def test_the_gradient_that_the_arm_follows_is_that_of_the_stress(kernels, m, x):
    push, place = ball(m, density=0.8), (x, 19.2, 18.7)
    walk(push, line((7.0, 19.2, 18.7), place, 0.3))
    feeler = Feeler(push)
    model = feeler.feel(place, push.tool)
    assert (model.stress < F * START**m) == (x < 8.0)
    assert model.stress == pytest.approx(push.contacts[0].stress, rel=1e-5)
    assert abs(model.exponent - 1.0) <= abs(m - 1.0) + 1e-12
    if x > 8.0:
        assert model.exponent == pytest.approx(m, rel=1e-12)
    slopes = []
    for axis in range(3):
        beside = [np.array(place) + np.eye(3)[axis] * h for h in (-5e-4, 5e-4)]
        low, high = (feeler.feel(tuple(position), push.tool).stress for position in beside)
        slopes.append((high - low) / 1e-3)
    assert slopes == pytest.approx(model.gradient, rel=1e-3, abs=1e-3 * np.linalg.norm(slopes))
    steepest = 0.75 * F / R * (2.0 - m) * START ** (m - 1.0)
    assert feeler.feel((2.0, 19.2, 18.7), push.tool).exponent == 1.0  # of nothing
    if m <= 1.0:  # 3 F / (4 R) at the equator, times the steepest slope of the law
        assert 0.0 < np.linalg.norm(model.gradient) < 1.05 * steepest


# Files


def test_a_stroke_keeps_it_and_is_replayed_to_the_same_voxels_and_forces(tmp_path):
    path = tmp_path / "stroke.jsonl"
    stroke = Stroke.line((7.0, 19.2, 18.7), (12.0, 19.2, 18.7), tool=SphereTool(R), material=Material(F, 0.1, 0.75))
    stroke.save(path)
    again = Stroke.load(path)
    assert again == stroke and again.material.exponent == 0.75
    ends = []
    for one in (stroke, again, replace(stroke, material=Material(F, 0.1))):
        push = one.push(half_space((44, 40, 40), 0.5, first=16))
        forces = np.array([contact.force for contact in push.follow(one)])
        ends.append((push.grid.density.tobytes(), forces.tobytes()))
    assert ends[0] == ends[1]
    assert ends[0][0] == ends[2][0] and ends[0][1] != ends[2][1]


def test_a_stroke_from_before_it_has_the_papers(tmp_path):
    header, *poses = Stroke.line((0, 0, 0), (1, 0, 0)).to_text().splitlines()
    record = json.loads(header)
    assert record["material"].pop("exponent") == 1.0
    assert Stroke.from_lines([json.dumps(record), *poses], "old").material == Material()


@pytest.mark.parametrize("exponent", [3, float("nan"), "firm", None, [1]])
def test_a_file_with_a_bad_exponent_is_refused_in_one_line(exponent):
    header, *poses = Stroke.line((0, 0, 0), (1, 0, 0)).to_text().splitlines()
    record = json.loads(header)
    record["material"]["exponent"] = exponent
    with pytest.raises(ValueError, match=r"^old, line 1: [^\n]+$"):
        Stroke.from_lines([json.dumps(record), *poses], "old")


def test_what_is_in_the_tool_is_told_beside_what_it_is_felt_as():
    push = ball(0.5)
    contact = push.move_to((10.0, 19.2, 18.7))
    assert push.k_t * contact.tool_mass > START * F
    assert contact.stress == pytest.approx(law(push.k_t * contact.tool_mass, 0.5), rel=1e-12)
    assert push.move_to((10.0, 19.2, 18.7)).tool_mass == contact.tool_mass  # at rest


def test_a_tool_inside_full_material_feels_full_force_with_any_exponent():
    for m in (*POWERS, 1.0):
        push = Push(DensityGrid(np.ones((28, 28, 28), np.float32)), SphereTool(6), Material(2.5, 0.01, m))
        assert push.move_to((13.5, 13.5, 13.5)).stress == pytest.approx(2.5, rel=0.01)
