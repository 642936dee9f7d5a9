# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine: what it publishes is never of mass in flight, live is replay, and it leaves nothing behind.

Nothing here waits for a time: threads are held at a known place (`Gate`) and looked at there.
"""

import contextlib
import dataclasses
import functools
import gc
import sys
import threading
import tracemalloc
import weakref
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from repousse.core import (
    DensityGrid,
    Engine,
    Material,
    Push,
    Regime,
    Sample,
    SphereTool,
    Stroke,
    SymmetricPush,
    dispersion,
    engine,
    local_model,
    rim,
    switching,
)
from repousse.core import push as push_module
from repousse.core.local_model import Feeler
from repousse.core.quality import LONGEST_STEP

from .threads import PATIENCE, Gate, names, until
from .volumes import half_space, in_frame, line

pytestmark = pytest.mark.usefixtures("nothing_left")

FOAM = Material(3.3, 0.1)


class Watched(Engine):
    """An engine whose every published model is kept."""

    def __init__(self, push):
        super().__init__(push)
        self.models = []

    def _publish(self, pose):
        published = super()._publish(pose)
        if published:
            self.models.append(self.model)
        return published

    @property
    def tries(self):
        return len(self.models) + self.health.discarded


def samples(points, **how):
    return [Sample(0.01 * number, tuple(map(float, point)), **how) for number, point in enumerate(points)]


def feed(running, points, **how):
    for sample in samples(points, **how):
        running.feed(sample)


TOOL = SphereTool(5, 6.5)
"""With a narrow reach, in light foam: there the reach misses mass in flight most."""
INTO = line((8.1, 19.0, 19.0), (13.6, 19.0, 19.0), 0.5)
"""From before the surface of `foam` to where the tool is as deep in it as it is wide."""
ON = (14.1, 19.0, 19.0)


def foam():
    return half_space(40, 0.2, 14)


def pushing(tool=TOOL, **options):
    return Push(foam(), tool, Material(3.3, 0.1), **{"border": "wall"} | options)


class Unaware:
    """A push as it looks to one who never sees its epoch."""

    epoch = 0

    def __init__(self, push):
        self._push = push

    def __getattr__(self, name):
        return getattr(self._push, name)


def watch_a_solve(monkeypatch, push, felt=None):
    """Hold a solve in mid flight while the collision thread tries 20 times at its pose, and 20 times right beside it.

    Returns the last model before the solve, the contact after it, and what was published in mid flight.
    """
    running, starting, landing = Watched(push), Gate(), Gate()
    running._feeler = Feeler(felt or push)
    monkeypatch.setattr(running._turn, "taken", contextlib.nullcontext)  # it tries on, instead of waiting for its turn
    with running:
        feed(running, INTO)
        assert running.settle(PATIENCE)
        monkeypatch.setattr(push, "walk", starting.before(push.walk))
        monkeypatch.setattr(dispersion, "sweep", landing.before(dispersion.sweep))
        running.feed(Sample(1.0, ON))
        until(lambda: running.model and running.model.position == ON)
        before = running.model
        starting.open()
        assert landing.reached.wait(PATIENCE)
        tries = running.tries
        until(lambda: running.tries > tries + 1)  # one may have begun before
        known = len(running.models)
        for beside in (0.0, 1e-9):
            running.feed(Sample(1.0, (ON[0] + beside, *ON[1:])))
            wanted = running.tries + 20
            until(lambda wanted=wanted: running.tries >= wanted)
        in_flight = running.models[known:]
        landing.open()
        assert running.settle(PATIENCE)
    return before, running.contact, in_flight


def test_nothing_is_published_while_mass_is_in_flight(kernels, monkeypatch):
    before, contact, in_flight = watch_a_solve(monkeypatch, pushing())
    assert contact.yield_stress > 1.01 * before.yield_stress  # it has hardened
    assert in_flight == []


def test_what_is_felt_would_dip_without_the_epoch(kernels, monkeypatch):
    """Why there is one: while mass is in flight the reach misses it, and the force would fall though it only rises."""
    push = pushing()
    before, contact, in_flight = watch_a_solve(monkeypatch, push, felt=Unaware(push))
    felt = [min(model.stress, model.yield_stress) for model in in_flight]
    assert contact.yield_stress > before.yield_stress == min(before.stress, before.yield_stress)
    assert min(felt) < 0.95 * before.yield_stress


def test_an_estimate_that_a_whole_solve_overlaps_is_not_published(kernels, monkeypatch):
    """It began before the mass took off and ended after it had landed."""
    push, estimating, starting = pushing(), Gate(), Gate()
    with Watched(push) as running:
        feed(running, INTO)
        assert running.settle(PATIENCE)
        monkeypatch.setattr(push, "walk", starting.before(push.walk))
        monkeypatch.setattr(local_model, "estimate", estimating.after(local_model.estimate))
        running.feed(Sample(1.0, ON))
        assert estimating.reached.wait(PATIENCE)
        discarded = running.health.discarded
        starting.open()
        assert running.settle(PATIENCE)
        estimating.open()
        until(lambda: running.model and running.model.position == ON)
        assert running.health.discarded == discarded + 1
        felt = [model.yield_stress for model in running.models if model.position == ON]
        assert felt == pytest.approx([running.contact.yield_stress] * len(felt), rel=1e-6)


PLACES = {
    "wall": lambda: (pushing(), INTO),
    "growth": lambda: (
        Push(DensityGrid(np.ones((27, 26, 25), np.float32)), TOOL, Material(3.3, 0.02)),
        line((13.0, 12.0, 12.0), (8.0, 12.3, 11.6), 0.5),
    ),
    "mirrored": lambda: (
        SymmetricPush(foam(), TOOL, Material(3.3, 0.1), axes="y", centre=(0, 19.5, 0)),
        line((8.0, 8.0, 19.0), (14.0, 9.0, 19.0), 0.5),
    ),
}


@pytest.mark.parametrize("place", PLACES)
def test_the_local_model_of_a_tool_at_rest_is_its_contact(kernels, place):
    push, path = PLACES[place]()
    with Engine(push) as running:
        feed(running, path)
        assert running.settle(PATIENCE)
        until(lambda: running.model and (running.model.position, running.model.epoch) == (path[-1], push.epoch))
        model, contact = running.model, running.contact
    assert contact.regime is Regime.PLASTIC
    assert model.stress == pytest.approx(contact.stress, rel=1e-5)
    assert model.yield_stress == pytest.approx(contact.yield_stress, rel=1e-5)
    force = min(contact.stress, contact.yield_stress) * np.array(model.normal)
    assert np.linalg.norm(model.normal) == pytest.approx(1.0)
    # The contact's normal is of before its solve.
    assert contact.force == pytest.approx(force, abs=0.1 * np.linalg.norm(force))


def test_the_local_model_foretells_the_stress_nearby(kernels):
    push = pushing()
    push.move_to((11.3, 19.2, 18.7))
    feeler = Feeler(push)
    model = feeler.feel((11.3, 19.2, 18.7), push.tool)
    for axis in range(3):
        beside = [np.array(model.position) + np.eye(3)[axis] * h for h in (-1e-3, 1e-3)]
        low, high = (feeler.feel(tuple(position), push.tool).stress for position in beside)
        assert (high - low) / 2e-3 == pytest.approx(model.gradient[axis], rel=1e-2, abs=1e-4)


@pytest.mark.parametrize("verb", ["push", "pull", "smooth"])
def test_what_is_pulled_or_smoothed_does_not_yield(verb):
    push = Push(half_space(40, 0.5, 14), TOOL, Material(3.3, 0.1), verb=verb)
    model = Feeler(push).feel((18.0, 19.0, 19.0), push.tool)
    assert (model.yield_stress == model.stress) == (verb != "push")
    assert model.yield_stress <= model.stress


def test_at_rest_only_the_time_of_the_local_model_is_new(kernels):
    with Watched(pushing()) as running:
        feed(running, INTO)
        assert running.settle(PATIENCE)
        until(lambda: len(running.models) > 1 and running.models[-1].epoch == running.push.epoch)
        known, estimates = len(running.models), running.health.estimates
        until(lambda: len(running.models) > known + 20)
        assert running.health.estimates == estimates
        later = running.models[known:]
        assert {dataclasses.replace(model, time=0.0) for model in later} == {dataclasses.replace(later[0], time=0.0)}
        times = [model.time for model in later]
        assert times == sorted(set(times))


def test_a_tool_of_another_radius_is_felt_as_such(kernels):
    with Engine(pushing()) as running:
        feed(running, INTO)
        running.feed(Sample(1.0, ON, radius=3.0))
        assert running.settle(PATIENCE)
        until(lambda: running.model and (running.model.position, running.model.epoch) == (ON, running.push.epoch))
        assert running.model.stress == pytest.approx(running.contact.stress, rel=1e-5)


def test_solves_without_a_gap_give_turns(monkeypatch):
    """While each solve lasts until the collision has been turned away, a local model comes after each all the same."""
    monkeypatch.setattr(engine, "LONGEST_TURN", PATIENCE)
    running = Watched(pushing())
    sweep = dispersion.sweep

    def long_sweep(work):
        until(lambda: running._turn._asked)
        return sweep(work)

    monkeypatch.setattr(dispersion, "sweep", long_sweep)
    with running:
        feed(running, INTO)
        feed(running, line(INTO[-1], (18.1, 19.0, 19.0), 0.5))
        running.finish()
    plastic = sum(stress == pytest.approx(limit, rel=3e-3) for _, stress, limit in running.trace)
    assert plastic > 10
    assert len({model.epoch for model in running.models}) >= plastic


# What is solved.

WAYS = {
    "push": Stroke(border="wall"),
    "rim": Stroke(border="wall", band=5.0),
    "growth": Stroke(material=Material(3.3, 0.02)),
    "mirrored": Stroke(border="open", symmetry="xz", mirror=(19.3, 19.5, 19.5)),
    "mirrored growth": Stroke(material=Material(3.3, 0.02), band=4.0, symmetry="y", mirror=(13.0, 13.0, 13.0)),
    "pull": Stroke(border="wall", verb="pull"),
    "smooth": Stroke(border="wall", verb="smooth"),
    "recursive": Stroke(border="open", method="recursive"),
}


def stroke_of(way):
    """A stroke and the grid it is for: fast poses along a bent way, of changing radius and some with a direction."""
    stroke = dataclasses.replace(WAYS[way], tool=SphereTool(4))
    grows = "growth" in way
    grid = DensityGrid(np.ones((27, 26, 25), np.float32)) if grows else half_space(40, 0.5, 14)
    corner = np.array((-4.0, 5.0, 12.0) if grows else (9.0, 12.0, 19.0))
    if way == "pull":
        corner[0] += 9.0
    points = [corner + np.array((0.4 * n, 1.3 * np.sin(n), 0.9 * np.cos(0.7 * n))) for n in range(16)]
    points.append(points[-1] + np.array((0.0, 11.0, 0.0)))  # a jump
    points += [points[-1] + np.array((0.6 * n, 0.1, -0.2)) for n in range(6)]
    how = [{"radius": 4.0 + 0.2 * (n % 3)} for n in range(len(points))]
    for n in range(len(how)):
        if way in ("pull", "smooth"):
            how[n] |= {"strength": 0.4, "direction": (-0.8, 0.6, 0.0)}
        elif n % 4 == 0:
            how[n] |= {"direction": (0.6, 0.8, 0.0)}
    fed = [Sample(0.02 * n, tuple(map(float, p)), **extra) for n, (p, extra) in enumerate(zip(points, how))]
    return grid, dataclasses.replace(stroke, samples=fed)


def state_of(push):
    return push.grid.density.tobytes(), push.grid.shape, push.grid.transform.tobytes(), push.origin


def lived(grid, stroke, push=None):
    """A push after an engine was fed a stroke as fast as that goes, what the engine says it solved, and the engine."""
    push = push or stroke.push(grid)
    with Engine(push) as running:
        for sample in stroke.samples:
            running.feed(sample)
            running.take_changes()
        return push, running.finish(), running


@functools.cache
def outcome(way):
    """The state in which an engine leaves a stroke's grid."""
    return state_of(lived(*stroke_of(way))[0])


