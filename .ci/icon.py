# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the tool's icon, `python .ci/icon.py FILE.dat`: a ball that dents clay, as triangles in Blender's icon format.

The format is "VCO", a zero, the width and height less one, two zeros; then x, y of all corners and red, green, blue,
alpha of all corners, a byte each; y points up.
"""

import math
import sys
from itertools import pairwise
from pathlib import Path

CLAY, SHADE, BALL, SHINE = (204, 120, 74, 255), (150, 84, 50, 255), (238, 238, 238, 255), (255, 255, 255, 255)
FLOOR, SURFACE, RIM = 34.0, 128.0, 26.0
CENTRE, RADIUS = (128.0, 158.0), 66.0

Point = tuple[float, float]
Triangle = tuple[Point, Point, Point]


def disc(centre: Point, radius: float, corners: int = 40) -> list[Triangle]:
    """A filled circle."""
    turn = 2.0 * math.pi / corners
    around = [
        (centre[0] + radius * math.cos(n * turn), centre[1] + radius * math.sin(n * turn)) for n in range(corners + 1)
    ]
    return [(centre, a, b) for a, b in pairwise(around)]


def height(x: float) -> float:
    """The dented surface: the ball's underside, and the rim beside it."""
    away = abs(x - CENTRE[0])
    rim = SURFACE + RIM * math.exp(-(((away - RADIUS - 4.0) / 16.0) ** 2))
    if away >= RADIUS:
        return rim
    return min(rim, CENTRE[1] - math.sqrt(RADIUS**2 - away**2) - 6.0)


def below(first: float, last: float, floor: float, top, steps: int = 48) -> list[Triangle]:
    """The area between a level and a curve."""
    xs = [first + (last - first) * n / steps for n in range(steps + 1)]
    strips = [((a, floor), (b, floor), (b, top(b)), (a, top(a))) for a, b in pairwise(xs)]
    return [half for p, q, r, s in strips for half in ((p, q, r), (p, r, s))]


def main() -> None:
    """Write the file that the command line names."""
    shapes = [
        (below(16.0, 240.0, FLOOR, height), CLAY),
        (below(16.0, 240.0, FLOOR, lambda x: FLOOR + 22.0), SHADE),
        (disc(CENTRE, RADIUS - 2.0), BALL),
        (disc((CENTRE[0] - 20.0, CENTRE[1] + 22.0), 16.0), SHINE),
    ]
    corners, colours = bytearray(), bytearray()
    for triangles, colour in shapes:
        for triangle in triangles:
            for x, y in triangle:
                corners += bytes((round(x), round(y)))
                colours += bytes(colour)
    Path(sys.argv[1]).write_bytes(b"VCO\0" + bytes((255, 255, 0, 0)) + corners + colours)


if __name__ == "__main__":
    main()
