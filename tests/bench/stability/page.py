# SPDX-License-Identifier: GPL-3.0-or-later
"""The numbers of STABILITY.md, from the tables alone: each set stands between two marks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from .cells import Row
from .material import Found

PAGE = Path(__file__).resolve().parents[1] / "STABILITY.md"
PICTURES = Path(__file__).resolve().parents[2] / "pictures"
WIDE = 1000
"""Pixels of a picture that is kept."""


def renew(rows: Sequence[Row], spots: Sequence[Found], folder: Path) -> None:
    """Write the page's numbers and pictures anew."""
    text = PAGE.read_text(encoding="utf-8")
    for name, lines in (("map", _map(rows)), ("limits", _limits(rows)), ("material", _material(spots))):
        text = _between(text, name, "\n".join(lines))
    unfinished = PAGE.with_suffix(".part")
    unfinished.write_text(text, encoding="utf-8")
    unfinished.replace(PAGE)
    for path in sorted(folder.glob("stability-*.png")):
        _shrink(path, PICTURES / path.name)


def summary(rows: Sequence[Row]) -> list[str]:
    """A line for each coupling, for a terminal."""
    return [f"{name}: {_failing(here)} of {len(here)} cells fail" for name, here in _by_coupling(rows).items()]


def _between(text: str, name: str, new: str) -> str:
    begin, end = f"<!-- {name}: by make stability -->", f"<!-- end of {name} -->"
    before, _, rest = text.partition(begin)
    _, found, after = rest.partition(end)
    if not found:
        raise ValueError(f"{PAGE.name}: has no place for {name}")
    return f"{before}{begin}\n\n{new}\n\n{end}{after}"


def _by_coupling(rows: Sequence[Row]) -> dict[str, list[Row]]:
    each: dict[str, list[Row]] = {}
    for row in rows:
        each.setdefault(row.coupling + ("" if row.guard == "none" else " + " + row.guard), []).append(row)
    return each


def _failing(rows: Sequence[Row]) -> int:
    return sum(row.fails for row in rows)


def _table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> list[str]:
    rows = [head, ["---"] * len(head), *lines]
    return ["| " + " | ".join(row) + " |" for row in rows]


def _map(rows: Sequence[Row]) -> list[str]:
    lines = []
    for name, here in _by_coupling(rows).items():
        share = min(row.k_granted / row.k_asked for row in here)
        lines.append(
            (
                name,
                f"{_failing(here)} of {len(here)}",
                f"{100.0 * share:.0f} %",
                f"{max(row.peak_to_peak_mm for row in here):.3f}",
                f"{max(row.max_slew_n_per_ms for row in here):.2f}",
                f"{1e3 * min(row.energy_min_j for row in here):.1f}",
                f"{1e3 * min(row.energy_min_j for row in here if row.collision_ms + row.latency_ms <= 10.0):.1f}",
            )
        )
    head = (
        "coupling",
        "cells that fail",
        "granted of what was asked, least",
        "most movement left, mm",
        "steepest force, N/ms",
        "lowest energy, mJ",
        "the same, models up to 10 ms old",
    )
    return _table(head, lines)


def _limits(rows: Sequence[Row]) -> list[str]:
    lines = []
    for coupling in ("hold", "interpolate", "local", "in_loop"):
        steady = [row for row in rows if (row.coupling, row.guard, row.jitter_ms) == (coupling, "none", 0.0)]
        worst = max(abs(row.k_max / row.k_theory - 1.0) for row in steady)
        agreeing = sum(row.fails == (row.k_asked > row.k_theory) for row in steady)
        soft = {
            (row.collision_ms, row.latency_ms / row.collision_ms): row
            for row in steady
            if row.hand == "soft" and row.k_asked == 400.0
        }
        at = [f"{soft[period, late].k_max:.0f}" for period in (1.0, 10.0, 33.0) for late in (0.0, 1.0)]
        lines.append((coupling, *at, f"{100.0 * worst:.1f} %", f"{agreeing} of {len(steady)}"))
    head = (
        "coupling",
        "1 ms",
        "1 ms, late",
        "10 ms",
        "10 ms, late",
        "33 ms",
        "33 ms, late",
        "farthest from the eigenvalues",
        "cells that do as the eigenvalues say",
    )
    return _table(head, lines)


def _material(spots: Sequence[Found]) -> list[str]:
    lines = [
        (
            spot.coupling,
            spot.arm,
            f"{spot.k_asked:.0f}",
            spot.hand,
            f"{spot.collision_ms:g}",
            f"{spot.peak_to_peak_mm:.4f}",
            f"{100.0 * spot.granted_share:.0f} %" if spot.coupling == "local" else "",
            f"{spot.max_slew_n_per_ms:.2f}",
            f"{1e3 * spot.energy_min_j:.2f}",
            f"{spot.yielded_mm:.1f}",
        )
        for spot in spots
    ]
    head = (
        "coupling",
        "arm",
        "N/m",
        "hand",
        "period and latency, ms",
        "movement left, mm",
        "granted",
        "N/ms",
        "lowest energy, mJ",
        "yielded, mm",
    )
    return _table(head, lines)


def _shrink(path: Path, small: Path) -> None:
    unfinished = small.with_suffix(".part.png")
    with Image.open(path) as picture:
        picture.thumbnail((WIDE, WIDE), Image.Resampling.LANCZOS)
        picture.convert("RGB").quantize(128, dither=Image.Dither.NONE).save(unfinished, optimize=True)
    unfinished.replace(small)
