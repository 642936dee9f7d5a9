# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh to Clay: the inside of the active mesh as clay."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ..core import DensityGrid
from ..core.formats import MAX_VOXELS
from .clay_choice import ClayChoice
from .memory import draw_memory
from .volumes import add_volume

bpy.utils.expose_bundled_modules()
import openvdb  # noqa: E402  Blender's own module is found from here on

MARGIN = 2
"""Empty voxels around the mesh: as far as the partly filled voxels of its surface reach, and one more."""


def voxels_for(extent: np.ndarray, resolution: int) -> tuple[float, np.ndarray]:
    """Edge of a voxel in the units of ``extent`` (3,), and the (3,) voxels of the grid around something so large."""
    voxel = float(np.max(extent)) / (resolution - 2 * MARGIN)
    return voxel, np.ceil(extent / voxel).astype(int) + 2 * MARGIN


def clay_from_mesh(
    points: np.ndarray, triangles: np.ndarray, resolution: int, density: float = 1.0, cube: bool = False
) -> DensityGrid:
    """Fill a closed mesh.

    Parameters
    ----------
    points
        (n, 3) in world units; the grid's axes are theirs.
    triangles
        (m, 3) indices of points.
    resolution
        Voxels along the grid's longest side.
    density
        Inside, in [0, 1]. A voxel on the surface has its share of it, clamp(1/2 - signed distance / voxel).
    cube
        Make the grid as many voxels wide along every axis.

    Raises
    ------
    ValueError
        When the mesh has no extent, would take too many voxels, or encloses nothing as wide as a voxel.
    """
    if not len(triangles):
        raise ValueError("the mesh has no faces")
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    longest = float((high - low).max())
    if not (np.isfinite(longest) and longest > 0.0):
        raise ValueError("the mesh has no extent, or points that are not finite")
    voxel, shape = voxels_for(high - low, resolution)
    if cube:
        shape[:] = resolution
    if shape.prod(dtype=float) > MAX_VOXELS:
        raise ValueError(f"{' x '.join(map(str, shape))} voxels are too many: choose a lower resolution")
    first = 0.5 * (low + high) - 0.5 * (shape - 1) * voxel  # centre of the first voxel
    # In voxels, so that OpenVDB's float32 points are as fine at any scale.
    surface = openvdb.FloatGrid.createLevelSetFromPolygons(
        np.ascontiguousarray((points - first) / voxel, np.float32), triangles=np.ascontiguousarray(triangles, np.uint32)
    )
    distance = np.empty(tuple(shape), np.float32)
    surface.copyToArray(distance)
    filled = np.clip(0.5 - distance, 0.0, 1.0, out=distance)
    if filled.max() < 1.0:
        raise ValueError("the mesh encloses nothing as wide as a voxel: close its holes, or choose a higher resolution")
    filled *= density
    transform = np.diag([voxel, voxel, voxel, 1.0])
    transform[:3, 3] = first
    return DensityGrid(filled, transform, copy=False)


def triangles_of(
    meshed: bpy.types.Object, context: bpy.types.Context, frame: Matrix
) -> tuple[np.ndarray, np.ndarray, int]:
    """Points (n, 3) of an object with its modifiers, in ``frame``; triangles (m, 3); how many edges are open."""
    evaluated = meshed.evaluated_get(context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    try:
        points = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", points)
        mesh.calc_loop_triangles()
        triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
        mesh.loop_triangles.foreach_get("vertices", triangles)
        edges = np.empty(len(mesh.loops), np.int32)
        mesh.loops.foreach_get("edge_index", edges)
    finally:
        evaluated.to_mesh_clear()
    place = np.array(frame.inverted() @ meshed.matrix_world)
    points = points.reshape(-1, 3) @ place[:3, :3].T + place[:3, 3]
    return points, triangles.reshape(-1, 3), int(np.count_nonzero(np.bincount(edges) == 1))


class REPOUSSE_OT_mesh_to_clay(ClayChoice, bpy.types.Operator):
    bl_idname = "repousse.mesh_to_clay"
    bl_label = "Mesh to Clay"
    bl_description = "Fill the active mesh, with its modifiers, with clay. The mesh stays, hidden"
    bl_options = {"REGISTER", "UNDO"}

    resolution: bpy.props.IntProperty(
        name="Resolution", description="Voxels along the longest side", default=128, min=16, max=800, soft_max=512
    )
    hide_mesh: bpy.props.BoolProperty(
        name="Hide Mesh", description="Hide the mesh in the viewport and in renders", default=True
    )

    @classmethod
    def poll(cls, context):
        active = context.active_object
        if active is None or active.type != "MESH" or context.mode != "OBJECT":
            cls.poll_message_set("Select a mesh in object mode")
            return False
        return True

    def invoke(self, context, _event):
        self.take_settings(context)
        return context.window_manager.invoke_props_dialog(self)

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "resolution")
        self.draw_clay(layout)
        layout.prop(self, "hide_mesh")
        extent = np.array(context.active_object.dimensions)
        if extent.any():
            voxel, shape = voxels_for(extent, self.resolution)
            draw_memory(layout, context, shape, voxel)

    def execute(self, context):
        meshed = context.active_object
        # Location and rotation go to the new object; the scale goes into the voxels, which must stay cubes.
        location, rotation, _ = meshed.matrix_world.decompose()
        frame = Matrix.LocRotScale(location, rotation, None)
        try:
            points, triangles, open_edges = triangles_of(meshed, context, frame)
            grid = clay_from_mesh(points, triangles, self.resolution, self.asked_density)
            grid.metadata |= {"source": meshed.name, "material": self.material}
            add_volume(context, grid, f"{meshed.name} Clay", frame)
        except (ValueError, MemoryError) as error:
            self.report({"ERROR"}, f"{meshed.name}: {error or 'not enough memory: choose a lower resolution'}")
            return {"CANCELLED"}
        if open_edges:
            self.report({"WARNING"}, f"{meshed.name}: {open_edges} open edges; holes wider than a voxel may be hollow")
        if self.hide_mesh:
            meshed.hide_set(True)
            meshed.hide_render = True
        return {"FINISHED"}


def register():
    bpy.utils.register_class(REPOUSSE_OT_mesh_to_clay)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_OT_mesh_to_clay)
