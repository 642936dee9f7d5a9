# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine: one stroke in real time. One thread feels, another deforms, and neither knows of Blender (DESIGN 4).

Three threads meet here. The caller's (Blender's main one) feeds poses and takes away what changed; it never waits. The
deformation thread walks a push through the poses in their order. The collision thread asks a thousand times a second
how hard the material is at the newest pose, and publishes the answer as a :class:`LocalModel`.

The last two work on the same voxels without a lock: the push's epoch tells when mass was in flight, and what was
estimated meanwhile is thrown away. The collision then asks for a turn, and the deformation gives it between two solves:
so it gets its answer also when solves follow each other without a gap.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from math import ceil, dist, hypot, isfinite
from threading import Condition, Event, Lock, Thread
from time import perf_counter

from .grid import Box, union
from .history import History
from .local_model import Feeler, LocalModel
from .plasticity import Regime
from .push import LONGEST_STEP, Contact, Push
from .stroke import Sample
from .symmetry import SymmetricPush
from .tool import Tool, vector

PERIOD = 1e-3
"""Seconds from one local model to the next."""
LONGEST_TURN = 1e-3
"""Seconds that the deformation waits, at most, for a collision that it has let in."""
SWITCH_INTERVAL = 5e-4
"""Seconds after which Python's threads take turns while an engine runs: with Python's own 5 ms a main thread that is
busy leaves 100 estimates a second of 10,000 (DESIGN 4)."""
TINY = 1e-12
"""Newtons that are no force."""


@dataclass(frozen=True)
class Health:
    """How an engine fares.

    ``estimates`` that were made; ``discarded``, how often mass in flight left the collision without an answer; ``rate``
    of local models in Hz, over the last second; ``solves``, and the ``longest_solve`` in seconds.
    """

    estimates: int
    discarded: int
    rate: float
    solves: int
    longest_solve: float


