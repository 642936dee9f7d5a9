# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m tests.bench.truths [NAME ...]` computes what its cache lacks; with --check it runs the checks instead."""

from __future__ import annotations

import argparse
import sys

from .cache import load, pressed
from .case import CASES


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser("tests.bench.truths", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(CASES)}; none: all")
    parser.add_argument("--check", action="store_true", help="compare the solver with what is known without it")
    options = parser.parse_args(arguments)
    if options.check:
        from .checks import report

        return 0 if report() else 1
    names = options.names or list(CASES)
    for place in range(3):  # the coarse meshes of all come first: what is there early is of use early
        for name in names:
            for size in CASES[name].sizes[place : place + 1]:
                pressed(name, size)
    for name in names:
        truth = load(name)
        rims = " ".join(f"{rim:.3f}" for rim in truth.rim)
        print(f"{name}: h = {truth.h:g}, rim/depth {rims}, kinetic energy {truth.kinetic:.1e} of the work", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
