# SPDX-License-Identifier: GPL-3.0-or-later
"""The chart in words: what is nearer the truth than the sweep, what is faster, and what is both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .drawing import LEAST, Panel, known
from .growth import Growth
from .rows import ERRORS, Row

NOISE = 1.15
"""Times that differ by less than this factor, and errors too, count as equal: the next run may turn them round."""
OURS = ("sweep", "sweep + rim")
UNITS = {
    "err_mass": ("mass", "", "of all mass"),
    "err_density_l1": ("where density is, L1", "%", "of what the truth moved"),
    "err_density_w1": ("along the push, W1", " voxels", "for each voxel's worth that the truth moved"),
    "err_force": ("force, RMS", "%", "of its peak, after one factor"),
    "err_pileup": ("pile-up", "%", "of the depth"),
    "err_direction": ("direction, L1", "%", "of the push along an axis"),
    "yield depth": ("yield depth", "%", "of the law's"),
    "symmetry": ("fourfold symmetry, L1", "%", "of what was moved"),
}
"""Name, unit and what the unit is of."""


def figure(name: str, value: float | None) -> str:
    """An error with its unit; a dash where there is none."""
    if value is None or not np.isfinite(value):
        return "–"
    unit = UNITS[name][1]
    if name == "err_mass":
        return f"{value:.1e}" if value else "0"
    return f"{100.0 * value:.3g} %" if unit == "%" else f"{value:.3g}{unit}"


def milliseconds(value: float) -> str:
    """Three figures, not more."""
    return "–" if not np.isfinite(value) else f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"


@dataclass(frozen=True)
class Verdict:
    """What is to be said of the sweep ``ours`` in one panel: the rows that beat it in both, in error, in time alone."""

    ours: Row
    both: list[Row]
    nearer: list[Row]
    faster: list[Row]


def judge(rows: Sequence[Row], panel: Panel) -> Verdict | None:
    """Other methods against the default sweep: that with a rim where it was tried, for it then is the default."""
    shown = known(rows, panel)
    default = [row for row in shown if row.method in OURS and row.setting == "compiled"]
    if not default:
        return None
    ours = default[-1]
    error = max(ours.errors[panel.error], LEAST)
    found = Verdict(ours, [], [], [])
    for row in shown:
        if row is ours:
            continue
        theirs = max(row.errors[panel.error], LEAST)
        nearer, faster = theirs * NOISE < error, row.ms_p50 * NOISE < ours.ms_p50
        not_worse = theirs <= error * NOISE, row.ms_p50 <= ours.ms_p50 * NOISE
        if (nearer and not_worse[1]) or (faster and not_worse[0]):
            found.both.append(row)
        elif nearer:
            found.nearer.append(row)
        elif faster:
            found.faster.append(row)
    return found


def sentence(rows: Sequence[Row], panel: Panel) -> str:
    """One panel in words."""
    verdict = judge(rows, panel)
    if verdict is None:
        return f"**{panel.title}**: the sweep has no figure here."
    ours = verdict.ours

    def named(row: Row) -> str:
        ratio = row.ms_p50 / ours.ms_p50
        if 1.0 / NOISE <= ratio <= NOISE:
            times = "in its time"
        else:
            times = f"at {ratio:.3g} times its time" if ratio > 1.0 else f"at 1/{1.0 / ratio:.2g} of its time"
        return f"{row.label} ({figure(panel.error, row.errors[panel.error])} {times})"

    def listed(several: Sequence[Row]) -> str:
        return "; ".join(named(row) for row in sorted(several, key=lambda row: row.errors[panel.error]))

    head = (
        f"**{panel.title}** ({UNITS[panel.error][0]}, {UNITS[panel.error][2]}): {ours.label} is off by "
        f"{figure(panel.error, ours.errors[panel.error])} at {milliseconds(ours.ms_p50)} ms a step."
    )
    said = [head]
    others = [row for row in verdict.both if row.method not in OURS]
    own = [row for row in verdict.both if row.method in OURS]
    said.append(f"Dominated by {listed(others)}." if others else "No other method dominates it.")
    if own:
        said.append(f"Its own settings that do: {listed(own)}.")
    said.append(
        f"Nearer the truth, but slower: {listed(verdict.nearer)}." if verdict.nearer else "Nothing slower is nearer."
    )
    if verdict.faster:
        said.append(f"Faster, but farther off: {listed(verdict.faster)}.")
    return " ".join(said)


def ratio(rows: Sequence[Row], slow: tuple[str, str], fast: tuple[str, str], truth: str) -> float:
    """How many times longer one (method, beginning of its setting) took than another for the same press; nan where one
    of them did not get through."""

    def press(which: tuple[str, str]) -> float:
        name, setting = which
        fits = [r.ms_press for r in rows if r.truth == truth and r.method == name and r.setting.startswith(setting)]
        done = [r for r in rows if r.truth == truth and r.method == name and r.setting.startswith(setting)]
        return fits[0] if fits and not done[0].failure else float("nan")

    return press(slow) / press(fast)


def table(lines: Sequence[Sequence[str]]) -> str:
    """Lines of cells, the first of them the heading, as markdown."""
    heading, *others = ("| " + " | ".join(line) + " |" for line in lines)
    return "\n".join([heading, "|---" * len(lines[0]) + "|", *others])


def of_truth(rows: Sequence[Row], truth: str) -> str:
    """All rows of one truth, with those errors that it knows, in their units."""
    own = [row for row in rows if row.truth == truth]
    known_errors = [name for name in ERRORS if any(name in row.errors for row in own)]
    lines = [["method", "setting", "p50, ms", "p99, ms", *(UNITS[name][0] for name in known_errors), "MB"]]
    for row in own:
        setting = f"{row.setting} (*{row.failure}*)" if row.failure else row.setting
        wrong = [figure(name, row.errors.get(name)) for name in known_errors]
        times = [milliseconds(row.ms_p50), milliseconds(row.ms_p99)]
        lines.append([row.method, setting, *times, *wrong, milliseconds(row.mb)])
    return table(lines)


def beside(rows: Sequence[Row]) -> str:
    """What stands beside the chart: start-up, yield depth, symmetry, for each method and setting."""
    lines = [["method", "setting", "start-up, ms", UNITS["yield depth"][0], UNITS["symmetry"][0]]]
    for method, setting in dict.fromkeys((row.method, row.setting) for row in rows):
        own = [row for row in rows if (row.method, row.setting) == (method, setting)]
        start = [row.start_up for row in own if np.isfinite(row.start_up)]
        worst = {
            name: max((row.errors[name] for row in own if name in row.errors), default=None)
            for name in ("yield depth", "symmetry")
        }
        lines.append(
            [method, setting, milliseconds(float(np.median(start))) if start else "–"]
            + [figure(name, value) for name, value in worst.items()]
        )
    return table(lines)


def growth_table(grown: Sequence[Growth]) -> str:
    """Milliseconds a step, p50, over the tool's radius and the grid's side."""
    columns = list(dict.fromkeys((one.kind, one.at) for one in grown))
    names = {"tool": "R = {}", "grid": "{}³"}
    lines = [["method", "setting", *(names[kind].format(at) for kind, at in columns)]]
    for method, setting in dict.fromkeys((one.method, one.setting) for one in grown):
        own = {(g.kind, g.at): g.outcome for g in grown if (g.method, g.setting) == (method, setting)}
        lines.append([method, setting, *(own[c].failure or milliseconds(own[c].p50) for c in columns)])
    return table(lines)


def summary(
    rows: Sequence[Row], panels: Sequence[Panel], titles: dict[str, str], grown: Sequence[Growth], ratios: Sequence[str]
) -> str:
    """All that was found, in markdown without a title: words first, then the figures."""
    errors_met = [name for name in UNITS if any(name in row.errors for row in rows)]
    parts = [*(f"- {sentence(rows, panel)}" for panel in panels if known(rows, panel)), "", *ratios, ""]
    parts += [f"Errors: {'; '.join(f'{UNITS[name][0]}, {UNITS[name][2]}' for name in errors_met)}.", ""]
    for truth in dict.fromkeys(row.truth for row in rows):
        parts += [f"**`{truth}`**: {titles[truth]}", "", of_truth(rows, truth), ""]
    parts += ["Beside the chart, the worst over all truths:", "", beside(rows), ""]
    if grown:
        parts += ["A step's p50 in ms as tool (in 128³) and grid (R = 8) grow:", "", growth_table(grown), ""]
    return "\n".join(parts)
