# SPDX-License-Identifier: GPL-3.0-or-later
"""Every method in every trial, one process after another."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module

import numpy as np

from .measure import REPEATED, Outcome, Request, measure
from .rows import Row
from .trials import TRIALS, Trial

MODULES = ("carve", "sweep", "estimators", "coarse", "recursive")
BUDGETS = {"recursive": 40.0}
"""Seconds of stepping that a module's methods may take in one scene."""
BUDGET = 20.0


@dataclass(frozen=True)
class Point:
    """A method in a setting: what the chart names."""

    module: str
    name: str
    setting: str

    def request(self, trial: str, scene: int = 0) -> Request:
        budget = BUDGETS.get(self.module, BUDGET)
        return Request(self.module, self.name, self.setting, trial, scene, budget, 0.0 if scene else REPEATED)

    def row(self, truth: str, outcome: Outcome, errors: dict[str, float], failure: str) -> Row:
        return Row(
            *(self.name, self.setting, truth, outcome.p50, outcome.p99),
            *(outcome.mb, outcome.start_up, errors, failure),
        )


def points(modules: Iterable[str] = MODULES) -> list[Point]:
    """All methods that the modules offer. A module that cannot be imported is a point that will say so."""
    found = []
    for module in modules:
        try:
            offered = import_module(f"{__package__}.methods.{module}").METHODS
            found += [Point(module, method.name, method.setting) for method in offered]
        except ImportError:
            found.append(Point(module, module, "not installed"))
    return found


def tried(point: Point, trial: Trial, reference: Outcome | None) -> Row:
    """One row: all scenes of a trial, as far as they go."""
    outcomes: list[Outcome] = []
    for number in range(len(trial.scenes())):
        outcomes.append(measure(point.request(trial.name, number)))
        if outcomes[-1].failure:
            break
    failure = outcomes[-1].failure
    if not failure and reference is not None and reference.failure:
        failure = f"nothing to compare with: {reference.failure}"
    errors = {} if failure else trial.judge(outcomes, reference)
    return point.row(trial.name, outcomes[0], {k: v for k, v in errors.items() if np.isfinite(v)}, failure)


def run(chosen: list[Point], trials: Iterable[str], step: Callable[[str], None] = lambda _: None) -> Iterator[Row]:
    """The rows of all ``chosen`` points in the ``trials``; ``step`` is told of each before it begins."""
    for name in trials:
        trial, reference = TRIALS[name], None
        if trial.reference is not None:
            step(f"{name}: the truth")
            reference = measure(Point(*trial.reference).request(name))
        for point in chosen:
            step(f"{name}: {point.name}, {point.setting}")
            yield tried(point, trial, reference)
