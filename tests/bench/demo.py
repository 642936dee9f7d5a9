# SPDX-License-Identifier: GPL-3.0-or-later
"""make demo [INPUT=FILE]: a dent and a groove with their rims, in Suzanne or in any volume.

Leaves in out/: demo.vdb, demo.png (before, after), demo.json and the two strokes; and Suzanne as clay.
"""

import sys
import time
from pathlib import Path

import bpy
import numpy as np

from repousse.core import PRESETS, DensityGrid, Sample, SphereTool, Stroke
from repousse.core.formats import write_volume
from repousse.operators import cli
from repousse.operators.mesh_to_clay import clay_from_mesh, triangles_of
from repousse.operators.render import surface_level

OUT = Path("out")
RESOLUTION = 256
CLAY = PRESETS["clay"]
STEP = 0.5
CLEAR = 2.0
"""Voxels between tool and surface at a stroke's ends."""


def suzanne() -> DensityGrid:
    """Blender's monkey, smooth and solid, looking along -Y from RESOLUTION^3 voxels."""
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.mesh.primitive_monkey_add()
    monkey = bpy.context.object
    monkey.modifiers.new("Smooth", "SUBSURF").levels = 3
    points, triangles, _ = triangles_of(monkey, bpy.context, monkey.matrix_world)
    grid = clay_from_mesh(points, triangles, RESOLUTION, CLAY.density, cube=True)
    grid.metadata["source"] = "Suzanne"
    return grid


