# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture of a volume before and after, by Cycles on the CPU, without a window.

The surface of the body is shown as a mesh in clay: faster than a volume, its dents read better, and Blender builds
without volume rendering show it as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..core import DensityGrid

bpy.utils.expose_bundled_modules()
import openvdb  # noqa: E402  Blender's own module is found from here on

SIZE = (800, 680)
"""Width and height in pixels of each of the two pictures."""
SAMPLES = 16
LENS = 85.0
"""Millimetres on a 36 mm sensor: long enough not to bend the subject."""
FILL = 0.94
"""Share of the picture that the subject may take."""
CLAY = (0.50, 0.235, 0.145, 1.0)
BACKDROP = ((0.93, 0.92, 0.90), (0.70, 0.695, 0.69))
"""sRGB colours at the middle and in the corners."""
LIGHTS = {
    # name: (right, up, towards the camera) from the subject, strength in W/m2, colour, angle in radians.
    "key": ((-0.95, 0.50, 0.28), 4.6, (1.0, 0.93, 0.84), 0.10),  # grazes, so that a rim throws a shadow
    "fill": ((0.60, -0.25, 0.85), 1.0, (0.80, 0.88, 1.0), 0.8),
    "rim": ((0.80, 0.45, -0.85), 2.6, (0.90, 0.95, 1.0), 0.15),
}


def before_after(
    before: DensityGrid,
    after: DensityGrid,
    path: Path,
    towards: np.ndarray | None = None,
    low: np.ndarray | None = None,
    high: np.ndarray | None = None,
) -> None:
    """Render two volumes with one camera, side by side, into a .png of twice SIZE's width.

    ``towards`` (3,) points, in the world, from the material to the side to look from; None looks from the front.
    ``low`` and ``high`` are the corners, in voxels of ``before``, of what the camera is to keep in view and dwell on.
    Raises ValueError when there is no surface to show.
    """
    level = surface_level(before)
    meshes = [surface(grid, level) for grid in (before, after)]
    if not all(len(quads) for _, quads in meshes):
        raise ValueError(f"there is no picture to make: nothing is left of the surface of density {level:.3g}")
    with _studio() as scene:
        _frame(scene, meshes[0][0], before.transform, towards, low, high)
        pictures = [_rendered(scene, points, quads, path) for points, quads in meshes]
    _save(np.concatenate(pictures, axis=1), path)


def surface_level(grid: DensityGrid) -> float:
    """The density that is shown as the surface: half of what the densest hundredth of a volume has (clay: 1/2)."""
    return 0.5 * float(np.percentile(grid.density[grid.density > 0.0], 99))


