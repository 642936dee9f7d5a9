# SPDX-License-Identifier: GPL-3.0-or-later
"""Add > Volume > Clay Block: a cube of clay to begin with."""

import bpy
import numpy as np
from mathutils import Matrix

from ..core import DensityGrid
from .clay_choice import ClayChoice
from .memory import draw_memory
from .volumes import add_volume


class REPOUSSE_OT_new_clay_block(ClayChoice, bpy.types.Operator):
    bl_idname = "repousse.new_clay_block"
    bl_label = "New Clay Block"
    bl_description = "Add a cube of clay at the 3D cursor"
    bl_options = {"REGISTER", "UNDO"}

    resolution: bpy.props.IntProperty(
        name="Resolution", description="Voxels along each edge", default=128, min=8, max=800, soft_max=512
    )
    size: bpy.props.FloatProperty(
        name="Size", description="Length of each edge, in metres", default=2.0, min=1e-4, soft_max=100.0, unit="LENGTH"
    )

    def invoke(self, context, _event):
        self.take_settings(context)
        return context.window_manager.invoke_props_dialog(self)

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "resolution")
        layout.prop(self, "size")
        self.draw_clay(layout)
        draw_memory(layout, context, (self.resolution,) * 3, self.size / self.resolution)

    def execute(self, context):
        voxel = self.size / self.resolution
        transform = np.diag([voxel, voxel, voxel, 1.0])
        transform[:3, 3] = 0.5 * (voxel - self.size)  # the block's middle is the object's origin
        try:
            full = np.full((self.resolution,) * 3, self.asked_density, np.float32)
            grid = DensityGrid(full, transform, metadata={"material": self.material}, copy=False)
            add_volume(context, grid, "Clay", Matrix.Translation(context.scene.cursor.location))
        except (ValueError, MemoryError) as error:
            self.report({"ERROR"}, str(error) or "There is not enough memory: choose a lower resolution")
            return {"CANCELLED"}
        return {"FINISHED"}


def _menu(self, _context):
    self.layout.operator(REPOUSSE_OT_new_clay_block.bl_idname, text="Clay Block", icon="MESH_CUBE")


def register():
    bpy.utils.register_class(REPOUSSE_OT_new_clay_block)
    bpy.types.VIEW3D_MT_volume_add.append(_menu)


def unregister():
    bpy.types.VIEW3D_MT_volume_add.remove(_menu)
    bpy.utils.unregister_class(REPOUSSE_OT_new_clay_block)
