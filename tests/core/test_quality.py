# SPDX-License-Identifier: GPL-3.0-or-later
"""Quality: what a step may cost, how far it may be from exact, and who chooses (core/quality.py)."""

from dataclasses import replace
from itertools import pairwise
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.core import DensityGrid, Engine, Material, Push, Sample, SphereTool, Stroke, SymmetricPush
from repousse.core.poses import Pose, Poses
from repousse.core.quality import COSTS, ERRORS, FLOWS, QUALITIES, Auto, error_of, quality_named

from .volumes import apart, half_space, line, walk

EXACT, BALANCED, DRAFT = QUALITIES.values()
CLAY = Material(3.3, 0.1)


def block(shape, density, first, last):
    values = np.zeros(shape, np.float32)
    values[first:last] = density
    return DensityGrid(values)


SCENES = {"compressible": (0.6, None), "saturated": (1.0, None), "rim": (1.0, 8.0)}


def pressed(flow, quality, radius=8.0):
    """Density before and after a press half a radius deep, and the push."""
    density, band = SCENES[flow]
    grid = block((76, 48, 48), density, 12, 64)
    before = grid.density.copy()
    push = Push(grid, SphereTool(radius), CLAY, band=band, border="open", quality=quality)
    contacts = walk(push, line((3.5, 23.5, 23.5), (11.5, 23.5, 23.5), 1.0))
    return before, grid.density, push, contacts


@pytest.mark.parametrize("flow", FLOWS)
def test_errors_are_those_of_the_chart(flow):
    """Each is as near to exact as the tables of `Auto` say; the tables are not idle either."""
    before, exact, push, _ = pressed(flow, "exact")
    assert push.flow == flow
    for quality in (BALANCED, DRAFT):
        error = apart(exact, pressed(flow, quality.name)[1], before)
        assert error <= error_of(quality, flow, 8.0)
    assert error > 0.05 * error_of(DRAFT, flow, 8.0)


@pytest.mark.parametrize("flow", FLOWS)
@pytest.mark.parametrize("quality", QUALITIES)
def test_every_quality_keeps_mass_and_bounds(kernels, quality, flow):
    before, after, _, contacts = pressed(flow, quality)
    out = sum(contact.mass_out for contact in contacts)
    assert sum(contact.moved_mass for contact in contacts) > 100.0
    assert abs(after.sum(dtype=np.float64) + out - before.sum(dtype=np.float64)) <= 1e-7 * before.sum(dtype=np.float64)
    assert after.min() >= 0.0 and after.max() <= 1.0


def test_work_of_each(kernels):
    """Counted: no more sweeps and voxels than the better quality needs, and a draft's solves are a voxel long."""
    sweeps, visited = {}, {}
    for quality in QUALITIES:
        *_, push, contacts = pressed("rim", quality)
        sweeps[quality], visited[quality] = sum(contact.sweeps for contact in contacts), push.voxels_visited
    assert sweeps["draft"] <= len(contacts) < 0.6 * sweeps["balanced"] * 2.0
    assert sweeps["balanced"] <= 2 * len(contacts) < sweeps["exact"]
    assert visited["draft"] < 0.7 * visited["balanced"] < 0.7 * visited["exact"]
    push = Push(half_space(30), SphereTool(3), CLAY, quality="draft")
    push.move_to((3.0, 14.5, 14.5))
    assert len(push._steps_to((7.0, 14.5, 14.5))) == 4
    push.move_to((3.0, 14.5, 14.5), quality="exact")
    assert len(push._steps_to((7.0, 14.5, 14.5))) == 8


def test_no_sheet_is_jumped_by_a_draft(kernels):
    """A sheet one voxel thin, crossed in one move by the smallest tool, is found and pushed."""
    grid = block((40, 12, 12), 1.0, 20, 21)
    push = Push(grid, SphereTool(1.0), CLAY, quality="draft")
    push.move_to((10.0, 5.5, 5.5))
    contact = push.move_to((30.0, 5.5, 5.5), continuous=True)
    assert contact.moved_mass > 1.0 and grid.density[20, 5, 5] < 0.5


