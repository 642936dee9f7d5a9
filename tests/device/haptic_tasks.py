# SPDX-License-Identifier: GPL-3.0-or-later
"""What the hand of haptic_stroke.py is given to do: press a punch into a column, and draw a groove in clay.

Forces stay below what the arm's motors bear for ever, about 1.5 N where it works here, and slopes below what it renders,
800 N/m, so that what is felt is the material and none of the arm's limits.
"""

from dataclasses import dataclass, replace

import numpy as np

from repousse.core import PRESETS, BoxTool, DensityGrid, Material, SphereTool, Stroke

from .haptic_stroke import Keys, Task

ACROSS = 8
"""Voxels of the column's side."""


@dataclass(frozen=True)
class ColumnLaw:
    """A column under a punch as wide as itself, in closed form (DESIGN 2).

    ``stiffness`` k_t A in N/voxel, ``kappa`` the yield ratio, ``density`` d0 of the loose material, ``reach`` D in
    voxels ahead of the punch. Depths are in voxels, forces in N.
    """

    stiffness: float
    kappa: float
    density: float
    reach: float

    @property
    def yield_depth(self) -> float:
        return self.kappa * self.reach

    @property
    def elastic_slope(self) -> float:
        return self.stiffness * self.density

    @property
    def plastic_slope(self) -> float:
        return self.elastic_slope * self.kappa / (1.0 + self.kappa)

    @property
    def plateau_begins(self) -> float:
        return self.reach * ((1.0 + self.kappa) / self.density - 1.0)

    @property
    def plateau(self) -> float:
        return self.stiffness * self.kappa * self.reach

    def pressed(self, depth: np.ndarray) -> np.ndarray:
        """The force on the way in."""
        elastic = self.elastic_slope * np.maximum(depth, 0.0)
        plastic = self.plastic_slope * (self.reach + np.maximum(depth, 0.0))
        return np.minimum(np.minimum(elastic, plastic), self.plateau)

    def released(self, depth: np.ndarray, deepest: float) -> np.ndarray:
        """The force on the way back from the plateau: the front is compacted, so E / d0 over its first voxels."""
        return np.clip(self.plateau - self.stiffness * (deepest - depth), 0.0, None)

    @property
    def expected(self) -> dict[str, float]:
        """The rows by name."""
        return {
            "elastic slope, N/voxel": self.elastic_slope,
            "yield depth, voxels": self.yield_depth,
            "plastic slope, N/voxel": self.plastic_slope,
            "plateau begins, voxels": self.plateau_begins,
            "plateau, N": self.plateau,
            "unloading slope, N/voxel": self.stiffness,
            "unloading ends after, voxels": self.yield_depth,
        }

    def rows(self, depth: np.ndarray, force: np.ndarray) -> dict[str, tuple[float, float]]:
        """Each row of the law as it is found in a press and its retreat, and as it should be.

        ``force`` (n,) is that against the punch at each ``depth`` (n,), in the order of time. Slopes are those of lines
        through what lies clear of a row's ends.
        """
        turn = int(depth.argmax())
        deepest, way_in, way_out = depth[turn], slice(0, turn), slice(turn, None)
        plastic_from, plastic_to = self.yield_depth + 1.0, self.plateau_begins - 2.0
        elastic, at_zero = _line(depth[way_in], force[way_in], 0.5, self.yield_depth - 0.5)
        plastic, there = _line(depth[way_in], force[way_in], plastic_from, plastic_to)
        on_plateau = depth[way_in] > self.plateau_begins + 2.0
        plateau = float(np.median(force[way_in][on_plateau]))
        back = deepest - depth[way_out]
        unloading, peak = _line(back, force[way_out], 0.25, self.yield_depth - 0.75)
        found = (
            elastic,
            (there - at_zero) / (elastic - plastic),
            plastic,
            (plateau - there) / plastic,
            plateau,
            -unloading,
            -peak / unloading,
        )
        return {name: (here, there) for here, (name, there) in zip(found, self.expected.items(), strict=True)}


def _line(depth: np.ndarray, force: np.ndarray, low: float, high: float) -> tuple[float, float]:
    """Slope and value at 0 of the line through what lies between two depths."""
    chosen = (depth >= low) & (depth <= high)
    if chosen.sum() < 10:
        raise ValueError(f"only {chosen.sum()} of the force was seen from {low:g} to {high:g} voxels")
    slope, at_zero = np.polyfit(depth[chosen], force[chosen], 1)
    return float(slope), float(at_zero)


LAW = ColumnLaw(stiffness=0.36, kappa=0.3, density=0.5, reach=12.0)
"""Yields at 3.6 voxels and 0.65 N, hardens up to 19.2 voxels, and ends at 1.3 N."""


def column(law: ColumnLaw = LAW, deepest: float = 27.0, speed: float = 0.02) -> Task:
    """A punch goes about ``deepest`` voxels into a column, at ``speed`` (m/s), and back. A voxel is 2 mm of the arm's.

    The punch is wider than the walled grid, so its shells lie across the push however the hand strays.
    """
    scale, height, width = 500.0, 32.0, 24.0
    compacted = (law.density * deepest - law.yield_depth) / (1.0 - law.density)
    filled = int(deepest + compacted + law.reach) + 8
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
