# SPDX-License-Identifier: GPL-3.0-or-later
"""Every method in every trial, one process after another."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module

import numpy as np

from .measure import REPEATED, Outcome, Request, measure
from .method import Scene
from .rows import Row
from .trials import TRIALS, Trial

MODULES = (
    *("carve", "sweep", "estimators", "coarse", "batched", "recursive"),
    *("overflow", "sandpile", "potential_rim", "mpm", "finite_elements"),
)
BUDGETS = {"recursive": 30.0, "overflow": 40.0, "sandpile": 40.0, "mpm": 120.0, "finite_elements": 60.0}
"""Seconds of stepping that a module's methods may take in one scene."""
BUDGET = 20.0
PRESSES = ("foam-500", "mises-500")
ONLY_IN = (
    ("sweep", "compiled", tuple(TRIALS)),
    ("sweep", "numpy", tuple(TRIALS)),
    ("sweep", "reach", ("foam-500",)),  # the law and the recursion are about a reach of 1.5 R
    ("sweep", "kappa", ("foam-500",)),  # and about the scene's kappa
    ("sweep", "m =", ("foam-500",)),  # and about the paper's force
    ("sweep", "1", ("foam-500", "recursion", "direction")),  # samples: in a narrow column all but a few see nothing
    ("sweep", "", ("foam-500", "column", "recursion", "direction")),  # what these change, the rim does not touch
    ("sweep + rim", "", ("mises-500",)),  # where there is no band it is the sweep
    ("recursive", "ties", ("recursion",)),  # it is there to show what ties are worth
    ("sweep + potential rim", "", ("mises-500",)),
    ("overflow", "", (*PRESSES, "column")),  # flow that knows no direction says nothing of it
    ("sandpile", "", (*PRESSES, "column")),
    ("batched", "", ("recursion", "direction")),  # it is there to show how the sweep's kernel differs
    ("MLS-MPM", "von Mises", ("mises-500",)),
    ("MLS-MPM", "crushable foam", ("foam-500",)),
    ("finite elements", "", PRESSES),  # they know a press into a half space alone
)
"""Method, beginning of its setting, and the trials that it belongs into: the first line that fits holds. Others belong
into all."""


@dataclass(frozen=True)
class Point:
    """A method in a setting: what the chart names."""

    module: str
    name: str
    setting: str

    def is_tried(self, trial: str) -> bool:
        """Whether it belongs into a trial."""
        for name, setting, trials in ONLY_IN:
            if self.name == name and self.setting.startswith(setting):
                return trial in trials
        return True

    def measure(self, scene: Scene, repeated: float = REPEATED) -> Outcome:
        """What comes of it in a scene, in a process of its own."""
        return measure(Request(self.module, self.name, self.setting, BUDGETS.get(self.module, BUDGET), repeated), scene)

    def row(self, truth: str, outcome: Outcome, errors: dict[str, float], failure: str) -> Row:
        return Row(
            *(self.name, self.setting, truth, outcome.p50, outcome.p99),
            *(outcome.mb, outcome.start_up, outcome.press, errors, failure),
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


def work(chosen: Iterable[Point], trials: Iterable[str]) -> int:
    """How many rows `run` makes."""
    names = list(trials)
    return sum(point.is_tried(name) for point in chosen for name in names)


def tried(point: Point, trial: Trial, reference: Outcome | None) -> Row:
    """One row: all scenes of a trial, as far as they go."""
    outcomes: list[Outcome] = []
    for scene in trial.scenes():
        outcomes.append(point.measure(scene, 0.0 if outcomes else REPEATED))
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
            reference = Point(*trial.reference).measure(trial.scenes()[0])
        for point in (point for point in chosen if point.is_tried(name)):
            step(f"{name}: {point.name}, {point.setting}")
            yield tried(point, trial, reference)
