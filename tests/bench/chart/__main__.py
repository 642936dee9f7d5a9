# SPDX-License-Identifier: GPL-3.0-or-later
"""make chart: measure every method against every truth; out/chart gets the table and the picture."""

from __future__ import annotations

import argparse
from pathlib import Path

from tqdm import tqdm

from .drawing import Panel, draw
from .rows import COLUMNS, write_table
from .run import points, run
from .trials import TRIALS

PANELS = [
    Panel("column", "err_force", "the law in closed form: force", "force, RMS over its peak"),
    Panel("recursion", "err_density_l1", "the paper's recursion: where density went", "L1 over net moved mass"),
    Panel("direction", "err_direction", "the same push along an axis: pit and front", "L1 over the push along an axis"),
]


def main() -> None:
    parser = argparse.ArgumentParser(prog="make chart", description=__doc__)
    parser.add_argument("--only", default="", help="names of methods, comma between them")
    parser.add_argument("--trials", default="", help="names of truths, comma between them")
    parser.add_argument("--out", type=Path, default=Path("out/chart"))
    options = parser.parse_args()
    chosen = [p for p in points() if not options.only or p.name in options.only.split(",")]
    names = [name for name in TRIALS if not options.trials or name in options.trials.split(",")]
    rows = []
    with tqdm(total=len(chosen) * len(names)) as bar:
        for row in run(chosen, names, bar.set_description):
            rows.append(row)
            bar.update()
    write_table(options.out / "speed_accuracy.csv", COLUMNS, [row.cells() for row in rows])
    draw(rows, PANELS, options.out / "speed_accuracy.png")


if __name__ == "__main__":
    main()
