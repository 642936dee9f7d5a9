# SPDX-License-Identifier: GPL-3.0-or-later
"""make stability: the map of what shakes and what does not, as a table and as pictures, into out/stability."""

from __future__ import annotations

import argparse
import sys
import time
from multiprocessing import get_context
from pathlib import Path

from tqdm import tqdm

from . import cells, material, page, pictures, table

ROOT = Path(__file__).resolve().parents[3]
WORKERS = 2
"""Nothing here is timed."""
DEFAULT = ("local", "none")
"""What the product does."""


def main() -> int:
    """Exit code; 3 where a cell of the default coupling fails."""
    parser = argparse.ArgumentParser(description="Map what shakes and what does not.")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "stability", help="folder (default out/stability)")
    parser.add_argument("--drawn", action="store_true", help="draw what is in the folder's tables, measure nothing")
    parser.add_argument("--page", action="store_true", help="renew the numbers and pictures of STABILITY.md as well")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    walls, felt, began = options.out / "stability.csv", options.out / "material.csv", time.perf_counter()
    if not options.drawn:
        table.write(cells.Row, _measured(cells.measure, cells.all_cells(), "walls"), walls)
        table.write(material.Found, _measured(material.measure, material.SPOTS, "material"), felt)
    rows, spots = table.read(cells.Row, walls), table.read(material.Found, felt)
    pictures.draw_all(rows, options.out)
    if options.page:
        page.renew(rows, spots, options.out)
    failing = [row for row in rows if (row.coupling, row.guard) == DEFAULT and row.fails]
    for line in page.summary(rows):
        print(line)
    print(f"{options.out} has the table and the pictures; {time.perf_counter() - began:.0f} s in all")
    failing_spots = [spot for spot in spots if spot.fails]
    print(f"default coupling: {len(failing)} of its cells fail, {len(failing_spots)} on the material")
    return 3 if failing or failing_spots else 0


def _measured(measure, todo: list, what: str) -> list:
    """In the order of ``todo``; neighbours go to the same worker, which remembers what they share."""
    with get_context("spawn").Pool(WORKERS) as pool:
        rows = pool.imap(measure, todo, chunksize=len(cells.DEVICES))
        return list(tqdm(rows, total=len(todo), desc=what, disable=None))


if __name__ == "__main__":
    sys.exit(main())
