# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine: one stroke in real time. One thread feels, another deforms, and neither knows of Blender (DESIGN 4).

Three threads meet here. The caller's (Blender's main one) feeds poses and takes away what changed; it never waits. The
deformation thread walks a push through the poses in their order. The collision thread asks a thousand times a second
how hard the material is at the newest pose, and publishes the answer as a :class:`LocalModel`.

With a :class:`Hand` the poses are its own: the collision thread asks it for the newest and tells it what is felt there,
and the deformation follows it, half a voxel at a time, wherever it has got to by then.

The last two work on the same voxels without a lock: the push's epoch tells when mass was in flight, and what was
estimated meanwhile is thrown away. The collision then asks for a turn, and the deformation gives it between two solves:
so it gets its answer also when solves follow each other without a gap.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from math import ceil, dist, hypot
from threading import Event, Lock, Thread
from time import perf_counter

from . import switching
from .grid import Box, union
from .hand import Hand
from .history import History
from .local_model import Feeler, LocalModel
from .plasticity import Regime
from .poses import Pose, Poses, way
from .push import Contact, Push
from .quality import Auto, Choice, Quality, quality_named
from .stroke import Sample
from .symmetry import SymmetricPush
from .tool import vector
from .turn import Turn

PERIOD = 1e-3
"""Seconds from one local model to the next."""
LONGEST_TURN = 1e-3
"""Seconds that the deformation waits, at most, for a collision that it has let in."""
TINY = 1e-12
"""Newtons that are no force."""


@dataclass(frozen=True)
class Health:
    """How an engine fares.

    ``estimates`` that were made; ``discarded``, how often mass in flight left the collision without an answer; ``rate``
    of local models in Hz, over the last second; ``solves``, and the ``longest_solve`` in seconds; ``refused``, how many
    poses of a hand were no poses.
    """

    estimates: int
    discarded: int
    rate: float
    solves: int
    longest_solve: float
    refused: int