@pytest.mark.parametrize("way", WAYS)
def test_live_is_replay(way):
    """What was solved, walked through a fresh push, leads to the same voxels bit for bit. So does what was fed, but for
    mirrored tools: live they take their half voxels in turn."""
    grid, stroke = stroke_of(way)
    before = grid.density.tobytes()
    live, solved, _ = lived(grid, stroke)
    assert grid.density.tobytes() != before
    assert (grid.shape != stroke_of(way)[0].shape) == ("growth" in way)
    for walked in [solved] if stroke.symmetry else [solved, stroke.samples]:
        replayed = stroke.push(stroke_of(way)[0])
        replayed.follow(dataclasses.replace(stroke, samples=walked))
        assert state_of(replayed) == state_of(live)


def test_live_is_replay_with_both_kernels(kernels):
    grid, stroke = stroke_of("mirrored growth")
    live, solved, _ = lived(grid, stroke)
    replayed = stroke.push(stroke_of("mirrored growth")[0])
    replayed.follow(dataclasses.replace(stroke, samples=solved))
    assert state_of(replayed) == state_of(live)


def test_solves_are_half_a_voxel_apart():
    """But for the jump; every fed pose is among them, and in between time runs evenly."""
    _, stroke = stroke_of("push")
    _, solved, _ = lived(*stroke_of("push"))
    assert [sample for sample in solved if sample in stroke.samples] == stroke.samples
    steps = [np.linalg.norm(np.subtract(b.position, a.position)) for a, b in pairwise(solved)]
    assert sorted(steps)[-2] <= LONGEST_STEP + 1e-9 < sorted(steps)[-1]
    times = [sample.time for sample in solved]
    assert times == sorted(set(times))