def test_a_move_may_say_its_own(kernels):
    """The push's quality is what it takes where a move does not say."""
    ends = []
    for own, said in (("draft", None), ("exact", "draft"), ("exact", None), ("draft", "exact")):
        push = Push(half_space(40, 1.0, 12), SphereTool(6), CLAY, band=6.0, quality=own)
        walk(push, line((6.0, 19.5, 19.5), (12.0, 19.5, 19.5), 1.0), quality=said)
        ends.append(push.grid.density.tobytes())
    assert ends[0] == ends[1] != ends[2] == ends[3]


@pytest.mark.parametrize("symmetry", ["", "y"])
def test_a_stroke_is_walked_at_its_own_quality(kernels, symmetry):
    """What each sample says counts, not what the push is made with; mirror images follow."""
    stroke = Stroke.line(
        *((6.0, 12.0, 19.5), (12.0, 12.0, 19.5)),
        step=1.0,
        tool=SphereTool(4),
        material=CLAY,
        band=4.0,
        symmetry=symmetry,
        mirror=(19.5, 19.5, 19.5),
    )
    ends = {}
    for quality in QUALITIES:
        grid = half_space(40, 1.0, 12)
        wanted = stroke.at_quality(quality)
        assert {sample.quality for sample in wanted.samples} == {quality}
        push = wanted.push(grid)
        assert isinstance(push, SymmetricPush) == bool(symmetry)
        push.follow(wanted)
        ends[quality] = grid.density.tobytes()
        direct = half_space(40, 1.0, 12)
        how = {"axes": "y", "centre": stroke.mirror} if symmetry else {}
        made = (SymmetricPush if symmetry else Push)(direct, stroke.tool, CLAY, band=4.0, quality=quality, **how)
        walk(made, [sample.position for sample in stroke.samples])
        assert direct.density.tobytes() == ends[quality]
    assert len(set(ends.values())) == 3


@pytest.mark.parametrize("name", ["best", "", "auto", None, 7, ["exact"]])
def test_unknown_qualities(name):
    grid = half_space(20)
    before = grid.density.tobytes()
    push = Push(grid, SphereTool(3), CLAY)
    push.move_to((2.0, 9.5, 9.5))
    asked = [
        lambda: quality_named(name),
        lambda: Push(grid, SphereTool(3), CLAY, quality=name),
        lambda: Engine(push, quality=name),
        lambda: Stroke.line((0, 0, 0), (1, 0, 0)).at_quality(name),
    ]
    if name is not None:
        asked.append(lambda: push.move_to((9.0, 9.5, 9.5), quality=name))
    for ask in asked:
        with pytest.raises(ValueError, match=r"^there is no quality .*: choose from exact, balanced, draft$"):
            ask()
    assert grid.density.tobytes() == before


# Auto


def taught(ms, budget=8.0, bound=0.05, flow="saturated", quality=EXACT):
    """An Auto that has seen a few solves of so many milliseconds."""
    auto = Auto(budget, bound)
    for _ in range(5):
        auto.learn(quality, flow, ms / 1e3)
    return auto


def test_tables_are_whole():
    """Each quality but exact has an error and a cost for each flow; no error is less than that of a larger tool."""
    assert set(ERRORS) == set(COSTS) == set(QUALITIES) - {"exact"}
    for name in ERRORS:
        assert set(ERRORS[name]) == set(COSTS[name]) == set(FLOWS)
        for by_radius in ERRORS[name].values():
            assert list(by_radius) == sorted(by_radius)
            assert list(by_radius.values()) == sorted(
                by_radius.values(), reverse=True
            )  # of these tools and larger ones
    assert error_of(EXACT, "rim", 1.0) == 0.0
    assert error_of(DRAFT, "rim", 31.9) == error_of(DRAFT, "rim", 16.0) < error_of(DRAFT, "rim", 8.0)
    assert error_of(DRAFT, "rim", 3.9) == inf


def test_auto_begins_exact():
    choice = Auto(0.001).choose("saturated", 32.0, 100.0)
    assert choice.quality is EXACT and "timed" in choice.reason


