# SPDX-License-Identifier: GPL-3.0-or-later
"""What the hand of haptic_stroke.py is given to do: press a punch into a column, and draw a groove in clay.

Forces stay below what the arm's motors bear for ever, about 1.5 N where it works here, and slopes below what it renders,
800 N/m, so that what is felt is the material and none of the arm's limits.
"""

from dataclasses import replace

import numpy as np

from repousse.core import PRESETS, BoxTool, DensityGrid, Material, SphereTool, Stroke
from tests.bench.truths.column import ColumnLaw

from .haptic_stroke import Keys, Task

ACROSS = 8
"""Voxels of the column's side."""


LAW = ColumnLaw(stiffness=0.36, kappa=0.3, density=0.5, reach=12.0)
"""Yields at 3.6 voxels and 0.65 N, hardens up to 19.2 voxels, and ends at 1.3 N."""


def column(law: ColumnLaw = LAW, deepest: float = 27.0, speed: float = 0.02) -> Task:
    """A punch goes about ``deepest`` voxels into a column, at ``speed`` (m/s), and back. A voxel is 2 mm of the arm's.

    The punch is wider than the walled grid, so its shells lie across the push however the hand strays.
    """
    scale, height, width = 500.0, 32.0, 24.0
    filled = int(deepest + law.compacted_length(deepest) + law.reach) + 8
    values = np.zeros((ACROSS, ACROSS, filled + 4), np.float32)
    values[:, :, :filled] = law.density
    tool = BoxTool((width, width, height), law.reach)
    material = Material(law.stiffness * tool.volume.covered_volume / ACROSS**2, law.kappa)
    middle = (ACROSS - 1) / 2.0
    face, clear = 0.03, 0.01
    bottom = face - (deepest / scale + law.plateau / 200.0)  # the hand is a spring of 200 N/m, so it wants to go deeper
    down = (face + clear - bottom) / speed
    slowly = (law.yield_depth / scale + law.plateau / 200.0) / speed + 0.2
    left = bottom + slowly * speed
    keys = [
        (1.8, face + clear, False),
        (2.1, face + clear, True),
        (2.1 + down, bottom, True),
        (2.3 + down, bottom, True),
        (2.3 + down + slowly, left, True),
        (3.1 + down + slowly, face + clear, True),
        (3.2 + down + slowly, face + clear, False),
    ]
    return Task(
        "pressing",
        Keys(tuple((when, (0.0, 0.0, height), pressed) for when, height, pressed in keys)),
        DensityGrid(values),
        Stroke([], tool, material, border="wall"),
        np.array((middle, middle, filled - 0.5 + height)),
        np.array((0.0, 0.0, face)),
        scale,
    )


def groove(pace: float = 0.03) -> Task:
    """A ball is pressed into a block of clay and drawn along, at ``pace`` (m/s). A voxel is 1.25 mm of the arm's.

    The clay is that of the preset, dried: 6 N in place of 3.3, for a hand to feel it well through an arm with friction.
    """
    clay, radius, scale = PRESETS["clay"], 12.0, 800.0
    values = np.zeros((72, 120, 64), np.float32)
    filled = 44
    values[:, :, :filled] = clay.density
    assert clay.band is not None
    stroke = Stroke([], SphereTool(radius), replace(clay.material, full_force=6.0), band=clay.band * radius)
    y, over, pressed, drawn = 0.035, 0.01, -0.0095, -0.0065
    end, back = 3.2 + 2.0 * y / pace, y - 0.018
    keys = (
        (1.8, (0.0, -y, over), False),
        (2.1, (0.0, -y, over), True),
        (2.9, (0.0, -y, pressed), True),
        (3.2, (0.0, -y, drawn), True),
        (end, (0.0, y, drawn), True),
        (end + 0.5, (0.0, back, drawn + 0.004), True),  # straight up it would carry the clay ahead with it
        (end + 1.0, (0.0, back, over), True),
        (end + 1.1, (0.0, back, over), False),
    )
    return Task(
        "drawing",
        Keys(keys),
        DensityGrid(values),
        stroke,
        np.array((35.5, 59.5, filled - 0.5 + radius)),
        np.zeros(3),
        scale,
    )
