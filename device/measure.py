# SPDX-License-Identifier: GPL-3.0-or-later
"""How long things take: counted by the loop in bins, made into percentiles by whoever asks."""

from __future__ import annotations

from bisect import bisect_left
from itertools import accumulate

Counters = memoryview | list[int]
"""Of 32 bits or more."""


def count(bins: Counters, width: float, seconds: float) -> None:
    """One more in the bin of ``seconds``; what is too long for the last bin counts there."""
    index = int(seconds / width)
    bins[min(max(index, 0), len(bins) - 1)] += 1


def percentiles(bins: Counters, width: float, shares: tuple[float, ...]) -> tuple[float, ...]:
    """The upper edges (seconds) of the bins below which these shares (0 to 1) of all counts lie; 0 without any."""
    totals = list(accumulate(bins))
    if not totals or totals[-1] == 0:
        return tuple(0.0 for _ in shares)
    return tuple(width * (bisect_left(totals, share * totals[-1]) + 1) for share in shares)


class Parts:
    """Seconds that the parts of a period take, summed until they are asked for."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._sums = [0.0] * len(names)
        self._periods = 0

    def add(self, times: tuple[float, ...]) -> None:
        """A period's, from the times at its begin and at the end of each part."""
        sums = self._sums
        for part in range(len(sums)):
            sums[part] += times[part + 1] - times[part]
        self._periods += 1

    def take(self) -> dict[str, float]:
        """The mean of each since this was last asked, in seconds."""
        periods = max(1, self._periods)
        means = {name: total / periods for name, total in zip(self._names, self._sums, strict=True)}
        self._sums = [0.0] * len(self._names)
        self._periods = 0
        return means
