# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand that holds the tool: where it goes is solved, what it feels is what is there, and it never waits.

Hands here are scripts that count calls, not time.
"""

import dataclasses
import threading
import tracemalloc
from contextlib import contextmanager, nullcontext
from itertools import pairwise
from math import dist, inf, nan

import numpy as np
import pytest

from repousse.core import Engine, Material, Push, Regime, Sample, SphereTool, dispersion
from repousse.core.local_model import NONE
from repousse.core.poses import LEAST_MOVE, Poses
from repousse.core.quality import LONGEST_STEP

from .test_engine import INTO, ON, TOOL, WAYS, pushing, state_of, stroke_of
from .threads import PATIENCE, Gate, names, until
from .volumes import half_space, line

pytestmark = pytest.mark.usefixtures("nothing_left")


class Held:
    """A hand that stays where it was last told to be, and remembers what it felt."""

    def __init__(self, *place):
        self.felt, self.calls, self._time, self._sample = [], 0, 0.0, None
        if place:
            self.go(place)

    def go(self, place, **how):
        """Be there from now on."""
        self.give(Sample(self._time, tuple(map(float, place)), **how))
        self._time += 0.01

    def give(self, sample):
        self._sample = sample

    def sample(self):
        self.calls += 1
        return self._sample

    def feel(self, model):
        self.felt.append(model)

    def feels(self, place):
        """Wait until it has felt what is at a place."""
        until(lambda: self.felt and self.felt[-1].position == place)

    def asked(self, times=2):
        """Wait until it has been asked since: all but the last answer have been seen to."""
        wanted = self.calls + times
        until(lambda: self.calls >= wanted)


class Player(Held):
    """A hand that gives one sample after the other, one each time it is asked, and then stays."""

    def __init__(self, samples):
        super().__init__()
        self._rest = list(samples)

    def sample(self):
        if self._rest:
            self.give(self._rest.pop(0))
        return super().sample()

    @property
    def done(self):
        return not self._rest


def there(running, place):
    """Wait until the deformation has got to a place."""
    until(lambda: running.solved and running.solved[-1].position == tuple(map(float, place)))


@contextmanager
def held_at(monkeypatch, running, hand, place):
    """Hold the solve of a place in mid flight; the collision tries on meanwhile, instead of waiting for its turn."""
    gate = Gate()
    monkeypatch.setattr(running._turn, "taken", nullcontext)
    monkeypatch.setattr(dispersion, "sweep", gate.before(dispersion.sweep))
    hand.go(place)
    assert gate.reached.wait(PATIENCE)
    yield
    gate.open()


# What is felt.


def test_a_hand_at_rest_feels_its_contact(kernels):
    hand = Held()
    with Engine(pushing(), hand=hand) as running:
        for place in INTO:
            hand.go(place)
            there(running, place)
        until(lambda: hand.felt and hand.felt[-1].epoch == running.push.epoch and hand.felt[-1].position == INTO[-1])
        assert running.contact.regime is Regime.PLASTIC
        assert hand.felt[-1].stress == pytest.approx(running.contact.stress, rel=1e-5)
        assert hand.felt[-1].yield_stress == pytest.approx(running.contact.yield_stress, rel=1e-5)
        assert hand.felt[-1].turning != NONE  # an arm's loop turns the force with the tip; a mouse has none to turn
        known = len(hand.felt)
        until(lambda: len(hand.felt) > known + 20)  # and goes on to feel it
        times = [model.time for model in hand.felt]
        assert times == sorted(set(times))


def test_what_is_felt_is_published_too():
    hand = Held(*INTO[0])
    with Engine(pushing(), hand=hand) as running:
        until(lambda: hand.felt)
        assert running.model.position == INTO[0]
        running.finish()
        assert running.model is None


def test_who_feels_slowly_holds_nobody_up(monkeypatch):
    """No lock is held, nor a turn, while a hand feels: what it gave is solved, and what changed is taken."""
    hand, gate = Held(*INTO[-1]), Gate()
    monkeypatch.setattr(hand, "feel", gate.before(hand.feel))
    with Engine(pushing(), hand=hand) as running:
        assert gate.reached.wait(PATIENCE)
        assert running.settle(PATIENCE)
        assert [sample.position for sample in running.solved] == [INTO[-1]]
        assert running.take_changes() and running.touched and running.health.solves == 1
        gate.open()


def test_without_a_pose_nothing_is_felt():
    """The last local model ages, and the stroke goes on when there is a pose again."""
    hand = Held(*INTO[0])
    with Engine(pushing(), hand=hand) as running:
        until(lambda: hand.felt)
        hand.give(None)
        hand.asked()
        known, time = len(hand.felt), running.model.time
        hand.asked(20)
        assert (len(hand.felt), running.model.time, running.health.refused) == (known, time, 0)
        hand.give(Sample(1.0, INTO[1]))
        there(running, INTO[1])
        hand.feels(INTO[1])


BAD = {
    "nan": Sample(0.0, (nan, 19.0, 19.0)),
    "infinite": Sample(0.0, (14.1, inf, 19.0)),
    "time": Sample(nan, ON),
    "radius": Sample(0.0, ON, radius=0.5),
    "no radius": Sample(0.0, ON, radius=nan),
}


@pytest.mark.parametrize("bad", BAD)
def test_a_bad_pose_is_none(bad):
    """It is neither felt nor solved, it is counted, and it costs no stroke."""
    hand, push = Held(), pushing()
    with Engine(push, hand=hand) as running:
        for place in INTO:
            hand.give(BAD[bad])
            hand.asked()
            known, refused = len(hand.felt), running.health.refused
            hand.asked(3)
            assert len(hand.felt) == known and running.health.refused >= refused + 2
            hand.go(place)
            there(running, place)
        running.finish()
    assert {model.position for model in hand.felt} <= set(INTO)
    replayed = pushing()
    for place in INTO:
        replayed.move_to(place)
    assert state_of(push) == state_of(replayed)


@pytest.mark.parametrize("method", ["sample", "feel"])
def test_a_hand_that_fails_ends_the_stroke(monkeypatch, method):
    push, calls = pushing(), []
    before = state_of(push)
    hand = Held(*ON)
    real = getattr(hand, method)

    def fails(*args):
        calls.append(args)
        if len(calls) == 5:
            raise OSError("the arm is gone")
        return real(*args)

    monkeypatch.setattr(hand, method, fails)
    running = Engine(push, hand=hand)
    running.start()
    until(lambda: running.failure)
    assert not running.settle(PATIENCE)
    with pytest.raises(OSError, match="the arm is gone"):
        running.finish()
    running.cancel()
    assert state_of(push) == before and len(calls) == 5


# What is solved.


def test_a_waiting_pose_gives_way_to_the_newest(monkeypatch):
    """While a solve is held the hand wanders; then the tool goes straight to where the hand is, in half voxels."""
    hand = Held(*INTO[0])
    wander = [(ON[0], y, 19.0) for y in (20.0, 23.0, 21.5, 16.0, 15.0)]
    with Engine(pushing(), hand=hand) as running:
        there(running, INTO[0])
        hand.go(INTO[-1])
        there(running, INTO[-1])
        with held_at(monkeypatch, running, hand, ON):
            for place in wander:
                hand.go(place)
                hand.asked()
            start = len(running.solved)
        there(running, wander[-1])
        after = running.finish()[start:]
    places = [sample.position for sample in after]
    assert places[0] == ON and after[-1].time == hand.sample().time
    assert [place[1] for place in places[1:]] == pytest.approx(np.linspace(19.0, 15.0, 9)[1:])
    assert {(x, z) for x, _, z in places[1:]} == {(ON[0], 19.0)}
    times = [sample.time for sample in after]
    assert np.diff(times[1:]) == pytest.approx(np.full(7, (times[-1] - times[0]) / 8))


def test_the_tool_turns_where_the_hand_has_turned(monkeypatch):
    """On a long way it does not go first to where the hand is no more."""
    hand, push = Held(14.1, 12.0, 19.0), pushing()
    with Engine(push, hand=hand) as running:
        there(running, (14.1, 12.0, 19.0))
        monkeypatch.setattr(running._turn, "taken", nullcontext)
        gate = Gate(4)
        monkeypatch.setattr(push, "walk", gate.before(push.walk))
        hand.go((14.1, 20.0, 19.0))
        assert gate.reached.wait(PATIENCE)
        hand.go((14.1, 13.5, 22.0))
        hand.asked()
        gate.open()
        there(running, (14.1, 13.5, 22.0))
        solved = [sample.position for sample in running.finish()]
    assert max(y for _, y, _ in solved) == 14.0
    assert max(map(dist, solved, solved[1:])) <= LONGEST_STEP + 1e-9
    assert [y for _, y, z in solved if z == 19.0] == [12.0, 12.5, 13.0, 13.5, 14.0]


def test_a_hand_that_trembles_is_at_rest():
    """Less than a 32nd of a voxel from the last solve is felt and not solved; a slow drift adds up."""
    hand, (x, y, z) = Held(), INTO[-1]
    with Engine(pushing(), hand=hand) as running:
        hand.go((x, y, z))
        there(running, (x, y, z))
        for part in (0.99, -0.7, 0.5, -0.99):
            near = (x, y + part * LEAST_MOVE, z)
            hand.go(near)
            hand.feels(near)
            assert running.settle(PATIENCE) and len(running.solved) == 1
        for n in range(1, 5):
            hand.go((x, y + 0.5 * n * LEAST_MOVE, z))
            hand.asked()
        there(running, (x, y + 2.0 * LEAST_MOVE, z))
        assert [sample.position[1] for sample in running.finish()] == [y, y + LEAST_MOVE, y + 2.0 * LEAST_MOVE]


@pytest.mark.parametrize("change", [{"radius": 4.0}, {"strength": 0.5}])
def test_a_tool_that_changes_is_solved_without_a_move(change):
    hand = Held(*INTO[-1])
    with Engine(pushing(), hand=hand) as running:
        there(running, INTO[-1])
        hand.go(INTO[-1], **change)
        until(lambda: len(running.solved) == 2)
        assert dataclasses.replace(running.solved[1], time=0.0) == Sample(0.0, INTO[-1], **change)


def test_the_last_pose_is_solved_and_no_more_are():
    """However little it moved; after the release the hand is felt where it goes, and nothing gives way there."""
    hand, (x, y, z), push = Held(*INTO[-1]), INTO[-1], pushing()
    last, beyond = (x + 0.5 * LEAST_MOVE, y, z), (x + 3.0, y, z)
    with Engine(push, hand=hand) as running:
        there(running, INTO[-1])
        hand.go(last)
        hand.feels(last)
        running.release()
        assert running.settle(PATIENCE)
        hand.go(beyond)
        hand.feels(beyond)
        assert hand.felt[-1].stress > 1.5 * hand.felt[-1].yield_stress
        assert [sample.position for sample in running.finish()] == [INTO[-1], last]
    replayed = pushing()
    replayed.move_to(INTO[-1])
    replayed.move_to(last)
    assert state_of(push) == state_of(replayed)


def test_a_pose_that_is_solved_is_not_solved_again():
    """Not when it is given once more, nor when it is the last."""
    hand = Held(*INTO[-1])
    with Engine(pushing(), hand=hand) as running:
        there(running, INTO[-1])
        hand.go(INTO[-1])
        hand.asked()
        assert len(running.finish()) == 1


def test_finish_solves_the_last_pose(monkeypatch):
    """Also when it waits behind a solve that takes its time."""
    hand, far = Held(*INTO[-1]), (ON[0], 15.0, 19.0)
    with Engine(pushing(), hand=hand) as running:
        there(running, INTO[-1])
        with held_at(monkeypatch, running, hand, ON):
            hand.go(far)
            hand.asked()
            finishing = threading.Thread(target=running.finish)
            finishing.start()
            until(lambda: running._poses._closed)
        finishing.join()
        assert running.solved[-1].position == far


def test_a_cancelled_way_is_not_walked_to_its_end(monkeypatch):
    hand, push, walks = Held(*INTO[-1]), pushing(), Gate(4)
    before = state_of(push)
    with Engine(push, hand=hand) as running:
        there(running, INTO[-1])
        monkeypatch.setattr(push, "walk", walks.before(push.walk))
        hand.go((INTO[-1][0], 14.0, 19.0))
        assert walks.reached.wait(PATIENCE)
        cancelling = threading.Thread(target=running.cancel)
        cancelling.start()
        until(running._stop.is_set)
        walks.open()
        cancelling.join()
    assert walks.calls == 4 and state_of(push) == before


def test_dropped_poses_are_not_taken():
    poses = Poses(TOOL, coalesced=False)
    for place in INTO:
        poses.put(Sample(0.0, place))
    assert poses.take().sample.position == INTO[0]
    poses.drop()
    assert poses.take() is None and not poses.settle(PATIENCE)


SHEET = (slice(19, 21), slice(None), slice(None))
BEFORE_SHEET = (8.0, 19.0, 19.0)


def before_a_sheet(hand):
    """An engine before a sheet two voxels thick, and its grid."""
    grid = half_space(40, 0.0)
    grid.density[SHEET] = 0.5
    return Engine(Push(grid, SphereTool(3), Material(3.3, 0.1), border="wall"), hand=hand), grid


@pytest.mark.parametrize("jumps", [False, True])
def test_a_sheet_is_jumped_only_by_a_hand_that_jumps(monkeypatch, jumps):
    """A hand that goes through it while a solve is held is followed through it, though it is more than the tool's
    diameter ahead by then. One that was lifted, or whose frame has changed, is met where it sets down."""
    hand = Held(*BEFORE_SHEET)
    running, grid = before_a_sheet(hand)
    with running:
        there(running, BEFORE_SHEET)
        monkeypatch.setattr(running._turn, "taken", nullcontext)
        before, gate = grid.density.copy(), Gate()
        monkeypatch.setattr(running.push, "walk", gate.before(running.push.walk))
        hand.go((8.5, 19.0, 19.0))
        assert gate.reached.wait(PATIENCE)
        for x in (30.0, 30.3) if jumps else np.arange(9.0, 30.4, 1.3):
            hand.go((x, 19.0, 19.0))
            hand.asked()
        gate.open()
        end = hand.sample().position
        there(running, end)
        solved = [sample.position for sample in running.finish()]
    steps = [dist(a, b) for a, b in pairwise(solved)]
    assert (grid.density != before).any() == (not jumps)
    assert (max(steps) > 6.0) == jumps and sorted(steps)[-2] <= LONGEST_STEP + 1e-9


@pytest.mark.parametrize("way", WAYS)
def test_what_a_hand_sculpts_is_replayed(way):
    """What was solved, walked through a fresh push, leads to the same voxels bit for bit, mirrored tools and all."""
    grid, stroke = stroke_of(way)
    before, push, hand = grid.density.tobytes(), stroke.push(grid), Player(stroke.samples)
    with Engine(push, hand=hand) as running:
        until(lambda: hand.done)
        hand.asked()
        solved = running.finish()
    assert solved[-1] == stroke.samples[-1] and len(running.touched) == len(push.contacts)
    assert grid.density.tobytes() != before
    replayed = stroke.push(stroke_of(way)[0])
    replayed.follow(dataclasses.replace(stroke, samples=solved))
    assert state_of(replayed) == state_of(push)
    assert {model.position for model in hand.felt} <= {sample.position for sample in stroke.samples}
    times = [sample.time for sample in solved]
    assert times == sorted(set(times))


def test_poses_are_fed_or_a_hands():
    with Engine(pushing(), hand=Held(*INTO[0])) as running, pytest.raises(RuntimeError, match="hand's"):
        running.feed(Sample(0.0, ON))


def test_what_is_fed_after_the_release_is_felt_alone():
    with Engine(pushing()) as running:
        running.feed(Sample(0.0, INTO[-1]))
        running.release()
        running.feed(Sample(0.1, ON))
        until(lambda: running.model and running.model.position == ON)
        assert [sample.position for sample in running.finish()] == [INTO[-1]]


def test_solves_without_a_gap_are_felt(monkeypatch):
    """While each solve lasts until the collision has been turned away, the hand feels what each has led to."""
    push = pushing()
    hand = Player([Sample(0.01 * n, place) for n, place in enumerate(line(INTO[0], (18.1, 19.0, 19.0), 0.5))])
    running, sweep, walk, led_to = Engine(push, hand=hand), dispersion.sweep, push.walk, []

    def long_sweep(work):
        until(lambda: running._turn._asked)
        return sweep(work)

    def walk_and_tell(sample):
        contact = walk(sample)
        if contact.sweeps:
            led_to.append(push.epoch)
        return contact

    monkeypatch.setattr(dispersion, "sweep", long_sweep)
    monkeypatch.setattr(push, "walk", walk_and_tell)
    monkeypatch.setattr("repousse.core.engine.LONGEST_TURN", PATIENCE)
    with running:
        until(lambda: hand.done)
        hand.asked()
        running.finish()
    assert len(led_to) > 10
    assert {model.epoch for model in hand.felt} >= set(led_to)


# Feel only.


def test_who_only_feels_changes_nothing():
    """No voxel, no push, no memory, and no thread but the collision's; the force is that of untouched material."""
    hand, push = Held(), pushing()
    push.move_to(INTO[2])
    before, contact, position = state_of(push), push.contacts[0], push.position
    tracemalloc.start()
    try:
        with Engine(push, hand=hand, deform=False) as running:
            assert names() == ["repousse collision"]
            for place in (*INTO, ON):
                hand.go(place)
                hand.feels(place)
            assert running.history is None and running.settle(0.0)
            assert running.finish() == running.trace == running.touched == [] and running.take_changes() is None
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < push.grid.density.nbytes
    assert state_of(push) == before and push.contacts[0] is contact and push.position == position
    deep = [model for model in hand.felt if model.position == ON][-1]
    assert deep.stress > deep.yield_stress > 0.0  # it would have yielded


def test_who_only_feels_may_be_fed():
    with Engine(pushing(), deform=False) as running:
        for place in (*INTO, ON):
            running.feed(Sample(0.0, place))
        until(lambda: running.model and running.model.position == ON)
        assert running.settle(0.0)
        running.cancel()
    assert running.history is None


def test_who_only_feels_restores_nothing():
    """A history that is somebody else's stays theirs."""
    push = pushing()
    history = push.remember()
    push.move_to(ON)
    after = state_of(push)
    with Engine(push, history, deform=False) as running:
        running.cancel()
    assert state_of(push) == after and history.bricks > 0
