# SPDX-License-Identifier: GPL-3.0-or-later
"""python -m tests.bench.stability.hard_cases [NAME ...]: every hard case's figures against their marks.

Prints them, and writes out/stability/hard_cases.csv and hard_cases.md there. Ends with 1 where a mark is missed.
"""

from __future__ import annotations

import sys

from .cases import confined, curl, looping, moving, resting

CASES = {
    case.__name__: case
    for case in moving.CASES + confined.CASES + resting.CASES + curl.CASES + looping.CASES + looping.LONG_CASES
}

if __name__ == "__main__":
    import time

    for name in sys.argv[1:] or CASES:
        t = time.process_time()
        for figure in CASES[name]():
            print(figure)
        print("   ", name, round(time.process_time() - t, 2), "s cpu")