class Engine:
    """One stroke of a push: its two threads, what they are fed, and what they publish.

    Parameters
    ----------
    push
        Lifted at the start. As long as the engine runs nobody else moves it or writes into its grid; all may read.
    history
        What :meth:`cancel` restores; by default the push remembers from now on.

    Attributes
    ----------
    contact
        What the last solve met.
    model
        The newest :class:`LocalModel`; None before the first, and when no thread keeps it fresh any more.
    solved
        The samples as they were solved, at most half a voxel apart: a Stroke of them leads to the same voxels.
    trace
        For each of these (depth in voxels, sigma, sigma_f in newtons). Depth is the way along the sample's direction,
        or against the force where it has none, since the tool came into the material.
    mass_out
        What has left the grid, in voxels' worth.
    failure
        What a thread raised; :meth:`finish` raises it.

    The thread that made an engine starts, feeds, finishes and cancels it; any thread may read.
    """

    def __init__(self, push: Push | SymmetricPush, history: History | None = None) -> None:
        self.push = push
        self.history = push.remember() if history is None else history
        self.contact: Contact = push.contacts[0]
        self.model: LocalModel | None = None
        self.solved: list[Sample] = []
        self.trace: list[tuple[float, float, float]] = []
        self.mass_out = 0.0
        self.failure: BaseException | None = None
        self._stage = _Stage.NEW
        self._threads: list[Thread] = []
        # What the threads hand to each other is guarded by this condition. Nothing is called while it is held.
        self._news = Condition()
        self._pending: deque[_Pose] = deque()
        self._solving = False
        self._no_more = False
        self._changes: list[Box | None] = [None for _ in push.contacts]
        self._touched: list[Box | None] = [None for _ in push.contacts]
        self._stop = Event()
        self._turn = _Turn()
        self._newest: _Pose | None = None
        self._tool = push.tool  # that of the newest pose
        self._feeler = Feeler(push)
        self._published: deque[float] = deque(maxlen=ceil(2.0 / PERIOD))
        self._began = self._longest_solve = 0.0
        self._discarded = 0

    def start(self) -> None:
        """Start both threads."""
        if self._stage is not _Stage.NEW:
            raise RuntimeError("an engine runs one stroke: make another for the next")
        self.push.lift()
        self._stage, self._began = _Stage.RUNNING, perf_counter()
        switching.hurry()
        try:
            for name, work in (("deformation", self._deform), ("collision", self._collide)):
                self._threads.append(Thread(target=self._guarded, args=(work,), name=f"repousse {name}", daemon=True))
                self._threads[-1].start()
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
        """Hand over the next pose. Never waits; all poses are solved, in their order.

        Raises
        ------
        ValueError
            When the position is not finite or the radius under one voxel; the stroke goes on without that pose.
        RuntimeError
            When no stroke is running.
        """
        if not self.running:
            raise RuntimeError("no stroke is running: poses are fed between start and finish")
        if not all(isfinite(p) for p in sample.position):
            raise ValueError(f"a position is three finite numbers of voxels, not {sample.position}")
        if sample.radius is not None and sample.radius != self._tool.radius:
            self._tool = self._tool.scaled(sample.radius)
        pose = _Pose(sample, self._tool)
        with self._news:
            self._newest = pose
            self._pending.append(pose)
            self._news.notify_all()

    def settle(self, timeout: float) -> bool:
        """Wait until all that was fed is solved; False when ``timeout`` seconds are too few, or a thread failed."""
        with self._news:
            self._news.wait_for(lambda: self._settled or self.failure is not None, timeout)
            return self._settled and self.failure is None

    @property
    def _settled(self) -> bool:
        return not self._pending and not self._solving

    def take_changes(self) -> list[Box] | None:
        """Boxes around all voxels that have changed since this was last asked: at most one for each tool, half-open, in
        the frame of the poses. None when nothing has."""
        with self._news:
            changes, self._changes = self._changes, [None for _ in self._changes]
        return [box for box in changes if box is not None] or None

    @property
    def touched(self) -> list[Box]:
        """Boxes around all voxels that the stroke has changed: at most one for each tool, in the frame of the poses."""
        with self._news:
            return [box for box in self._touched if box is not None]

    @property
    def health(self) -> Health:
        """How the engine fares now."""
        now = perf_counter()
        recent = sum(time > now - 1.0 for time in tuple(self._published))
        rate = recent / min(1.0, max(PERIOD, now - self._began))
        return Health(self._feeler.estimates, self._discarded, rate, len(self.solved), self._longest_solve)

    def finish(self) -> list[Sample]:
        """Solve what is pending, end both threads, and return the samples as they were solved.

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
        """Drop what is pending, end both threads, and make the grid what it was when the history began, bit for bit.

        What that changes back is among the changes. A stroke that is finished stays as it is.
        """
        if self._stage is _Stage.OVER:
            return
        with self._news:
            self._stop.set()
            self._pending.clear()
        self._end_threads()
        changed_back = self.history.touched
        self.push.restore(self.history)
        self._stage = _Stage.OVER
        self.solved, self.trace, self.mass_out = [], [], 0.0
        self._touched = [None for _ in self._touched]
        self._changes = [None for _ in self._changes]
        self._changes[0] = _shifted(changed_back, self.push.origin)

    def _end_threads(self) -> None:
        with self._news:
            self._no_more = True
            self._news.notify_all()
        for thread in self._threads:  # the deformation first: it is felt to its end
            if thread.ident is not None:
                thread.join()
            self._stop.set()
        if self._threads:
            self._threads.clear()
            switching.relax()
        self._solving = False
        self.model = None

    def _guarded(self, work: Callable[[], None]) -> None:
        """Run one thread's work; when it fails, the other ends as well."""
        try:
            work()
        except BaseException as error:
            with self._news:
                self.failure = self.failure or error
                self._stop.set()
                self._news.notify_all()

    def _deform(self) -> None:
        """The deformation thread."""
        former: _Pose | None = None
        while (pose := self._next_pose()) is not None:
            with self._turn.at_work():
                for sample in _way(former, pose):
                    if self._stop.is_set():
                        return
                    self._solve(sample)
                    self._turn.give(LONGEST_TURN)
            former = pose

    def _next_pose(self) -> _Pose | None:
        """Wait for a pose; None when there will be no more."""
        with self._news:
            self._solving = False
            self._news.notify_all()
            self._news.wait_for(lambda: self._pending or self._no_more)
            self._solving = bool(self._pending)
            return self._pending.popleft() if self._pending else None

    def _solve(self, sample: Sample) -> None:
        began = perf_counter()
        contact = self.push.walk(sample)
        self._longest_solve = max(self._longest_solve, perf_counter() - began)
        depth, dirty = self._depth(sample, contact), [met.dirty for met in self.push.contacts]
        with self._news:
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
        start = self.solved[-1].position
        if dist(start, sample.position) > 2.0 * LONGEST_STEP:  # a jump: the tool was lifted
            return 0.0
        along = sample.direction or vector(-contact.force / max(hypot(*contact.force), TINY))
        way = zip(start, sample.position, along, strict=True)
        return self.trace[-1][0] + sum((b - a) * u for a, b, u in way)

    def _collide(self) -> None:
        """The collision thread."""
        due = perf_counter()
        while not self._stop.wait(max(0.0, due - perf_counter())):
            due = max(due + PERIOD, perf_counter())
            pose = self._newest
            if pose is None or self._publish(pose):
                continue
            with self._turn.taken():
                self._publish(pose)

    def _publish(self, pose: _Pose) -> bool:
        """Publish the local model of a pose; not when mass was in flight."""
        model = self._feeler.feel(pose.sample.position, pose.tool)
        if model is None:
            self._discarded += 1
            return False
        self.model = model
        self._published.append(model.time)
        return True


