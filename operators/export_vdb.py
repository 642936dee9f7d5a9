# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Export > Repoussé Volume: the active volume as a .vdb of its own."""

import bpy
from bpy_extras.io_utils import ExportHelper

from ..core.formats import write_volume
from .volumes import OnActiveVolume, active_volume, density_of, place_in_world


class REPOUSSE_OT_export_vdb(OnActiveVolume, bpy.types.Operator, ExportHelper):
    bl_idname = "repousse.export_vdb"
    bl_label = "Export VDB"
    bl_description = "Write the active volume to a .vdb file"
    bl_options = {"REGISTER"}

    filename_ext = ".vdb"
    filter_glob: bpy.props.StringProperty(default="*.vdb", options={"HIDDEN"})
    use_world: bpy.props.BoolProperty(
        name="Place in World", description="Write the object's place and size into the file", default=True
    )
    half: bpy.props.BoolProperty(
        name="Half Precision", description="Half the file's size: 11 bits of density in place of 24", default=False
    )

    def execute(self, context):
        active = active_volume(context)
        try:
            grid = density_of(active.data)
            if self.use_world:
                grid = place_in_world(grid, active.matrix_world)
            write_volume(grid, self.filepath, half=self.half)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


def _menu(self, _context):
    self.layout.operator(REPOUSSE_OT_export_vdb.bl_idname, text="Repoussé Volume (.vdb)")


def register():
    bpy.utils.register_class(REPOUSSE_OT_export_vdb)
    bpy.types.TOPBAR_MT_file_export.append(_menu)


def unregister():
    bpy.types.TOPBAR_MT_file_export.remove(_menu)
    bpy.utils.unregister_class(REPOUSSE_OT_export_vdb)
