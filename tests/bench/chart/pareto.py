# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points of a chart are worth having: those that no other point beats in both time and error."""

from __future__ import annotations

from collections.abc import Sequence


def dominates(first: tuple[float, float], second: tuple[float, float]) -> bool:
    """Whether a point (time, error) is at least as good as another in both, and better in one."""
    return first[0] <= second[0] and first[1] <= second[1] and first != second


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that none dominates, the fastest first. Points with a nan are none."""
    known = [i for i, (time, error) in enumerate(points) if time == time and error == error]
    best = [i for i in known if not any(dominates(points[j], points[i]) for j in known)]
    return sorted(best, key=lambda i: points[i])
