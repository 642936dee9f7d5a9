# SPDX-License-Identifier: GPL-3.0-or-later
"""The tree of paper figure 5: strokes that sculpt it from a block, recorded as files, and their replay.

`python tests/bench/tree.py` records them anew into tests/bench/strokes. Nothing is cut away: each pass begins at the
tree's surface and pushes what is outside it over the border of the block, as a hand would with a ball and a finger.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from repousse.core import CapsuleTool, DensityGrid, Material, Sample, SphereTool, Stroke

STROKES = Path(__file__).with_name("strokes")
SHAPE, DENSITY = (128, 128, 150), 0.5
GROUND = 13.0
AXIS = np.array([63.5, 63.5])
CROWN = np.array([63.5, 63.5, 100.0])
CROWN_BALLS = np.array(
    [
        # x, y, z of its middle from CROWN, and its radius
        (0, 0, 8, 25),
        (20, 6, -4, 19),
        (-19, 9, -6, 18),
        (4, -21, -7, 19),
        (-4, 21, 0, 18),
        (15, -15, 11, 17),
        (-17, -13, 8, 17),
        (12, 15, 17, 16),
        (-10, 8, 22, 16),
        (2, -8, 26, 15),
        (27, -12, -12, 12),
        (-26, -12, -15, 12),
        (-12, 27, -16, 11),
        (22, 22, -10, 13),
    ],
    dtype=np.float64,
)
BRANCHES = ((20, 6, -4), (-19, 9, -6), (4, -21, -7), (-4, 21, 0), (27, -12, -12), (-26, -12, -15))
FORK = 62.0
"""Height at which the branches leave the trunk."""
CLAY = Material(full_force=0.9, yield_ratio=0.02)


def distance(points: np.ndarray) -> np.ndarray:
    """Signed distance of points (..., 3) from the tree and its ground, in voxels, negative inside."""
    x, y, z = np.moveaxis(points, -1, 0)
    trunk = np.hypot(x - AXIS[0], y - AXIS[1]) - 6.0 - 7.0 * np.exp(-np.maximum(z - GROUND, 0.0) / 7.0)
    parts = [z - GROUND, np.maximum(trunk, z - CROWN[2])]
    for *offset, radius in CROWN_BALLS:
        parts.append(np.linalg.norm(points - CROWN - offset, axis=-1) - radius)
    root = np.array([*AXIS, FORK])
    for offset in BRANCHES:
        way = CROWN + offset - root
        along = np.clip((points - root) @ way / (way @ way), 0.0, 1.0)
        parts.append(np.linalg.norm(points - root - along[..., None] * way, axis=-1) - 5.0 + 2.0 * along)
    return np.min(parts, axis=0)


def outward(start: np.ndarray, heading: np.ndarray, radius: float) -> np.ndarray | None:
    """Poses (n, 3) from where a ball of ``radius`` last touches the tree on its way out of the block, to outside it."""
    ways = np.arange(0.0, 140.0, 0.25)
    points = start + ways[:, None] * heading
    left = np.abs(points - (np.array(SHAPE) - 1) / 2) - np.array(SHAPE) / 2
    end = int(np.argmax(left.max(axis=1) > radius + 1.0))
    touching = np.nonzero(distance(points[: end + 1]) < radius)[0]
    begin = int(touching[-1]) + 1 if len(touching) else 0
    if begin >= end:
        return None
    count = int(np.ceil((end - begin) * 0.25 / (1.6 * radius))) + 1  # a longer jump would lift the tool
    return points[np.round(np.linspace(begin, end, count)).astype(int)]


def around(height: float, count: int, turn: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(start, heading) of level rays from the axis."""
    for angle in 2 * np.pi * (np.arange(count) + turn) / count:
        yield np.array([*AXIS, height]), np.array([np.cos(angle), np.sin(angle), 0.0])