def broad_side(grid: DensityGrid, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Where a dent and a groove beside each other have room.

    On the side that the body is broadest on, the place that is most wholly covered, and of these the most even one.
    Returns the unit vectors outward and from dent to groove, a point between them, and the tool's radius, in voxels.
    """
    body = grid.density >= level
    filled = [np.flatnonzero(body.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    edges = np.array([f[-1] - f[0] + 1 for f in filled])
    axis = 1 if edges[1] <= edges.min() * 1.1 else int(edges.argmin())  # from the front where that is as good
    sign = -1 if axis == 1 else 1
    radius = max(3.0, 0.055 * float(edges.max()))
    seen = np.moveaxis(body, axis, 0)[::-sign]
    covered, depth = seen.any(axis=0), seen.argmax(axis=0).astype(float)
    found = []
    for turned, sizes in enumerate(((6.5, 3.0), (3.0, 6.5))):
        window = np.minimum(covered.shape, np.array(sizes) * radius).astype(int)
        share = _window_sum(covered, window) / window.prod()
        mean, square = (
            _window_sum(d * covered, window) / np.maximum(share * window.prod(), 1) for d in (depth, depth**2)
        )
        unfit = square - mean**2 - 1e6 * np.floor(20.0 * share)
        best = np.unravel_index(unfit.argmin(), unfit.shape)
        found.append((unfit[best], turned, best + window / 2))
    _, turned, place = min(found, key=lambda one: one[0])
    across = [a for a in range(3) if a != axis]
    middle = np.zeros(3)
    middle[across], middle[axis] = place, filled[axis].mean()
    return sign * np.eye(3)[axis], np.eye(3)[across[turned]], middle, radius


def _window_sum(values: np.ndarray, window: tuple[int, int]) -> np.ndarray:
    """Sums over all windows of this size that lie in a plane of values."""
    sums = np.pad(values.astype(np.float64), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    a, b = window
    return sums[a:, b:] - sums[:-a, b:] - sums[a:, :-b] + sums[:-a, :-b]


def strokes_on(
    grid: DensityGrid, level: float, outward: np.ndarray, right: np.ndarray, middle: np.ndarray, radius: float
) -> dict[str, Stroke]:
    """A press and, to the ``right`` of it, a drag on the side that looks ``outward``, around a ray to ``middle``.

    All lengths in voxels; the body is what is as dense as ``level``. Raises ValueError when it is not there.
    """
    up = np.cross(outward, right)

    def surface(across: np.ndarray, above: np.ndarray) -> np.ndarray:
        """Points (n, 3) of the surface seen from outside, at distances in radii from the middle."""
        points = middle + radius * (across[:, None] * right + above[:, None] * up)
        return _hits(grid, level, points, outward, 1.2 * radius)

    def pressed(points: np.ndarray, depth: float) -> np.ndarray:
        """Where the tool's centre is to be for its tip to be ``depth`` radii under points of the surface."""
        return points + (1.0 - depth) * radius * outward

    groove = np.linspace(0.0, 1.0, 60)
    across = np.append(-2.2, -0.1 + 2.5 * groove)
    above = np.append(-0.1, -0.5 + 0.8 * groove + 0.3 * np.sin(np.pi * groove))
    touched = surface(across, above)
    press, clear = pressed(touched[0], 0.7), (0.7 * radius + CLEAR) * outward
    path = np.pad(touched[1:], ((10, 10), (0, 0)), mode="edge")
    path = np.array([path[n : n + 21].mean(axis=0) for n in range(len(groove))])  # a hand does not follow each voxel
    drag, lift = pressed(path, 0.45), (0.45 * radius + CLEAR) * outward
    return {
        "dent": _stroke([press + clear, press, press + clear], radius),
        "groove": _stroke([drag[0] + lift, *drag, drag[-1] + lift], radius),
    }


def _stroke(corners: list[np.ndarray], radius: float) -> Stroke:
    samples = [Sample(0.01 * n, tuple(corner.tolist())) for n, corner in enumerate(corners)]
    band = CLAY.band * radius
    return Stroke(samples, SphereTool(radius), CLAY.material, band=band, continuous=True).resample(STEP)


def _hits(grid: DensityGrid, level: float, points: np.ndarray, outward: np.ndarray, gap: float) -> np.ndarray:
    """Where the ways from outside through each of ``points`` (n, 3) meet the body; over a gap, as high as beside it.

    A gap is also what lies more than ``gap`` voxels higher or lower than the most.
    """
    far = float(np.linalg.norm(grid.shape))
    reach = np.arange(far, -far, -0.25)
    heights = np.full(len(points), np.nan)
    for n, point in enumerate(points):
        voxels = np.rint(point + reach[:, None] * outward).astype(int)
        inside = np.flatnonzero(((voxels >= 0) & (voxels < grid.shape)).all(axis=1))
        dense = np.flatnonzero(grid.density[tuple(voxels[inside].T)] >= level)
        if len(dense):
            heights[n] = reach[inside[dense[0]]]
    if not np.isfinite(heights).any():
        raise ValueError("the body is too slender for a dent and a groove beside each other")
    found = np.flatnonzero(np.abs(heights - np.nanmedian(heights)) <= gap)
    heights = np.interp(np.arange(len(points)), found, heights[found])
    return points + heights[:, None] * outward


def main() -> int:
    """Exit code of the push; 2 with one line on stderr for an input that cannot be used."""
    began = time.perf_counter()
    OUT.mkdir(exist_ok=True)
    try:
        if len(sys.argv) > 1:
            source = Path(sys.argv[1])
            grid = cli.open_volume(source)
            level = surface_level(grid)
            side = broad_side(grid, level)
        else:
            source, grid = OUT / "suzanne.vdb", suzanne()
            write_volume(grid, source)
            level = 0.5 * CLAY.density
            forehead = np.array((0.0, -0.68, 0.73))
            side = forehead / np.linalg.norm(forehead), np.array((1.0, 0.0, 0.0)), np.array((124.0, 120.0, 178.0)), 16.0
        command = ["push", str(source)]
        for name, stroke in strokes_on(grid, level, *side).items():
            path = OUT / f"demo_{name}.jsonl"
            stroke.began_on(grid).save(path)
            command += ["--stroke", str(path)]
    except (ValueError, OSError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return cli.EXIT_BAD_INPUT
    for option, suffix in (("--out", "vdb"), ("--render", "png"), ("--report", "json")):
        command += [option, str(OUT / f"demo.{suffix}")]
    code = cli.main(command)
    if code == 0:
        print(f"{OUT}/demo.png shows it before and after; {time.perf_counter() - began:.0f} s in all")
    return code


if __name__ == "__main__":
    sys.exit(main())
