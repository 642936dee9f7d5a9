# SPDX-License-Identifier: GPL-3.0-or-later
"""What each quality costs and by how much it errs, against exact: the tables of core/quality.py.

    python -m tests.bench.quality_errors [RADIUS ...]

A line for each push: error = half the L1 distance of the two grids as a share of the mass that exact has moved net; of
sigma, RMS as a share of its peak; cost = processor time as a share of exact's, the least of a few runs in turns. The
last lines are the worst error and the median cost of each kind of scene and radius: what the tables have.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.linalg import norm

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.quality import QUALITIES

RUNS = 3
MATERIAL = Material(3.3, 0.1)


@dataclass(frozen=True)
class Scene:
    """A push into a block of one density: from just outside along ``direction``, then ``drag``. Lengths in radii."""

    kind: str
    density: float
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    depth: float = 1.0
    drag: float = 0.0
    band: float | None = None
    thickness: float = 4.0
    verb: str = "push"

    def push(self, radius: float) -> Push:
        """A push into a new block."""
        edge, before = 6.0 * radius, round(1.5 * radius)
        shape = (before + ceil(self.thickness * radius) + before, ceil(edge + self.drag * radius), ceil(edge))
        values = np.zeros(shape, np.float32)
        values[before:-before] = self.density
        band = None if self.band is None else self.band * radius
        return Push(DensityGrid(values, copy=False), SphereTool(radius), MATERIAL, band=band, verb=self.verb)

    def path(self, radius: float) -> list[np.ndarray]:
        """Points a voxel apart."""
        u, surface = np.array(self.direction) / norm(self.direction), round(1.5 * radius) - 0.5
        middle = np.array([surface - radius, 3.0 * radius - 0.5, 3.0 * radius - 0.5])
        end = middle + self.depth * radius * u
        points = [middle + (end - middle) * t for t in np.linspace(0.0, 1.0, round(self.depth * radius) + 1)]
        steps = round(self.drag * radius)
        return points + [end + np.array([0.0, step, 0.0]) for step in range(1, steps + 1)]


SCENES = [
    *(Scene("compressible", density, depth=depth) for density in (0.3, 0.6, 0.9) for depth in (0.5, 1.5)),
    Scene("compressible", 0.6, (0.8, 0.5, 0.33)),
    Scene("compressible", 0.6, depth=0.5, drag=2.0),
    Scene("compressible", 0.6, depth=0.5, drag=2.0, verb="pull"),
    *(Scene("saturated", 1.0, depth=depth, thickness=8.0) for depth in (0.5, 1.0)),
    Scene("saturated", 1.0, (0.8, 0.5, 0.33), thickness=8.0),
    Scene("saturated", 1.0, depth=0.5, drag=1.0, thickness=8.0),
    *(Scene("rim", density, depth=depth, band=1.0) for density in (1.0, 0.98, 0.95) for depth in (0.5, 1.0)),
    Scene("rim", 1.0, (0.8, 0.5, 0.33), band=1.0),
    *(Scene("rim", density, depth=0.4, drag=2.0, band=1.0) for density in (1.0, 0.98)),
]


def walked(scene: Scene, radius: float, quality: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Density before and after in one frame, sigma at each point, and seconds of the processor."""
    push = scene.push(radius)
    before = push.grid.density.copy()
    began = time.process_time()
    out = (-1.0, 0.0, 0.0) if scene.verb == "pull" else None
    stress = [push.move_to(point, direction=out, quality=quality).stress for point in scene.path(radius)]
    seconds = time.process_time() - began
    after = push.grid.density[tuple(slice(-o, n - o) for o, n in zip(push.origin, before.shape, strict=True))]
    return before, after, np.array(stress), seconds


def measure(scene: Scene, radius: float) -> dict[str, tuple[float, float, float]]:
    """Error, error of sigma, and cost of each quality."""
    seconds: dict[str, float] = dict.fromkeys(QUALITIES, np.inf)
    ends = {}
    for _ in range(RUNS):
        for name in QUALITIES:
            before, after, stress, took = walked(scene, radius, name)
            seconds[name] = min(seconds[name], took)
            ends[name] = after, stress
    exact, felt = ends["exact"]
    moved = np.abs(exact.astype(np.float64) - before).sum()
    return {
        name: (
            float(np.abs(after.astype(np.float64) - exact).sum() / moved),
            float(np.sqrt(np.mean((stress - felt) ** 2)) / felt.max()),
            seconds[name] / seconds["exact"],
        )
        for name, (after, stress) in ends.items()
    }


def main(radii: list[float]) -> None:
    """Print all lines."""
    found: dict[tuple[str, str, float], list[tuple[float, float]]] = {}
    for radius in radii:
        for scene in SCENES:
            for name, (error, of_stress, cost) in measure(scene, radius).items():
                if name == "exact":
                    continue
                found.setdefault((scene.kind, name, radius), []).append((error, cost))
                told = f"R {radius:g} {scene.kind} {scene.density:g} along {scene.direction} {scene.depth:g} R"
                told += f" drag {scene.drag:g} R {scene.verb}"
                print(f"{told:70} {name:9} error {error:.4f} sigma {of_stress:.4f} cost {cost:.2f}", flush=True)
    for (kind, name, radius), rows in sorted(found.items()):
        error, cost = max(row[0] for row in rows), float(np.median([row[1] for row in rows]))
        print(f"{kind:13} {name:9} R {radius:<3g} worst error {error:.4f} median cost {cost:.2f}")


if __name__ == "__main__":
    main([float(word) for word in sys.argv[1:]] or [4.0, 8.0, 16.0, 32.0])