def test_the_trace_is_stress_against_depth():
    """Into the material depth and stress rise together; back out both fall; across a given direction is no depth."""
    inward = line((8.1, 19.2, 19.3), (16.1, 19.2, 19.3), 0.5)
    elsewhere = {"back": ((14.1, 19.2, 19.3), -2.0), "aside": ((16.1, 21.2, 19.3), 0.0)}
    for heading in ({}, {"direction": (1.0, 0.0, 0.0)}):
        for way, (end, expected) in elsewhere.items():
            with Engine(Push(half_space(40, 0.5, 14), SphereTool(5), Material(3.3, 0.1), border="wall")) as running:
                feed(running, inward + line(inward[-1], end, 0.5)[1:], **heading)
                running.finish()
            depths, stresses, limits = np.array(running.trace).T
            there = len(inward)
            touched = int(np.argmax(stresses > 0.0))
            assert (np.diff(stresses[touched:there]) > 0.0).all() and not stresses[:touched].any()
            assert depths[:there] == pytest.approx(np.maximum(0.5 * (np.arange(there) - touched), 0.0), abs=0.01)
            if heading or way == "back":
                assert depths[-1] - depths[there - 1] == pytest.approx(expected, abs=0.3)
            assert (stresses[-1] < 0.5 * stresses[there - 1]) == (way == "back")
            assert limits[-1] == running.contact.yield_stress


