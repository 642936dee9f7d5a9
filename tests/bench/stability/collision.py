# SPDX-License-Identifier: GPL-3.0-or-later
"""The collision thread in virtual time: when it looks at the arm, and when the loop has what it found."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from random import Random

from repousse.device.limits import PERIOD
from repousse.device.protocol import ForceModel

SLACK = 1e-9
"""Seconds by which sums of periods may be off."""


@dataclass(frozen=True)
class Timing:
    """Seconds: the collision's ``period``, the ``latency`` from a look at the arm to the loop having what was found,
    and the ``jitter``: each look is late by up to that, evenly distributed, by a generator with a ``seed``."""

    period: float
    latency: float = 0.0
    jitter: float = 0.0
    seed: int = 1


class Collision:
    """Models that are made at their times, and delivered at theirs. ``collide(time)`` makes one from what the loop saw
    last; :meth:`due` is called once in each of the loop's periods, and returns those that have arrived by then."""

    def __init__(self, timing: Timing, collide: Callable[[float], ForceModel]) -> None:
        self._timing, self._collide = timing, collide
        self._random = Random(timing.seed)
        self._number = 0
        self._under_way: deque[tuple[float, ForceModel]] = deque()
        self._next = self._look()

    def _look(self) -> float:
        """When the next look at the arm is."""
        late = self._random.uniform(0.0, self._timing.jitter) if self._timing.jitter else 0.0
        return self._number * self._timing.period + late

    def due(self, now: float) -> list[ForceModel]:
        """Those that arrive up to ``now``, in their order; looks of the whole period from ``now`` on are made here,
        for all of them see the arm as it was read at ``now``."""
        while self._next < now + PERIOD - SLACK:
            self._under_way.append((self._next + self._timing.latency, self._collide(self._next)))
            self._number += 1
            self._next = self._look()
        arrived = []
        while self._under_way and self._under_way[0][0] <= now + SLACK:
            arrived.append(self._under_way.popleft()[1])
        return arrived
