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

OUT = Path("out")
RESOLUTION = 256
CLAY = PRESETS["clay"]
SURFACE = 0.5
"""Density from which on a voxel belongs to the body."""
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


def outward_of(grid: DensityGrid) -> np.ndarray:
    """The unit vector, along an axis of the grid, from the body to its broadest side."""
    low, high = _box(grid)
    axis = int(np.argmin((high - low) * (1.0, 0.999, 1.001)))  # a cube is pushed from the front
    return np.eye(3)[axis] * (-1.0 if axis == 1 else 1.0)


def strokes_on(grid: DensityGrid, outward: np.ndarray, radius: float, middle: np.ndarray) -> dict[str, Stroke]:
    """A press and a drag beside each other on the side of the body that looks ``outward``, around a ray to ``middle``.

    All lengths in voxels. Raises ValueError when the body is not under both.
    """
    up = np.array((0.0, 0.0, 1.0)) if abs(outward[2]) < 0.99 else np.array((0.0, 1.0, 0.0))
    right = np.cross(up, outward)
    right /= np.linalg.norm(right)
    up = np.cross(outward, right)

    def surface(across: np.ndarray, above: np.ndarray) -> np.ndarray:
        """Points (n, 3) of the surface seen from outside, at distances in radii from the middle."""
        return _hits(grid, middle + radius * (across[:, None] * right + above[:, None] * up), outward)

    def pressed(points: np.ndarray, depth: float) -> np.ndarray:
        """Where the tool's centre is to be for its tip to be ``depth`` radii under points of the surface."""
        return points + (1.0 - depth) * radius * outward

    press = pressed(surface(np.array([-2.2]), np.array([-0.1])), 0.7)
    clear = (0.7 * radius + CLEAR) * outward
    path = surface(np.linspace(-0.1, 2.4, 60), np.linspace(-0.5, 0.3, 60) + 0.3 * np.sin(np.linspace(0.0, np.pi, 60)))
    ends = np.pad(path, ((10, 10), (0, 0)), mode="edge")
    path = np.array([ends[n : n + 21].mean(axis=0) for n in range(len(path))])  # a hand does not follow each voxel
    drag = pressed(path, 0.45)
    lift = (0.45 * radius + CLEAR) * outward
    return {
        "dent": _stroke([press[0] + clear, press[0], press[0] + clear], radius),
        "groove": _stroke([drag[0] + lift, *drag, drag[-1] + lift], radius),
    }


def _stroke(corners: list[np.ndarray], radius: float) -> Stroke:
    samples = [Sample(0.01 * n, tuple(corner.tolist())) for n, corner in enumerate(corners)]
    band = CLAY.band * radius
    return Stroke(samples, SphereTool(radius), CLAY.material, band=band, continuous=True).resample(STEP)


def _hits(grid: DensityGrid, points: np.ndarray, outward: np.ndarray) -> np.ndarray:
    """First voxels of the body on the way from outside through each of ``points`` (n, 3), as positions (n, 3)."""
    far = float(np.linalg.norm(grid.shape))
    hits = []
    for point in points:
        way = point + np.arange(far, -far, -0.25)[:, None] * outward
        voxels = np.rint(way).astype(int)
        inside = ((voxels >= 0) & (voxels < grid.shape)).all(axis=1)
        dense = np.flatnonzero(grid.density[tuple(voxels[inside].T)] >= SURFACE)
        if len(dense):
            hits.append(way[inside][dense[0]])
    if len(hits) < len(points):
        raise ValueError("the body is too slender for a dent and a groove beside each other")
    return np.array(hits)


def _box(grid: DensityGrid) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest voxel of the body."""
    body = grid.density >= SURFACE
    if not body.any():
        raise ValueError(f"no voxel is as dense as {SURFACE}")
    filled = [np.flatnonzero(body.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    return np.array([f[0] for f in filled], float), np.array([f[-1] for f in filled], float)


def main() -> int:
    """Exit code of the push; 2 with one line on stderr for an input that cannot be used."""
    began = time.perf_counter()
    OUT.mkdir(exist_ok=True)
    try:
        if len(sys.argv) > 1:
            source = Path(sys.argv[1])
            grid = cli.open_volume(source)
            outward = outward_of(grid)
            low, high = _box(grid)
            middle, radius = 0.5 * (low + high), max(3.0, 0.055 * float((high - low).max()))
        else:
            source, grid = OUT / "suzanne.vdb", suzanne()
            write_volume(grid, source)
            outward = np.array((0.0, -0.68, 0.73))
            outward /= np.linalg.norm(outward)
            radius, middle = 16.0, np.array((124.0, 120.0, 178.0))
        command = ["push", str(source)]
        for name, stroke in strokes_on(grid, outward, radius, middle).items():
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
