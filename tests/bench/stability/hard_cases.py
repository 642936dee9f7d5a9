# SPDX-License-Identifier: GPL-3.0-or-later
"""python -m tests.bench.stability.hard_cases [NAME ...]: the hard cases' figures against their marks.

Prints them as they come, and writes all into out/stability/hard_cases.csv and the worst of each kind into
out/stability/hard_cases.md. Without a name all cases but the ten minutes of random motion, `wandering_long`. Ends with
1 where a mark is missed.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TextIO

from .cases import confined, curl, looping, moving, resting
from .figure import Figure

Case = Callable[[], Iterator[Figure]]

_ALL = moving.CASES + confined.CASES + resting.CASES + curl.CASES + looping.CASES
CASES: dict[str, Case] = {case.__name__: case for case in _ALL}
LONG_CASES: dict[str, Case] = {case.__name__: case for case in looping.LONG_CASES}
OUT = Path("out/stability")
HEADER = ("case", "scene", "figure", "measured", "unit", "at_least", "at_most", "passes")


def worst(figures: Iterable[Figure]) -> list[Figure]:
    """Of those that ask for the same the one that comes nearest to its mark, or misses it most."""
    chosen: dict[tuple, Figure] = {}
    for figure in figures:
        key = (figure.what, figure.at_least, figure.at_most)
        former = chosen.setdefault(key, figure)
        upward = figure.at_most is not None
        if (figure.measured > former.measured) if upward else (figure.measured < former.measured):
            chosen[key] = figure
    return list(chosen.values())


def write_csv(measured: dict[str, list[Figure]], file: TextIO) -> None:
    """Every figure, a line each."""
    rows = csv.writer(file)
    rows.writerow(HEADER)
    for name, figures in measured.items():
        for f in figures:
            low, high = ("" if mark is None else f"{mark:g}" for mark in (f.at_least, f.at_most))
            rows.writerow((name, f.case, f.what, f"{f.measured:.6g}", f.unit, low, high, int(f.passes)))


def write_table(measured: dict[str, list[Figure]], file: TextIO) -> None:
    """The worst of each kind, for people."""
    file.write("| case | figure | worst | mark | where |\n|---|---|---|---|---|\n")
    for name, figures in measured.items():
        for f in worst(figures):
            value = f"{f.measured + 0.0:.3g} {f.unit}".strip() + ("" if f.passes else " **missed**")
            file.write(f"| {name.replace('_', ' ')} | {f.what} | {value} | {f.mark} | {f.case} |\n")


def _written(path: Path, write: Callable[[TextIO], None]) -> None:
    """Under another name first: nobody finds half of it."""
    part = path.with_name(path.name + ".part")
    with part.open("w", encoding="utf-8", newline="\n") as file:
        write(file)
    os.replace(part, path)


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description="The hard cases' figures against their marks.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(CASES | LONG_CASES))
    names = parser.parse_args(arguments).names
    if unknown := [name for name in names if name not in CASES | LONG_CASES]:
        parser.error(f'there is no case "{unknown[0]}": choose from {", ".join(CASES | LONG_CASES)}')
    measured: dict[str, list[Figure]] = {}
    for name in names or CASES:
        measured[name] = []
        for figure in (CASES | LONG_CASES)[name]():
            print(figure, flush=True)
            measured[name].append(figure)
    OUT.mkdir(parents=True, exist_ok=True)
    _written(OUT / "hard_cases.csv", lambda file: write_csv(measured, file))
    _written(OUT / "hard_cases.md", lambda file: write_table(measured, file))
    return int(not all(figure.passes for figures in measured.values() for figure in figures))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