class Engine:
    """One stroke of a push: its two threads, what they are fed, and what they publish.

    Parameters
    ----------
    push
        Lifted at the start. As long as the engine runs nobody else moves it or writes into its grid; all may read.
    history
        What :meth:`cancel` restores; by default the push remembers from now on.
    hand
        Whose poses these are, and who is told what is felt; without one they are fed.
    quality
        The name of one, or an :class:`Auto` that chooses one for each solve; the samples as they were solved have it.
    deform
        False: feel only. There is no deformation thread and no history, the push is not moved, no voxel changes.

    Attributes
    ----------
    contact
        What the last solve met.
    model
        The newest :class:`LocalModel`; None before the first, and when no thread keeps it fresh any more.
    solved
        The samples as they were solved, at most half a voxel apart (draft: a whole one): a Stroke of them leads to the
        same voxels, whatever was chosen by the clock.
    trace
        For each of these (depth in voxels, sigma, sigma_f in newtons). Depth is the way along the sample's direction,
        or against the force where it has none, since the tool came into the material.
    mass_out
        What has left the grid, in voxels' worth.
    choice
        What an Auto has chosen last, and why; None without one.
    failure
        What a thread raised; :meth:`finish` raises it.

    The thread that made an engine starts, feeds, finishes and cancels it; any thread may read.
    """

    def __init__(
        self,
        push: Push | SymmetricPush,
        history: History | None = None,
        hand: Hand | None = None,
        deform: bool = True,
        quality: str | Auto = "exact",
    ) -> None:
        self.push, self.hand, self.deform = push, hand, deform
        self._auto = quality if isinstance(quality, Auto) else None
        self._quality = quality_named("exact" if isinstance(quality, Auto) else quality)
        self.choice: Choice | None = None
        if deform and history is None:
            history = push.remember()
        self.history = history if deform else None
        self.contact: Contact = push.contacts[0]
        self.model: LocalModel | None = None
        self.solved: list[Sample] = []
        self.trace: list[tuple[float, float, float]] = []
        self.mass_out = 0.0
        self.failure: BaseException | None = None
        self._stage = _Stage.NEW
        self._threads: dict[str, Thread] = {}
        self._changes: list[Box | None] = [None for _ in push.contacts]
        self._touched: list[Box | None] = [None for _ in push.contacts]
        self._results = Lock()  # guards what a solve has led to
        self._poses = Poses(push.tool, coalesced=hand is not None)
        self._stop = Event()
        self._turn = Turn()
        self._feeler = Feeler(push, turning=hand is not None)
        self._published: deque[float] = deque(maxlen=ceil(2.0 / PERIOD))
        self._began = self._longest_solve = 0.0
        self._discarded = self._refused = 0

    def start(self) -> None:
        """Start the threads."""
        if self._stage is not _Stage.NEW:
            raise RuntimeError("an engine runs one stroke: make another for the next")
        works = {"collision": self._collide}
        if self.deform:
            works = {"deformation": self._deform} | works
            self.push.lift()
        else:
            self._poses.close()
        self._stage, self._began = _Stage.RUNNING, perf_counter()
        switching.hurry()
        try:
            for name, work in works.items():
                thread = Thread(target=self._guarded, args=(work,), name=f"repousse {name}", daemon=True)
                self._threads[name] = thread
                thread.start()
        except BaseException:
            self.cancel()
            raise

    def __enter__(self) -> Engine:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.cancel()

    @property
    def running(self) -> bool:
        """Whether a stroke has begun and is neither finished nor cancelled."""
        return self._stage is _Stage.RUNNING

    def feed(self, sample: Sample) -> None:
        """Hand over the next pose. Never waits; all poses are solved, in their order. After :meth:`release`, and by an
        engine that only feels, it is felt alone.

        Raises
        ------
        ValueError
            When the position or the time is not finite or the radius under one voxel; the stroke goes on without that
            pose.
        RuntimeError
            When no stroke is running, or a hand gives the poses.
        """
        if not self.running:
            raise RuntimeError("no stroke is running: poses are fed between start and finish")
        if self.hand is not None:
            raise RuntimeError("the poses of this stroke are its hand's: none are fed")
        self._poses.put(sample)

    def release(self) -> None:
        """Let no more poses deform; never waits. What was fed, or the hand's newest pose, will be solved yet, and
        :meth:`settle` tells when it is. What is felt is felt until the end."""
        self._poses.close()

    def settle(self, timeout: float) -> bool:
        """Wait until all that was fed is solved; False when ``timeout`` seconds are too few, or a thread failed."""
        return self._poses.settle(timeout)

    def take_changes(self) -> list[Box] | None:
        """Boxes around all voxels that have changed since this was last asked: at most one for each tool, half-open, in
        the frame of the poses. None when nothing has."""
        with self._results:
            changes, self._changes = self._changes, [None for _ in self._changes]
        return [box for box in changes if box is not None] or None

    @property
    def touched(self) -> list[Box]:
        """Boxes around all voxels that the stroke has changed: at most one for each tool, in the frame of the poses."""
        with self._results:
            return [box for box in self._touched if box is not None]

    @property
    def health(self) -> Health:
        """How the engine fares now."""
        now = perf_counter()
        recent = sum(time > now - 1.0 for time in tuple(self._published))
        rate = recent / min(1.0, max(PERIOD, now - self._began))
        solves, longest_solve = len(self.solved), self._longest_solve
        return Health(self._feeler.estimates, self._discarded, rate, solves, longest_solve, self._refused)

    def finish(self) -> list[Sample]:
        """Release, solve what is pending, end the threads, and return the samples as they were solved.

        Raises what a thread raised; the grid is then as that left it, until it is cancelled. A cancelled stroke has no
        samples.
        """
        if self.running:
            self._end_threads()
            if self.failure is not None:
                raise self.failure
            self._stage = _Stage.OVER
        return self.solved

    def cancel(self) -> None:
        """Drop what is pending, end the threads, and make the grid what it was when the history began, bit for bit.

        What that changes back is among the changes. A stroke that is finished stays as it is.
        """
        if self._stage is _Stage.OVER:
            return
        self._stop.set()
        self._poses.drop()
        self._end_threads()
        self._stage = _Stage.OVER
        self.solved, self.trace, self.mass_out = [], [], 0.0
        self._touched = [None for _ in self._touched]
        self._changes = [None for _ in self._changes]
        if self.history is not None:
            changed_back = self.history.touched
            self.push.restore(self.history)
            self._changes[0] = _shifted(changed_back, self.push.origin)

    def _end_threads(self) -> None:
        self._poses.close()
        for name, thread in self._threads.items():
            if name == "collision":
                self._stop.set()  # not before: the deformation is felt to its end
            if thread.ident is not None:
                thread.join()
        if self._threads:
            self._threads.clear()
            switching.relax()
        self.model = None

    def _guarded(self, work: Callable[[], None]) -> None:
        """Run one thread's work; when it fails, the other ends as well."""
        try:
            work()
        except BaseException as error:
            with self._results:
                self.failure = self.failure or error
            self._stop.set()
            self._poses.drop()

    def _deform(self) -> None:
        """The deformation thread."""
        while (pose := self._poses.take()) is not None:
            with self._turn.at_work():
                for sample in self._steps_to(pose):
                    if self._stop.is_set():
                        return
                    self._solve(sample)
                    self._turn.give(LONGEST_TURN)
                    if self.hand is not None and self._poses.any_wait:
                        break  # by now the hand is elsewhere: straight there

    def _steps_to(self, pose: Pose) -> Iterator[Sample]:
        """The samples to solve on the way to a pose, each with its quality."""
        longest = 0.0
        sample: Sample | None = None
        steps: Iterator[Sample] = iter(())
        while sample is not pose.sample:
            last = self.solved[-1] if self.solved else None
            quality = self._quality_on_way(last, pose)
            if quality.longest_step != longest:
                longest, steps = quality.longest_step, way(last, pose, quality.longest_step)
            sample = next(steps)
            yield sample if sample.quality == quality.name else replace(sample, quality=quality.name)

    def _quality_on_way(self, last: Sample | None, pose: Pose) -> Quality:
        if self._auto is None:
            return self._quality
        ahead = self._poses.beyond(pose)
        if last is not None and not pose.jump:
            ahead += dist(last.position, pose.sample.position)
        self.choice = self._auto.choose(self.push.flow, pose.tool.radius, ahead)
        return self.choice.quality

    def _solve(self, sample: Sample) -> None:
        clock, flow = (self._auto.clock if self._auto else perf_counter), self.push.flow
        began = clock()
        contact = self.push.walk(sample)
        seconds = clock() - began
        self._longest_solve = max(self._longest_solve, seconds)
        if self._auto is not None and contact.sweeps:  # what moves nothing tells nothing
            self._auto.learn(quality_named(sample.quality), flow, seconds)
        depth, dirty = self._depth(sample, contact), [met.dirty for met in self.push.contacts]
        with self._results:
            self.contact = contact
            self.mass_out += contact.mass_out
            self.solved.append(sample)
            self.trace.append((depth, contact.stress, contact.yield_stress))
            self._changes = [union(box, new) for box, new in zip(self._changes, dirty, strict=True)]
            self._touched = [union(box, new) for box, new in zip(self._touched, dirty, strict=True)]

    def _depth(self, sample: Sample, contact: Contact) -> float:
        """How far along the push a sample is, from where the tool came into the material."""
        if Regime.NONE in (self.contact.regime, contact.regime) or not self.solved:
            return 0.0
        start, longest = self.solved[-1].position, quality_named(sample.quality).longest_step
        if dist(start, sample.position) > 2.0 * longest:  # a jump: the tool was lifted
            return 0.0
        along = sample.direction or vector(-contact.force / max(hypot(*contact.force), TINY))
        way = zip(start, sample.position, along, strict=True)
        return self.trace[-1][0] + sum((b - a) * u for a, b, u in way)

    def _collide(self) -> None:
        """The collision thread."""
        due = perf_counter()
        while not self._stop.wait(max(0.0, due - perf_counter())):
            due = max(due + PERIOD, perf_counter())
            if self.hand is None:
                if self._poses.newest is not None:
                    self._feel(self._poses.newest)
            elif (pose := self._pose_of(self.hand)) is not None and (model := self._feel(pose)) is not None:
                self.hand.feel(model)

    def _pose_of(self, hand: Hand) -> Pose | None:
        """The hand's newest pose, on its way to the deformation; None without one that is fit to be felt."""
        sample = hand.sample()
        if sample is None:
            return None
        try:
            self._poses.put(sample)
        except ValueError:
            # One wrong reading does not cost the artist a stroke. But nothing is felt at a pose that is not known: if
            # more of them follow, the model ages and the force fades.
            self._refused += 1
            return None
        return self._poses.newest

    def _feel(self, pose: Pose) -> LocalModel | None:
        """Publish the local model of a pose, in a turn of its own if need be; None when even that was too short."""
        if (model := self._publish(pose)) is None:
            with self._turn.taken():
                model = self._publish(pose)
        return model

    def _publish(self, pose: Pose) -> LocalModel | None:
        """Publish the local model of a pose, and return it; not when mass was in flight."""
        model = self._feeler.feel(pose.sample.position, pose.tool)
        if model is None:
            self._discarded += 1
            return None
        self.model = model
        self._published.append(model.time)
        return model


class _Stage(Enum):
    NEW, RUNNING, OVER = range(3)


def _shifted(box: Box | None, origin: tuple[int, int, int]) -> Box | None:
    if box is None:
        return None
    (x, y, z), ((i0, j0, k0), (i1, j1, k1)) = origin, box
    return (i0 + x, j0 + y, k0 + z), (i1 + x, j1 + y, k1 + z)
