# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses: those that wait to be solved, from whoever moves the tool to the thread that deforms."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil, dist, inf, isfinite
from threading import Condition

from .quality import LONGEST_STEP
from .stroke import Sample
from .tool import Tool, vector

LEAST_MOVE = 1.0 / 32.0
"""Voxels that a hand moves before its pose is solved. Hands tremble and encoders step, so an arm is never at rest:
without this each millisecond would make a solve and a line of the stroke, and a tool that is held still would creep.
Nothing that is felt waits for it, and a sixteenth of a solve's longest step is not seen: the stress of a tool of 16
voxels and 3.3 N changes by 5 mN on that way."""


@dataclass(frozen=True)
class Pose:
    """A sample, the tool as it is there, and whether the tool was lifted and set down there: a jump is no way."""

    sample: Sample
    tool: Tool
    jump: bool = False


class Poses:
    """A line of poses that wait, or, ``coalesced``, only the newest of them.

    Coalesced, a pose that waits is replaced by the next one, so that a slow solve builds no queue; and one that is
    nearer than :data:`LEAST_MOVE` to the last that waited does not wait, unless the tool itself has changed.

    Attributes
    ----------
    newest
        The last pose that was put in, whether it waits or not.
    """

    def __init__(self, tool: Tool, coalesced: bool) -> None:
        self.newest: Pose | None = None
        self._tool, self._coalesced = tool, coalesced
        self._news = Condition()
        self._waiting: deque[Pose] = deque()
        self._last: Sample | None = None  # that has waited
        self._solving = self._closed = self._dropped = False

    def put(self, sample: Sample) -> None:
        """The next pose; once this is closed it is the newest one, but does not wait.

        Raises ValueError when its position or time is not finite or its radius under one voxel; it is then as if it
        had not been.
        """
        if not all(isfinite(p) for p in sample.position):
            raise ValueError(f"a position is three finite numbers of voxels, not {sample.position}")
        if not isfinite(sample.time):
            raise ValueError(f"the time of a pose is a finite number of seconds, not {sample.time}")
        if sample.radius is not None and sample.radius != self._tool.radius:
            self._tool = self._tool.scaled(sample.radius)
        former, tool = self.newest, self._tool
        jump = former is not None and dist(former.sample.position, sample.position) > 2.0 * tool.radius
        with self._news:
            self.newest = Pose(sample, tool, jump)
            if not self._closed and (not self._coalesced or self._moved(sample) >= LEAST_MOVE):
                self._let_wait(self.newest)

    def _moved(self, sample: Sample) -> float:
        """Voxels from the last pose that waited; a tool that has itself changed is nowhere near it."""
        last = self._last
        if last is None or (last.radius, last.strength) != (sample.radius, sample.strength):
            return inf
        return dist(last.position, sample.position)

    def _let_wait(self, pose: Pose) -> None:
        if self._coalesced and self._waiting:
            pose = replace(pose, jump=pose.jump or self._waiting.pop().jump)
        self._waiting.append(pose)
        self._last = pose.sample
        self._news.notify_all()

    def beyond(self, pose: Pose) -> float:
        """Voxels of way from a pose through all those that wait after it; a jump is none."""
        with self._news:
            waiting = tuple(self._waiting)
        ways = zip((pose, *waiting), waiting, strict=False)
        return sum(dist(a.sample.position, b.sample.position) for a, b in ways if not b.jump)

    @property
    def any_wait(self) -> bool:
        """Whether there is a pose to be taken at once."""
        return bool(self._waiting)

    def take(self) -> Pose | None:
        """What was taken before is solved: wait for the next pose. None when there will be no more."""
        with self._news:
            self._solving = False
            self._news.notify_all()
            self._news.wait_for(lambda: self._waiting or self._closed)
            self._solving = bool(self._waiting)
            return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        """No more poses will wait. The newest is the last, however near to the one before."""
        with self._news:
            if not self._closed and self.newest is not None and self._moved(self.newest.sample) > 0.0:
                self._let_wait(self.newest)
            self._closed = True
            self._news.notify_all()

    def drop(self) -> None:
        """No more poses will wait, and those that do are not solved."""
        with self._news:
            self._closed = self._dropped = True
            self._waiting.clear()
            self._news.notify_all()

    def settle(self, timeout: float) -> bool:
        """Wait until none waits or is being solved; False when ``timeout`` seconds are too few, or they are dropped."""
        with self._news:
            self._news.wait_for(lambda: self._settled or self._dropped, timeout)
            return self._settled and not self._dropped

    @property
    def _settled(self) -> bool:
        return not self._waiting and not self._solving


def way(start: Sample | None, pose: Pose, longest: float = LONGEST_STEP) -> Iterator[Sample]:
    """The samples to solve on the way from ``start`` to a pose, at most ``longest`` voxels apart; after a jump only its
    end, before which the push lifts the tool."""
    end = pose.sample
    length = 0.0 if start is None else dist(start.position, end.position)
    if start is not None and not (pose.jump and length > 2.0 * pose.tool.radius):
        steps = max(1, ceil(length / longest - 1e-9))  # half a voxel is one step, however it rounds
        for step in range(1, steps):
            yield _between(start, end, step / steps)
    yield end


def _between(start: Sample, end: Sample, part: float) -> Sample:
    position = vector(a + (b - a) * part for a, b in zip(start.position, end.position, strict=True))
    return replace(end, time=start.time + (end.time - start.time) * part, position=position)
