# SPDX-License-Identifier: GPL-3.0-or-later
"""The bench's table: every measured figure beside what DESIGN 7 asks of it, at the end of the run and in out/bench."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from repousse.core import native

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Figure:
    """One line of the table: ``limits`` are the targets, in the order of ``values``; None has no target."""

    section: str
    what: str
    names: tuple[str, ...]
    values: tuple[float, ...]
    limits: tuple[float | None, ...]
    unit: str
    at_least: bool = False

    @property
    def verdict(self) -> str:
        asked = [(value, limit) for value, limit in zip(self.values, self.limits) if limit is not None]
        if not asked:
            return ""
        return "ok" if all(value >= limit if self.at_least else value <= limit for value, limit in asked) else "MISSED"

    def cells(self) -> tuple[str, str, str, str, str]:
        sign = "≥" if self.at_least else "≤"
        measured = ", ".join(f"{name} {value:.4g}".strip() for name, value in zip(self.names, self.values))
        asked = ", ".join(
            f"{name} {sign} {limit:g}".strip() for name, limit in zip(self.names, self.limits) if limit is not None
        )
        return self.section, self.what, f"{measured} {self.unit}", asked, self.verdict


@dataclass
class Figures:
    """What the benchmarks found, in the order in which they ran."""

    lines: list[Figure] = field(default_factory=list)

    def add(
        self, section, what, values: dict[str, float], unit, limits: dict[str, float] | None = None, at_least=False
    ) -> None:
        limits = limits or {}
        asked = tuple(limits.get(name) for name in values)
        self.lines.append(Figure(section, what, tuple(values), tuple(values.values()), asked, unit, at_least))

    def steps(
        self, benchmark, section: str, what: str, repeats: int, p50: float | None = None, p99: float | None = None
    ) -> None:
        """Take the rounds of a benchmark as ``repeats`` of the same steps: p50, p99 in milliseconds, and targets.

        A push is deterministic, so the least of a step's repeats is what it takes when nothing else runs: "quiet p99".
        """
        milliseconds = 1000.0 * np.array(benchmark.stats.stats.data)
        values = dict(zip(("p50", "p99"), np.percentile(milliseconds, (50, 99)).tolist()))
        if repeats > 1:
            values["quiet p99"] = float(np.percentile(milliseconds.reshape(repeats, -1).min(axis=0), 99))
        limits = {name: limit for name, limit in (("p50", p50), ("p99", p99)) if limit is not None}
        benchmark.extra_info.update({f"{name} ms": value for name, value in values.items()})
        benchmark.extra_info.update({f"target {name} ms": limit for name, limit in limits.items()})
        self.add(section, what, values, "ms", limits)


_FIGURES = Figures()


@pytest.fixture(scope="session")
def figures() -> Figures:
    return _FIGURES


def pytest_configure(config) -> None:
    config.option.benchmark_columns = ["median", "mean", "max", "rounds"]


def _machine() -> str:
    processor = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), processor)
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    versions = f"Python {platform.python_version()}, numpy {np.__version__}, kernels {native.name()}"
    return f"{processor}, {os.cpu_count()} CPUs{load} at the end; {versions}"


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter) -> None:
    if not _FIGURES.lines:
        return
    heading = ("", "what", "measured", "target", "")
    rows = [heading, *(line.cells() for line in _FIGURES.lines)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(heading))]
    terminalreporter.section("figures against DESIGN 7")
    terminalreporter.write_line(_machine())
    for row in rows:
        terminalreporter.write_line("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())
    path = ROOT / "out" / "bench" / "figures.md"
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")
    table = ["| " + " | ".join(row) + " |" for row in rows]
    table.insert(1, "|---" * len(heading) + "|")
    unfinished.write_text("\n".join([_machine(), "", *table, ""]), encoding="utf-8")
    os.replace(unfinished, path)
    terminalreporter.write_line(f"written to {path.relative_to(ROOT)}")