def over(low: float, high: float, count: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(start, heading) of rays from the crown's middle, those of ``count`` spread evenly that rise from low to high."""
    for n in range(count):
        rise = 1.0 - 2.0 * (n + 0.5) / count
        if low <= rise < high:
            angle, level = n * np.pi * (3.0 - np.sqrt(5.0)), np.sqrt(1.0 - rise * rise)
            yield CROWN, np.array([level * np.cos(angle), level * np.sin(angle), rise])


def stroke_of(tool, passes) -> Stroke:
    """One stroke of several passes: the way to the next is longer than the tool, so it is lifted between them."""
    samples, seconds = [], 0.0
    for poses in passes:
        for number, pose in enumerate(poses):
            seconds += 0.3 if number == 0 else float(np.linalg.norm(pose - poses[number - 1])) / 100.0
            samples.append(Sample(round(seconds, 3), tuple(np.round(pose, 2).tolist())))
    return Stroke(samples, tool=tool, material=CLAY, border="open")


def strokes() -> Iterator[tuple[str, Stroke]]:
    """The strokes by name, in the order in which they are pushed."""
    tall = (SHAPE[2] - GROUND) / 2
    finger = CapsuleTool((0.0, 0.0, tall), 11.0)
    for corner in range(4):
        passes = []
        for turn in (-0.30, -0.15, 0.0, 0.15, 0.30):
            angle = np.pi / 4 + corner * np.pi / 2 + turn
            heading = np.array([np.cos(angle), np.sin(angle), 0.0])
            ways = 60.0 + np.arange(0.0, 52.0, 16.0)
            passes.append(np.array([*AXIS, GROUND + 12.0 + tall]) + ways[:, None] * heading)
        yield f"corner-{corner}", stroke_of(finger, passes)
    ball = SphereTool(7.0)
    for level, height in enumerate(np.arange(GROUND + 7.0, CROWN[2] + 4.0, 6.5)):
        passes = [outward(start, heading, 7.0) for start, heading in around(height, 32, 0.5 * (level % 2))]
        yield f"round-{level:02d}", stroke_of(ball, [p for p in passes if p is not None])
    rises = np.linspace(1.0, -0.05, 9)
    for band, (high, low) in enumerate(pairwise(rises.tolist())):
        passes = [outward(start, heading, 7.0) for start, heading in over(low, high + 1e-9, 900)]
        yield f"crown-{band}", stroke_of(ball, [p for p in passes if p is not None])
    yield from _clearing()
    yield "leaves", _leaves()


def _clearing() -> Iterator[tuple[str, Stroke]]:
    """A larger ball pushes out the crumbs that the passes left between them."""
    large = SphereTool(12.0)
    for level, height in enumerate(np.arange(GROUND + 12.0, CROWN[2] + 6.0, 13.0)):
        passes = [outward(start, heading, 12.0) for start, heading in around(height, 26, 0.0)]
        yield f"clear-{level}", stroke_of(large, [p for p in passes if p is not None])
    for band, (low, high) in enumerate(((0.65, 1.0), (0.35, 0.65), (0.0, 0.35))):
        passes = [outward(start, heading, 12.0) for start, heading in over(low, high, 300)]
        yield f"clear-above-{band}", stroke_of(large, [p for p in passes if p is not None])


def _leaves() -> Stroke:
    """Pokes of several sizes into the crown; a sample carries the radius of its ball."""
    random, samples = np.random.default_rng(5), []
    for number, (start, heading) in enumerate(over(-0.75, 1.0, 330)):
        heading = heading + random.normal(0.0, 0.09, 3)
        heading /= np.linalg.norm(heading)
        radius = round(float(random.uniform(2.5, 5.0)), 1)
        ways = np.arange(75.0, 0.0, -0.25)
        at = ways[int(np.argmax(distance(start + ways[:, None] * heading) < radius))]
        for part, way in enumerate((at + 1.0, at - random.uniform(0.5, 2.6))):
            pose = tuple(np.round(start + way * heading, 2).tolist())
            samples.append(Sample(round(0.3 * number + 0.1 * part, 3), pose, radius=radius))
    return Stroke(samples, tool=SphereTool(3.0), material=CLAY, border="open")


def record() -> int:
    """Write the files anew; returns how many."""
    STROKES.mkdir(exist_ok=True)
    for former in STROKES.glob("tree-*.jsonl"):
        former.unlink()
    count = 0
    for count, (name, stroke) in enumerate(strokes(), start=1):
        stroke.save(STROKES / f"tree-{count:02d}-{name}.jsonl")
    return count


def block() -> DensityGrid:
    """The block that the strokes are for."""
    return DensityGrid(np.full(SHAPE, DENSITY, np.float32))


def replay(grid: DensityGrid) -> Iterator[tuple[str, Stroke, list]]:
    """Push every recorded stroke into ``grid``, in order: (name, stroke, contacts) after each."""
    for path in sorted(STROKES.glob("tree-*.jsonl")):
        stroke = Stroke.load(path)
        yield path.stem, stroke, stroke.push(grid).follow(stroke)


if __name__ == "__main__":
    print(f"{record()} strokes recorded in {STROKES}")
