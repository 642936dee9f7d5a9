# SPDX-License-Identifier: GPL-3.0-or-later
"""Quality: what a step may cost, and so how near it comes to the exact one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil, inf, isfinite
from statistics import median
from time import perf_counter

LONGEST_STEP = 0.5
"""Voxels of travel to a solve, at most: thin sheets are not jumped."""
MOST_SWEEPS = 4
"""Sweeps to a solve: the first, and at most three that correct for what left the reach."""


@dataclass(frozen=True)
class Quality:
    """What a step may cost.

    ``longest_step`` is how far the tool moves in a solve, in voxels; ``most_sweeps`` how many a solve may take until
    sigma meets sigma_f; ``leap`` whether the flux leaps through full material far from the tool (dispersion.py).
    """

    name: str
    longest_step: float = LONGEST_STEP
    most_sweeps: int = MOST_SWEEPS
    leap: bool = False


QUALITIES = {
    quality.name: quality
    for quality in (
        Quality("exact"),
        Quality("balanced", most_sweeps=1, leap=True),
        Quality("draft", 2.0 * LONGEST_STEP, most_sweeps=1, leap=True),
    )
}
"""By name, the most exact first. All keep every invariant of a push: mass, bounds, borders, the band."""


def quality_named(name: object) -> Quality:
    """One of :data:`QUALITIES`. Raises ValueError for another name."""
    if not isinstance(name, str) or name not in QUALITIES:
        raise ValueError(f'there is no quality "{name}": choose from {", ".join(QUALITIES)}')
    return QUALITIES[name]


FLOWS = ("compressible", "saturated", "rim")
"""How density moves, as far as a step's cost and error depend on it: into room near the tool; far, through full
material; or up, where a band turns it back."""

ERRORS = {
    "balanced": {
        "compressible": {4: 0.05, 8: 0.01, 16: 0.001, 32: 0.001},
        "saturated": {4: 0.05, 8: 0.01, 16: 0.002, 32: 0.002},
        "rim": {4: 0.16, 8: 0.08, 16: 0.025, 32: 0.015},
    },
    "draft": {
        "compressible": {4: 0.14, 8: 0.14, 16: 0.13, 32: 0.055},
        "saturated": {4: 0.12, 8: 0.035, 16: 0.012, 32: 0.005},
        "rim": {4: 0.28, 8: 0.26, 16: 0.17, 32: 0.17},
    },
}
"""Half the L1 distance to exact's densities as a share of the net moved mass, for tools of so many voxels of radius and
larger ones: the worst of presses and drags, rounded up, by tests/bench/quality_errors.py."""

COSTS = {
    "balanced": {"compressible": 0.95, "saturated": 0.75, "rim": 0.8},
    "draft": {"compressible": 0.5, "saturated": 0.45, "rim": 0.45},
}
"""Processor time for a way as a share of exact's: medians of the same pushes."""

REMEMBERED = 5
"""Solves whose time counts."""


FITS = "{ms:.1f} of {budget:g} ms"
FASTER = "{ms:.1f} of {budget:g} ms, exact would take {exact:.1f}; error up to {error:g} of {bound:g} %"
TOO_SLOW = "{ms:.1f} of {budget:g} ms; nothing faster errs by at most {bound:g} %"
UNTIMED = "no solve has been timed yet"


@dataclass(frozen=True)
class Choice:
    """What an :class:`Auto` has chosen, and why: ``words`` to be filled in with ``numbers``, so to be translated."""

    quality: Quality
    words: str
    numbers: Mapping[str, float]

    @property
    def reason(self) -> str:
        """Why, in a few words."""
        return self.words.format(**self.numbers)


class Auto:
    """Choose a quality for each solve: the most exact that keeps to a frame budget, never one over the error bound.

    Parameters
    ----------
    frame_budget
        Milliseconds in which the way that waits to be solved should be.
    error_bound
        How far a quality may be from exact: charted L1 distance of the densities as a share of the mass moved.
    clock
        Tells seconds.

    What a solve takes is the median of the last ones, so one that the machine held up changes nothing.

    Raises
    ------
    ValueError
        For a budget or a bound that is not a number over 0.
    """

    def __init__(
        self, frame_budget: float = 8.0, error_bound: float = 0.05, clock: Callable[[], float] = perf_counter
    ) -> None:
        for what, value in (("frame budget", frame_budget), ("error bound", error_bound)):
            if not (isfinite(value) and value > 0.0):
                raise ValueError(f"the {what} is a number over 0, not {value!r}")
        self.frame_budget, self.error_bound, self.clock = frame_budget, error_bound, clock
        self._exact_ms: deque[float] = deque(maxlen=REMEMBERED)  # what the last solves would have taken at exact

    def learn(self, quality: Quality, flow: str, seconds: float) -> None:
        """A solve of this quality has taken so long."""
        self._exact_ms.append(1e3 * seconds / _solve_cost(quality, flow))

    def choose(self, flow: str, radius: float, ahead: float) -> Choice:
        """The quality of the next solve, of a tool of ``radius`` voxels, when ``ahead`` voxels of way wait."""
        exact, *others = QUALITIES.values()
        if not self._exact_ms:
            return Choice(exact, UNTIMED, {})
        within = [exact, *(q for q in others if error_of(q, flow, radius) <= self.error_bound)]
        takes = [self._ms(quality, flow, ahead) for quality in within]
        n = next((n for n, ms in enumerate(takes) if ms <= self.frame_budget), takes.index(min(takes)))
        words = TOO_SLOW if takes[n] > self.frame_budget else FASTER if n else FITS
        percent = {"error": 100.0 * error_of(within[n], flow, radius), "bound": 100.0 * self.error_bound}
        return Choice(within[n], words, {"ms": takes[n], "exact": takes[0], "budget": self.frame_budget} | percent)

    def _ms(self, quality: Quality, flow: str, ahead: float) -> float:
        solves = max(1, ceil(ahead / quality.longest_step - 1e-9))
        return solves * median(self._exact_ms) * _solve_cost(quality, flow)


def error_of(quality: Quality, flow: str, radius: float) -> float:
    """The charted error of a quality with a tool of this radius in voxels, as a share of the mass moved; smaller tools
    than those of the chart are cheap, and have no error that is known."""
    if quality.name not in ERRORS:
        return 0.0
    return min((error for r, error in ERRORS[quality.name][flow].items() if r <= radius), default=inf)


def _solve_cost(quality: Quality, flow: str) -> float:
    """What a solve costs as a share of an exact one, which is as long as its longest step allows."""
    return COSTS.get(quality.name, {}).get(flow, 1.0) * quality.longest_step / LONGEST_STEP