def test_feeding_never_waits(monkeypatch):
    """A thousand poses are taken while the first is held in mid flight."""
    gate = Gate()
    monkeypatch.setattr(dispersion, "sweep", gate.before(dispersion.sweep))
    with Engine(pushing()) as running:
        feed(running, INTO)
        assert gate.reached.wait(PATIENCE)
        feed(running, [ON] * 1000)
        assert not running.settle(0.0)
        gate.open()
        assert running.settle(PATIENCE)
        assert len(running.finish()) == len(INTO) + 1000


@pytest.mark.parametrize("bad", [Sample(0.0, (np.nan, 0.0, 0.0)), Sample(0.0, ON, radius=0.5)])
def test_a_bad_pose_is_refused_and_the_stroke_goes_on(bad):
    _, stroke = stroke_of("push")
    push = stroke.push(stroke_of("push")[0])
    with Engine(push) as running:
        for sample in stroke.samples:
            with pytest.raises(ValueError, match="voxel"):
                running.feed(bad)
            running.feed(sample)
        running.finish()
    assert state_of(push) == outcome("push")


def test_only_a_running_stroke_is_fed_and_each_engine_runs_once():
    running = Engine(pushing())
    with pytest.raises(RuntimeError, match="no stroke is running"):
        running.feed(Sample(0.0, ON))
    with running:
        with pytest.raises(RuntimeError, match="one stroke"):
            running.start()
        running.finish()
    with pytest.raises(RuntimeError, match="no stroke is running"):
        running.feed(Sample(0.0, ON))
    with pytest.raises(RuntimeError, match="one stroke"):
        running.start()


# What changed.


def marked(shape, boxes, origin):
    """Which voxels of a grid lie in boxes of the pose frame."""
    inside = np.zeros(shape, bool)
    for low, high in boxes:
        inside[tuple(slice(max(a - o, 0), b - o) for a, b, o in zip(low, high, origin))] = True
    return inside


