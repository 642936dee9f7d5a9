# SPDX-License-Identifier: GPL-3.0-or-later
"""A line of the chart, and the files that lines are kept in."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

ERRORS = ("err_mass", "err_density_l1", "err_density_w1", "err_force", "err_pileup", "err_direction")
COLUMNS = ("method", "setting", "truth", "ms_p50", "ms_p99", *ERRORS, "mb")


@dataclass(frozen=True)
class Row:
    """One method in one setting against one truth.

    ``ms_p50`` and ``ms_p99`` are of a step, in milliseconds, and so are ``ms_press``, of all steps of one press, and
    ``start_up``; ``mb`` is MB over the process without the method. ``errors`` has those of `COLUMNS` and those that
    stand beside the chart. ``failure`` says in a line why a figure is missing, and is written after the setting.
    """

    method: str
    setting: str
    truth: str
    ms_p50: float
    ms_p99: float
    mb: float
    start_up: float
    ms_press: float
    errors: dict[str, float] = field(default_factory=dict)
    failure: str = ""

    @property
    def label(self) -> str:
        return f"{self.method}, {self.setting}"

    def cells(self) -> list[str]:
        """The row under `COLUMNS`; what there is no figure for is empty."""
        setting = f"{self.setting} ({self.failure})" if self.failure else self.setting
        times = (self.ms_p50, self.ms_p99)
        figures = (*times, *(self.errors.get(name, float("nan")) for name in ERRORS), self.mb)
        return [self.method, setting, self.truth, *(f"{value:.6g}" if isfinite(value) else "" for value in figures)]


def write_table(path: Path, heading: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """A CSV file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")
    with unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(heading)
        writer.writerows(lines)
    os.replace(unfinished, path)


def write_text(path: Path, text: str) -> None:
    """A text file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")
    unfinished.write_text(text, encoding="utf-8")
    os.replace(unfinished, path)
