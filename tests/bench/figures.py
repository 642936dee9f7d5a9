# SPDX-License-Identifier: GPL-3.0-or-later
"""Redraw the paper's figures with this program: `python tests/bench/figures.py [NUMBER ...] [--out FOLDER]`."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

from PIL import Image
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[2]
FIGURES = {1: "loop", 2: "rim", 3: "regimes", 4: "pyramid", 5: "tree", 6: "block", 7: "ct"}
"""What each figure of the paper shows; ``figure_<name>.draw(path)`` draws it."""


def shrink(path: Path) -> None:
    """Make a picture small enough for a README, under the same name."""
    unfinished = path.with_name(f"{path.stem}.part.png")
    with Image.open(path) as picture:
        picture.thumbnail((1000, 1000), Image.Resampling.LANCZOS)
        picture.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(unfinished, optimize=True)
    unfinished.replace(path)


def main() -> None:
    parser = argparse.ArgumentParser(description="Redraw the paper's figures.")
    parser.add_argument("numbers", nargs="*", type=int, metavar="NUMBER", help="1 to 7; all where none is given")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "figures", help="folder (default out/figures)")
    parser.add_argument("--small", action="store_true", help="1000 pixels wide and of 256 colours, for a README")
    options = parser.parse_args()
    for number in options.numbers:
        if number not in FIGURES:
            parser.error(f"there is no figure {number}: choose from 1 to {max(FIGURES)}")
    with tqdm(sorted(set(options.numbers)) or FIGURES, unit="figure", disable=None) as bar:
        for number in bar:
            bar.set_description(f"figure {number}, {FIGURES[number]}")
            path = options.out / f"figure-{number}-{FIGURES[number]}.png"
            importlib.import_module(f"figure_{FIGURES[number]}").draw(path)
            if options.small:
                shrink(path)
    print(f"figures are in {options.out}")


if __name__ == "__main__":
    main()