@pytest.mark.parametrize("way", WAYS)
def test_changes_hold_every_voxel_that_changed(way):
    """At most one box for each tool; together with what was taken before they hold all that the stroke touched."""
    grid, stroke = stroke_of(way)
    push, start = stroke.push(grid), np.array(grid.shape)
    low, shape = (-16, -16, -16), tuple(start + 32)
    taken, ever = 0, []
    with Engine(push) as running:
        first = before = in_frame(grid, push.origin, low, shape)
        for batch in range(0, len(stroke.samples), 5):
            for sample in stroke.samples[batch : batch + 5]:
                running.feed(sample)
            assert running.settle(PATIENCE)
            boxes = running.take_changes() or []
            now = in_frame(grid, push.origin, low, shape)
            changed = now != before
            assert not (changed & ~marked(shape, boxes, low)).any()
            assert len(boxes) <= len(push.contacts)
            assert changed.any() == bool(boxes)
            assert running.take_changes() is None
            taken, before, ever = taken + len(boxes), now, ever + boxes
        assert taken >= len(push.contacts)
        assert not ((now != first) & ~marked(shape, running.touched, low)).any()
        assert (marked(shape, ever, low) <= marked(shape, running.touched, low)).all()
        assert len(running.touched) == len(push.contacts)
        running.finish()


def test_mirrored_tools_have_boxes_of_their_own():
    """Two small boxes, not a large one around both: that is what the screen is patched by."""
    push = SymmetricPush(
        half_space(64, 0.5, 20), SphereTool(4), Material(), axes="y", centre=(0, 31.5, 0), border="wall"
    )
    with Engine(push) as running:
        feed(running, line((16.0, 9.0, 31.0), (19.0, 9.0, 31.0), 0.5))
        assert running.settle(PATIENCE)
        (_, (_, b0, _)), ((_, a1, _), _) = running.take_changes()
        assert b0 < 31 < a1
        running.finish()


# How it ends.

SEAMS = {
    "sweep": (dispersion, "sweep"),
    "growth": (DensityGrid, "grow"),
    "rim": (rim, "raise_rim"),
    "estimate": (push_module, "estimate"),
    "keeping": (push_module, "union"),
}


@settings(max_examples=25)
@given(seam=st.sampled_from(sorted(SEAMS)), number=st.integers(1, 30), way=st.sampled_from(["mirrored growth", "rim"]))
def test_cancel_at_any_moment_restores_everything(seam, number, way):
    """Cancelled in the middle of a solve, wherever that is, or before or after it: every voxel is what it was."""
    grid, stroke = stroke_of(way)
    push = stroke.push(grid)
    before, gate = state_of(push), Gate(number)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(*SEAMS[seam], gate.before(getattr(*SEAMS[seam])))
        with Engine(push) as running:
            for sample in stroke.samples:
                running.feed(sample)
            until(lambda: gate.reached.is_set() or running.settle(0.0))
            opener = threading.Thread(target=lambda: running._stop.wait(PATIENCE) and gate.open())
            opener.start()
            running.cancel()
            opener.join()
    assert state_of(push) == before and grid.grown == (0, 0, 0)
    assert running.finish() == running.trace == running.touched == [] and running.model is None
    assert state_of(lived(grid, stroke, push)[0]) == outcome(way)


def test_cancelling_tells_what_it_changed_back():
    grid, stroke = stroke_of("mirrored")
    push = stroke.push(grid)
    with Engine(push) as running:
        for sample in stroke.samples:
            running.feed(sample)
        assert running.settle(PATIENCE)
        running.take_changes()
        pushed = grid.density.copy()
    assert (pushed != grid.density).any()
    assert not ((pushed != grid.density) & ~marked(grid.shape, running.take_changes(), push.origin)).any()


def test_a_finished_stroke_stays():
    """Whoever comes late and cancels it, as the undo of another stroke would, does nothing."""
    push, solved, running = lived(*stroke_of("push"))
    done = state_of(push)
    push.move_to(ON)
    later = state_of(push)
    running.cancel()
    assert state_of(push) == later != done
    assert running.finish() == solved != []


def test_a_cancelled_stroke_is_restored_once():
    grid, stroke = stroke_of("push")
    push = stroke.push(grid)
    running = Engine(push)
    running.start()
    running.feed(stroke.samples[0])
    running.cancel()
    push.follow(stroke)
    later = state_of(push)
    running.cancel()
    assert state_of(push) == later


def test_leaving_with_an_error_cancels():
    grid, stroke = stroke_of("growth")
    push = stroke.push(grid)
    before = state_of(push)
    with pytest.raises(KeyError, match="of the caller"), Engine(push) as running:
        for sample in stroke.samples:
            running.feed(sample)
        raise KeyError("of the caller")
    assert state_of(push) == before and not running.running