def test_auto_takes_the_most_exact_that_fits():
    """2 ms a solve, four voxels of way: 16 ms exact, less balanced, least as a draft."""
    auto = taught(2.0)
    takes = [16.0 * cost for cost in (1.0, COSTS["balanced"]["saturated"], COSTS["draft"]["saturated"])]
    assert takes == sorted(takes, reverse=True)
    for quality, ms in zip((EXACT, BALANCED, DRAFT), takes, strict=True):
        auto.frame_budget = ms + 0.01
        choice = auto.choose("saturated", 32.0, 4.0)
        assert choice.quality is quality and choice.reason.startswith(f"{ms:.1f} of {ms + 0.01:g} ms")
        assert ("exact would take 16.0" in choice.reason) == (quality is not EXACT)
    auto.frame_budget = 0.1
    choice = auto.choose("saturated", 32.0, 4.0)
    assert choice.quality is DRAFT and choice.reason.endswith("nothing faster errs by at most 5 %")


def test_auto_learns_from_any_quality():
    """What a draft took tells what exact would take."""
    for quality in QUALITIES.values():
        cost = 1.0 if quality is EXACT else COSTS[quality.name]["rim"] * quality.longest_step / EXACT.longest_step
        auto = taught(3.0 * cost, 6.01, flow="rim", quality=quality)
        assert auto.choose("rim", 16.0, 1.0).quality is EXACT  # 2 solves of 3 ms
        assert auto.choose("rim", 16.0, 1.5).quality is not EXACT
        auto.frame_budget = 5.99
        assert auto.choose("rim", 16.0, 1.0).quality is not EXACT


def test_auto_does_not_mind_a_spike():
    auto = taught(1.0)
    auto.learn(EXACT, "saturated", 0.06)
    assert auto.choose("saturated", 32.0, 1.0).quality is EXACT


@given(
    ms=st.floats(0.01, 100.0),
    budget=st.floats(0.1, 50.0),
    bound=st.floats(1e-4, 1.0),
    flow=st.sampled_from(FLOWS),
    radius=st.floats(1.0, 100.0),
    ahead=st.floats(0.0, 40.0),
)
def test_auto_never_passes_the_bound(ms, budget, bound, flow, radius, ahead):
    auto = taught(ms, budget, bound, flow)
    choice = auto.choose(flow, radius, ahead)
    assert error_of(choice.quality, flow, radius) <= bound
    assert choice == auto.choose(flow, radius, ahead)
    assert "\n" not in choice.reason


@pytest.mark.parametrize("value", [0.0, -1.0, nan, inf])
def test_bad_autos(value):
    with pytest.raises(ValueError, match="the frame budget is a number over 0"):
        Auto(frame_budget=value)
    with pytest.raises(ValueError, match="the error bound is a number over 0"):
        Auto(error_bound=value)


def test_the_way_that_waits():
    poses = Poses(SphereTool(4), coalesced=False)
    for number, x in enumerate((0.0, 3.0, 5.0, 25.0, 26.0)):
        poses.put(Sample(float(number), (x, 0.0, 0.0)))
    first = poses.take()
    assert poses.beyond(first) == pytest.approx(6.0)  # 3, 2 and 1; the jump is none
    assert poses.beyond(Pose(replace(first.sample, position=(1.0, 0.0, 0.0)), first.tool)) == pytest.approx(5.0)


# Auto in the engine


def live(clock_of, path, budget=30.0, bound=0.5, **options):
    """Walk a path live, all its poses waiting from the start. Returns the engine, when it is finished."""
    push = Push(half_space((100, 44, 44), 1.0, 12), SphereTool(6), Material(3.3, 0.05), border="open", **options)
    running = Engine(push, quality=Auto(budget, bound, clock_of(push)))
    for number, point in enumerate(path):
        running._poses.put(Sample(0.01 * number, tuple(float(p) for p in point)))
    running.start()
    running.finish()
    return running


class Listening(Auto):
    """An Auto that keeps how much way it was told of."""

    def __init__(self, *args):
        super().__init__(*args)
        self.told = []

    def choose(self, flow, radius, ahead):
        self.told.append(ahead)
        return super().choose(flow, radius, ahead)