class _Stage(Enum):
    NEW, RUNNING, OVER = range(3)


@dataclass(frozen=True)
class _Pose:
    """A sample, and the tool as it is there."""

    sample: Sample
    tool: Tool


def _way(former: _Pose | None, pose: _Pose) -> list[Sample]:
    """The samples to solve on the way to a pose, at most half a voxel apart; a jump that lifts the tool is one."""
    end = pose.sample
    if former is None:
        return [end]
    start = former.sample
    length = dist(start.position, end.position)
    if length > 2.0 * pose.tool.radius:
        return [end]
    steps = max(1, ceil(length / LONGEST_STEP - 1e-9))  # half a voxel is one step, however it rounds
    return [_between(start, end, step / steps) for step in range(1, steps)] + [end]


def _between(start: Sample, end: Sample, part: float) -> Sample:
    position = vector(a + (b - a) * part for a, b in zip(start.position, end.position, strict=True))
    return replace(end, time=start.time + (end.time - start.time) * part, position=position)


def _shifted(box: Box | None, origin: tuple[int, int, int]) -> Box | None:
    if box is None:
        return None
    (x, y, z), ((i0, j0, k0), (i1, j1, k1)) = origin, box
    return (i0 + x, j0 + y, k0 + z), (i1 + x, j1 + y, k1 + z)


class _Turn:
    """A turn that one thread asks for, and another gives: between two of its steps, or at once while it rests."""

    def __init__(self) -> None:
        self._told = Condition()
        self._asked = self._given = False
        self._resting = True

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """What the giver does its steps in; outside of this it rests."""
        self._resting = False
        try:
            yield
        finally:
            with self._told:
                self._resting = True
                self._told.notify_all()

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Ask, wait until the other lets in, and make it wait until this is left."""
        with self._told:
            self._asked, self._given = True, False
            self._told.wait_for(lambda: self._given or self._resting)
        try:
            yield
        finally:
            with self._told:
                self._asked = self._given = False
                self._told.notify_all()

    def give(self, patience: float) -> None:
        """Let in who asks, and wait at most ``patience`` seconds until that is over; go on at once when nobody does."""
        if not self._asked:  # without the lock: who asks just now is let in after the next step
            return
        with self._told:
            self._given = True
            self._told.notify_all()
            self._told.wait_for(lambda: not self._asked, patience)
            self._asked = False  # who takes longer takes a chance: the next step does not wait as well


class _Switching:
    """Python's interval of switching threads, short as long as any engine runs."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._engines = 0
        self._former = 0.0

    def hurry(self) -> None:
        """One engine more."""
        with self._lock:
            if self._engines == 0:
                self._former = sys.getswitchinterval()
                sys.setswitchinterval(min(SWITCH_INTERVAL, self._former))
            self._engines += 1

    def relax(self) -> None:
        """One engine less; after the last one it is as it was before the first."""
        with self._lock:
            self._engines -= 1
            if self._engines == 0:
                sys.setswitchinterval(self._former)


switching = _Switching()