def surface(grid: DensityGrid, level: float) -> tuple[np.ndarray, np.ndarray]:
    """The surface of density ``level``: points (n, 3) float32 in the world, and quads (m, 4) of their indices.

    The density is smoothed over two voxels first, for steps of one voxel catch grazing light.
    """
    low, high = _bounds(grid.density)
    low, high = np.maximum(low - 3, 0), high + 3
    part = grid.density[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    fog = openvdb.FloatGrid()
    fog.copyFromArray(_smoothed(np.pad(part, 3)), tolerance=0.0)
    points, quads = fog.convertToQuads(isovalue=level)
    points = points + (low - 3.0)
    world = points @ grid.transform[:3, :3].T + grid.transform[:3, 3]
    # OpenVDB takes what is below the iso value for the inside; density is the other way round.
    return world.astype(np.float32), np.ascontiguousarray(quads[:, ::-1])


def _bounds(density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half-open box of the voxels that hold anything."""
    low, high = [], []
    for axis in range(3):
        filled = np.flatnonzero(density.any(axis=tuple(a for a in range(3) if a != axis)))
        low.append(filled[0] if len(filled) else 0)
        high.append(filled[-1] + 1 if len(filled) else 1)
    return np.array(low), np.array(high)


def _smoothed(density: np.ndarray) -> np.ndarray:
    """Convolved twice with (1, 2, 1)/4 along each axis; the border stays, so it must be empty."""
    for axis in (0, 1, 2, 0, 1, 2):
        moved = np.moveaxis(density, axis, 0)
        inner = 0.25 * (moved[:-2] + moved[2:])
        inner += 0.5 * moved[1:-1]
        moved[1:-1] = inner
    return density


@contextmanager
def _studio() -> Iterator[bpy.types.Scene]:
    """A scene with lights, for as long as it is needed; nothing of it stays in the file."""
    before = {
        block: set(getattr(bpy.data, block))
        for block in ("objects", "meshes", "lights", "cameras", "materials", "images")
    }
    scene = bpy.data.scenes.new("Repoussé picture")
    world = bpy.data.worlds.new(scene.name)
    try:
        scene.world = world
        if world.node_tree is None:  # 4.5 makes a world without nodes
            world.use_nodes = True
        background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
        background.inputs["Color"].default_value = (0.55, 0.62, 0.72, 1.0)
        background.inputs["Strength"].default_value = 0.22
        _settings(scene)
        yield scene
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.worlds.remove(world)
        for name, blocks in before.items():
            made = getattr(bpy.data, name)
            for block in set(made) - blocks:
                made.remove(block)


def _settings(scene: bpy.types.Scene) -> None:
    import _cycles  # what this build of Blender can do; some have no denoiser

    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = SIZE
    render.resolution_percentage = 100
    render.film_transparent = True
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode = "RGBA"
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.cycles.device = "CPU"
    scene.cycles.samples = SAMPLES
    scene.cycles.use_adaptive_sampling = True
    scene.cycles.adaptive_threshold = 0.03
    scene.cycles.max_bounces = 2
    scene.cycles.use_denoising = _cycles.with_openimagedenoise


def _frame(
    scene: bpy.types.Scene,
    points: np.ndarray,
    transform: np.ndarray,
    towards: np.ndarray | None,
    low: np.ndarray | None,
    high: np.ndarray | None,
) -> None:
    """A camera on the side that was pushed, a little from above and aside, and lights that go with it."""
    outward = np.zeros(3) if towards is None else np.array(towards, np.float64)
    outward = outward / np.linalg.norm(outward) if outward.any() else np.array((0.0, -1.0, 0.0))
    up, front = np.array((0.0, 0.0, 1.0)), np.array((0.0, -1.0, 0.0))
    eye = outward + 0.7 * abs(outward[2]) * front  # what is pushed from above is seen from above and from the front
    right = np.cross(up, eye)
    right /= np.linalg.norm(right)
    view = eye + 0.3 * right + 0.15 * up
    view /= np.linalg.norm(view)
    right = np.cross(up, view)
    right /= np.linalg.norm(right)
    basis = np.stack([right, np.cross(view, right), view], axis=1)

    lens = bpy.data.cameras.new("Repoussé")
    lens.lens = LENS
    tangent = np.tan(0.5 * lens.angle) * FILL * np.array((1.0, SIZE[1] / SIZE[0]))
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    seen = (points - centre) @ basis
    distance = float(((np.abs(seen[:, :2]) / tangent).max(axis=1) + seen[:, 2]).max())
    if low is not None and high is not None:  # a small push in a large volume: go up to it, by half at most
        corners = np.array([low, high], dtype=np.float64) @ transform[:3, :3].T + transform[:3, 3]
        pushed = 0.5 * float(np.linalg.norm(corners[1] - corners[0]))
        share = min(1.0, max(0.55, 2.2 * pushed / (tangent[1] * distance)))
        centre = share * centre + (1.0 - share) * corners.mean(axis=0)
        distance *= share
    camera_matrix = np.eye(4)
    camera_matrix[:3, :3], camera_matrix[:3, 3] = basis, centre + distance * view
    lens.clip_start, lens.clip_end = 0.01 * distance, 100.0 * distance
    camera = bpy.data.objects.new("Repoussé", lens)
    camera.matrix_world = Matrix(camera_matrix.tolist())
    scene.collection.objects.link(camera)
    scene.camera = camera
    for name, (direction, strength, colour, angle) in LIGHTS.items():
        sun = bpy.data.lights.new(name, "SUN")
        sun.energy, sun.color, sun.angle = strength, colour, angle
        lamp = bpy.data.objects.new(name, sun)
        lamp.matrix_world = Vector(basis @ direction).to_track_quat("Z", "Y").to_matrix().to_4x4()
        scene.collection.objects.link(lamp)


def _clay() -> bpy.types.Material:
    clay = bpy.data.materials.new("Repoussé clay")
    if clay.node_tree is None:
        clay.use_nodes = True
    shader = next(node for node in clay.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = CLAY
    shader.inputs["Roughness"].default_value = 0.52
    shader.inputs["Specular IOR Level"].default_value = 0.35
    return clay


def _rendered(scene: bpy.types.Scene, points: np.ndarray, quads: np.ndarray, beside: Path) -> np.ndarray:
    """One picture: (height, width, 3) float32 in sRGB, on the backdrop."""
    mesh = bpy.data.meshes.new("Repoussé")
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", points.ravel())
    mesh.loops.add(quads.size)
    mesh.loops.foreach_set("vertex_index", quads.astype(np.int32).ravel())
    mesh.polygons.add(len(quads))
    mesh.polygons.foreach_set("loop_start", np.arange(0, quads.size, 4, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.shade_smooth()
    mesh.materials.append(_clay())
    subject = bpy.data.objects.new("Repoussé", mesh)
    scene.collection.objects.link(subject)
    part = beside.absolute().with_name(f".{uuid4().hex[:8]}.png")
    try:
        scene.render.filepath = str(part)
        bpy.ops.render.render(write_still=True, scene=scene.name)
        pixels = _pixels_of(part)
    except RuntimeError as error:
        raise ValueError(f"Blender cannot render: {' '.join(str(error).split())}") from error
    finally:
        part.unlink(missing_ok=True)
        bpy.data.meshes.remove(mesh)  # and the object that shows it
    opacity = pixels[..., 3:]
    return pixels[..., :3] * opacity + _backdrop() * (1.0 - opacity)


def _pixels_of(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path))
    try:
        width, height = image.size
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)


def _backdrop() -> np.ndarray:
    across, up = (np.linspace(-1.0, 1.0, pixels, dtype=np.float32) for pixels in SIZE)
    share = (0.5 * (up[:, None] ** 2 + across[None, :] ** 2))[..., None]
    middle, corners = np.array(BACKDROP, np.float32)
    return middle * (1.0 - share) + corners * share


def _save(picture: np.ndarray, path: Path) -> None:
    height, width, _ = picture.shape
    image = bpy.data.images.new("Repoussé", width, height)
    try:
        image.pixels.foreach_set(np.dstack([picture, np.ones((height, width), np.float32)]).ravel())
        image.filepath_raw, image.file_format = str(path.absolute()), "PNG"
        image.save()
    finally:
        bpy.data.images.remove(image)