@pytest.mark.parametrize("symmetry", ["", "y"])
def test_auto_is_told_all_the_way_that_waits(symmetry):
    """From each solve to the last pose that was fed, mirrored or not."""
    stroke = Stroke(tool=SphereTool(4), material=CLAY, symmetry=symmetry, mirror=(14.5, 14.5, 14.5))
    auto = Listening(8.0, 0.05, lambda: 0.0)
    running = Engine(stroke.push(half_space(30, 0.6, 10)), quality=auto)
    path = line((3.0, 9.0, 14.5), (9.0, 9.0, 14.5), 2.0)
    for number, point in enumerate(path):
        running._poses.put(Sample(0.1 * number, point))
    running.start()
    solved = running.finish()
    assert auto.told == pytest.approx([6.0, *(9.0 - sample.position[0] for sample in solved[:-1])])
    assert running.choice.quality is EXACT


def counting(push):
    """A clock that stands still but for the work: 100 ns for each voxel of flux."""
    return lambda: 1e-7 * push.voxels_visited


PATH = line((4.0, 21.5, 21.5), (12.0, 22.0, 21.5), 2.0)


def test_auto_in_the_engine_follows_its_clock(kernels):
    """The way that waits gets shorter, so the first solves are drafts and the last exact; twice it is the same."""
    runs = [live(counting, PATH) for _ in range(2)]
    chosen = [[sample.quality for sample in run.solved] for run in runs]
    assert chosen[0] == chosen[1] and set(chosen[0]) == set(QUALITIES)
    assert chosen[0][-1] == "exact" and "of 30 ms" in runs[0].choice.reason
    assert runs[0].push.grid.density.tobytes() == runs[1].push.grid.density.tobytes()
    steps = [np.linalg.norm(np.subtract(a.position, b.position)) for a, b in zip(runs[0].solved, runs[0].solved[1:])]
    for step, quality in zip(steps, chosen[0][1:], strict=True):
        assert step <= quality_named(quality).longest_step + 1e-9
    slow = live(lambda push: lambda: 1e-3 * push.voxels_visited, PATH)
    fast = live(lambda push: lambda: 0.0, PATH)
    assert [sample.quality for sample in slow.solved].count("draft") > chosen[0].count("draft")
    assert {sample.quality for sample in fast.solved} == {"exact"}


def test_a_replay_does_not_depend_on_the_clock(kernels, monkeypatch, tmp_path):
    """What was chosen live is in the stroke: through a file, without any clock, it leads to the same voxels."""
    run = live(counting, PATH)
    stroke = Stroke(run.solved, run.push.tool, run.push.material, border="open")
    stroke.save(tmp_path / "stroke")

    def no_clock():
        raise AssertionError("a replay has asked for the time")

    for name in ("quality", "engine"):
        monkeypatch.setattr(f"repousse.core.{name}.perf_counter", no_clock)
    again = half_space((100, 44, 44), 1.0, 12)
    loaded = Stroke.load(tmp_path / "stroke")
    assert {sample.quality for sample in loaded.samples} == set(QUALITIES)
    loaded.push(again).follow(loaded)
    assert again.density.tobytes() == run.push.grid.density.tobytes()
    exact = half_space((100, 44, 44), 1.0, 12)
    other = loaded.at_quality("exact")
    other.push(exact).follow(other)
    assert exact.density.tobytes() != again.density.tobytes()


@pytest.mark.parametrize("quality", QUALITIES)
def test_an_engine_of_one_quality(kernels, quality):
    """Every solved sample says so, none is longer than it allows, and nothing is said to have been chosen."""
    push = Push(half_space(40, 0.6, 12), SphereTool(5), CLAY)
    with Engine(push, quality=quality) as running:
        for sample in [Sample(0.1 * n, p) for n, p in enumerate(line((6.0, 19.5, 19.5), (12.0, 19.5, 19.5), 3.0))]:
            running.feed(sample)
        solved = running.finish()
    assert {sample.quality for sample in solved} == {quality} and running.choice is None
    longest = max(abs(b.position[0] - a.position[0]) for a, b in pairwise(solved))
    assert longest == pytest.approx(quality_named(quality).longest_step)
