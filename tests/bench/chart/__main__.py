# SPDX-License-Identifier: GPL-3.0-or-later
"""make chart: measure every method against every truth, and draw time against error.

Leaves in out/chart: speed_accuracy.csv and .png (the chart), growth.csv and .png (how times grow, and what stands
beside the chart), summary.md (all of it in words and tables).
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from repousse.core import native

from . import physics, words
from .drawing import Panel, draw, draw_growth
from .growth import GROWN, Growth, grow
from .measure import ROOT
from .page import rewrite
from .rows import COLUMNS, Row, write_table, write_text
from .run import Point, points, run, work
from .trials import TRIALS

PANELS = (
    Panel("foam-500", "err_force", "Finite elements, crushable foam: force", "force, RMS over its peak"),
    Panel("foam-500", "err_density_l1", "Finite elements, crushable foam: density", "L1 over what the truth moved"),
    Panel("mises-500", "err_force", "Finite elements, von Mises: force", "force, RMS over its peak"),
    Panel("mises-500", "err_pileup", "Finite elements, von Mises: pile-up", "rim off by, over the depth"),
    Panel("mises-500", "err_density_l1", "Finite elements, von Mises: occupancy", "L1 over the pit"),
    Panel("column", "err_force", "The law in closed form: force", "force, RMS over its peak"),
    Panel("recursion", "err_density_l1", "The paper's recursion: density", "L1 over what it moved"),
    Panel("direction", "err_direction", "The same push along an axis: pit and front", "L1 over the push along an axis"),
)
QUICK = (("carve", "remove only"), ("sweep", "compiled"), ("coarse sweep", "half the resolution"))
PAGE, PICTURE = ROOT / "tests" / "bench" / "README.md", ROOT / "tests" / "pictures" / "speed_accuracy.png"


def main(arguments: Sequence[str] | None = None) -> None:
    options = _options(arguments)
    chosen = [p for p in points() if not options.only or p.name in options.only]
    names = [name for name in TRIALS if not options.trials or name in options.trials]
    if options.quick:
        chosen, names = [p for p in points() if (p.name, p.setting) in QUICK], ["column"]
    grown = [] if options.quick or options.only or options.trials else list(GROWN)
    began, rows, sizes = time.monotonic(), [], []
    with tqdm(total=work(chosen, names) + 6 * len(grown), unit="run", dynamic_ncols=True) as bar:

        def step(what: str) -> None:
            bar.set_description_str(what[:60].ljust(60))

        for row in run(chosen, names, step):
            rows.append(row)
            bar.update()
        for one in grow(grown, step):
            sizes.append(one)
            bar.update()
    _write(options.out, rows, sizes, time.monotonic() - began)
    if options.page:
        rewrite(PAGE, (options.out / "summary.md").read_text(encoding="utf-8"))
        draw(rows, PANELS, PICTURE)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make chart", description=__doc__.splitlines()[0])

    def several(text: str) -> list[str]:
        return [part.strip() for part in text.split(",") if part.strip()]

    parser.add_argument("--only", type=several, default=[], help="names of methods, comma between them")
    parser.add_argument("--trials", type=several, default=[], help="names of truths, comma between them")
    parser.add_argument("--quick", action="store_true", help="three methods against one truth, in seconds")
    parser.add_argument("--page", action="store_true", help="also rewrite the page's tables and picture")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "chart")
    options = parser.parse_args(arguments)
    known = {"--trials": set(TRIALS), "--only": {point.name for point in points()}}
    for option, asked in (("--trials", options.trials), ("--only", options.only)):
        for name in asked:
            if name not in known[option]:
                parser.error(f'{option}: there is no "{name}"; choose from {", ".join(sorted(known[option]))}')
    return options


def _write(out: Path, rows: Sequence[Row], sizes: Sequence[Growth], seconds: float) -> None:
    write_table(out / "speed_accuracy.csv", COLUMNS, [row.cells() for row in rows])
    write_table(out / "growth.csv", ("method", "setting", "figure", "at", "value", "unit"), _beside(rows, sizes))
    draw(rows, PANELS, out / "speed_accuracy.png")
    if sizes:
        draw_growth(sizes, out / "growth.png")
    titles = {name: trial.title for name, trial in TRIALS.items()}
    text = words.summary(rows, PANELS, titles, sizes, _ratios(rows))
    write_text(out / "summary.md", f"{_machine()}; {seconds / 60.0:.1f} minutes.\n\n{text}")


def _ratios(rows: Sequence[Row]) -> list[str]:
    """The two ratios that were asked for, of whole presses in this run."""
    said = []
    recursion = words.ratio(rows, ("recursive", "literal"), ("sweep", "compiled"), "recursion")
    if np.isfinite(recursion):
        said.append(f"- The literal recursion took {recursion:.0f} times as long as the sweep for the same press.")
    points_press = [
        row.ms_press
        for row in rows
        if (row.method, row.truth, row.failure) == ("MLS-MPM", "mises-500", "") and "48^3" in row.setting
    ]
    if points_press:
        fine = Point("sweep", "sweep + rim", "compiled").measure(physics.scene("mises-500", 48))
        said.append(
            f"- MLS-MPM in 48^3 cells took {points_press[0] / fine.press:.0f} times as long as the sweep with its rim "
            f"in 48^3 voxels for the same press: {points_press[0] / 1000.0:.3g} s against {fine.press:.3g} ms."
        )
    return said


def _beside(rows: Sequence[Row], sizes: Sequence[Growth]) -> list[list[str]]:
    lines = []
    for row in rows:
        figures = {"start-up": (row.start_up, "ms"), "a whole press": (row.ms_press, "ms")}
        figures |= {name: (row.errors[name], "1") for name in ("yield depth", "symmetry") if name in row.errors}
        lines += [
            [row.method, row.setting, what, row.truth, f"{value:.6g}", unit]
            for what, (value, unit) in figures.items()
            if np.isfinite(value)
        ]
    for one in sizes:
        at = f"tool {one.at}" if one.kind == "tool" else f"grid {one.at}"
        for what, value in (("p50", one.outcome.p50), ("p99", one.outcome.p99), ("memory", one.outcome.mb)):
            unit = "MB" if what == "memory" else "ms"
            lines.append([one.method, one.setting, what, at, f"{value:.6g}" if np.isfinite(value) else "", unit])
    return lines


def _machine() -> str:
    processor = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), processor)
    load = f", load {os.getloadavg()[0]:.1f} at the end" if hasattr(os, "getloadavg") else ""
    versions = f"Python {platform.python_version()}, numpy {np.__version__}, kernels {native.name()}"
    return f"{processor}, one core of {os.cpu_count()} for each method in turn{load}; {versions}"


if __name__ == "__main__":
    main()