@pytest.mark.parametrize("way", ["growth", "mirrored", "recursive"])
def test_an_error_in_a_solve_is_raised_by_finish_and_undone_by_cancel(monkeypatch, way):
    grid, stroke = stroke_of(way)
    push = stroke.push(grid)
    before = state_of(push)
    place, name = (push_module, "disperse_recursively") if way == "recursive" else (dispersion, "sweep")
    real, calls = getattr(place, name), []

    def out_of_memory(*args):
        calls.append(args)
        if len(calls) == 8:
            raise MemoryError("no room for this")
        return real(*args)

    with monkeypatch.context() as patch:
        patch.setattr(place, name, out_of_memory)
        running = Engine(push)
        running.start()
        for sample in stroke.samples:
            running.feed(sample)
        assert not running.settle(PATIENCE)
        assert isinstance(running.failure, MemoryError)
        assert push.epoch % 2 == 1  # mass is lost in flight: nobody feels this
        assert Feeler(push).feel(ON, push.tool) is None
        for _ in range(2):
            with pytest.raises(MemoryError, match="no room for this"):
                running.finish()
        assert state_of(push) != before
        running.cancel()
    assert state_of(push) == before and push.epoch % 2 == 0
    assert state_of(lived(grid, stroke, push)[0]) == outcome(way)


def test_an_error_of_the_collision_ends_the_stroke(monkeypatch):
    def fails(probe):
        raise ZeroDivisionError("in the estimate")

    push = pushing()
    before = state_of(push)
    monkeypatch.setattr(local_model, "estimate", fails)
    with Engine(push) as running:
        feed(running, INTO)
        until(lambda: running.failure)
        with pytest.raises(ZeroDivisionError, match="in the estimate"):
            running.finish()
    assert state_of(push) == before


def test_two_engines_at_once():
    """Each has its threads; Python's switching is hurried until the last of them ends, whichever that is."""
    interval = sys.getswitchinterval()
    assert interval > switching.SWITCH_INTERVAL
    for order in ((0, 1), (1, 0)):
        running = [Engine(pushing()) for _ in range(2)]
        for one in running:
            one.start()
            feed(one, INTO)
        assert names() == ["repousse collision"] * 2 + ["repousse deformation"] * 2
        running[order[0]].finish()
        assert sys.getswitchinterval() == pytest.approx(switching.SWITCH_INTERVAL)
        assert names() == ["repousse collision", "repousse deformation"]
        running[order[1]].cancel()
        assert sys.getswitchinterval() == interval and names() == []


def test_a_thread_that_does_not_start_leaves_nothing(monkeypatch):
    real = threading.Thread.start

    def start(thread):
        if thread.name == "repousse collision":
            raise RuntimeError("can't start new thread")
        real(thread)

    monkeypatch.setattr(threading.Thread, "start", start)
    running = Engine(pushing())
    with pytest.raises(RuntimeError, match="new thread"):
        running.start()
    assert not running.running and names() == []


def test_the_hundredth_engine_costs_what_the_first_does():
    """No thread, no memory and no engine is left over from one stroke to the next, nor a collection waited for."""
    push = pushing()
    peaks, left = [], []
    gc.collect()
    gc.disable()
    tracemalloc.start()
    try:
        for number in range(100):
            tracemalloc.reset_peak()
            base, _ = tracemalloc.get_traced_memory()
            with Engine(push) as running:
                feed(running, INTO[::4])
            gone = weakref.ref(running)
            del running
            assert gone() is None and names() == []
            peaks.append(tracemalloc.get_traced_memory()[1] - base)
            if number in (9, 99):
                gc.collect()
                left.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
        gc.enable()
    assert left[1] - left[0] < 20_000
    assert max(peaks[10:]) < 1.1 * max(peaks[:10]) < 4.0 * push.grid.density.nbytes


def test_health_counts():
    _, solved, running = lived(*stroke_of("rim"))
    health = running.health
    assert health.solves == len(solved) and health.estimates >= 1
    assert 0.0 < health.longest_solve < PATIENCE
    assert 0.0 <= health.rate <= 1.1 / engine.PERIOD


def test_a_stroke_begins_where_its_first_pose_is():
    """Not where the push was before: nothing is ploughed on the way there."""
    push = pushing(border="open")
    push.move_to((13.6, 12.0, 19.0))
    with Engine(push) as running:
        running.feed(Sample(0.0, (13.6, 20.0, 19.0)))
        assert len(running.finish()) == 1
    fresh = pushing(border="open")
    dirty = fresh.move_to((13.6, 20.0, 19.0)).dirty
    assert running.touched[0][0][1] >= dirty[0][1] - 1
