# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Import > Repoussé Volume: a .pvm or .vdb as a volume object that can be sculpted."""

from pathlib import Path

import bpy
from bpy_extras.io_utils import ImportHelper

from ..core.formats import FormatError, list_grids, read_volume
from .volumes import add_volume


def _grids_in_file(self, _context, _typed):
    """Asked for by Blender when the field is opened, not while it is drawn."""
    try:
        return [grid.key for grid in list_grids(self.filepath) if grid.readable]
    except FormatError:
        return []


class REPOUSSE_OT_import_volume(bpy.types.Operator, ImportHelper):
    bl_idname = "repousse.import_volume"
    bl_label = "Import Volume"
    bl_description = "Read a volume from a .pvm or .vdb file as density from 0, empty, to 1, full"
    bl_options = {"REGISTER", "UNDO"}

    filename_ext = ".pvm"
    filter_glob: bpy.props.StringProperty(default="*.pvm;*.vdb", options={"HIDDEN"})
    grid: bpy.props.StringProperty(
        name="Grid",
        description="Which grid of a .vdb file; empty takes the one named density, else the first",
        search=_grids_in_file,
    )
    use_window: bpy.props.BoolProperty(
        name="Window",
        description="Choose which values become empty and full. Otherwise the file's own range is taken",
    )
    window_low: bpy.props.FloatProperty(
        name="Empty",
        description="The value, in the file's units, that becomes density 0. In a CT scan that of air, which is not 0",
        default=0.0,
        soft_min=-1000.0,
        soft_max=4000.0,
    )
    window_high: bpy.props.FloatProperty(
        name="Full",
        description="The value, in the file's units, that becomes density 1; below Empty it inverts the volume",
        default=255.0,
        soft_min=-1000.0,
        soft_max=4000.0,
    )

    def invoke(self, context, event):
        if self.properties.is_property_set("filepath"):  # dropped into the window
            return context.window_manager.invoke_props_dialog(self)
        return super().invoke(context, event)

    def draw(self, _context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "grid")
        layout.prop(self, "use_window")
        ends = layout.column(align=True)
        ends.active = self.use_window
        ends.prop(self, "window_low")
        ends.prop(self, "window_high")

    def execute(self, context):
        window = (self.window_low, self.window_high) if self.use_window else None
        try:
            grid = read_volume(self.filepath, self.grid or None, window)
            grid.name = grid.name or "density"  # a shader finds a grid by its name
            add_volume(context, grid, Path(self.filepath).stem)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for note in grid.notes:
            self.report({"INFO"}, note)
        return {"FINISHED"}


class REPOUSSE_FH_volume(bpy.types.FileHandler):
    bl_idname = "REPOUSSE_FH_volume"
    bl_label = "PVM volume"
    bl_import_operator = REPOUSSE_OT_import_volume.bl_idname
    bl_file_extensions = ".pvm"  # a dropped .vdb is Blender's own

    @classmethod
    def poll_drop(cls, context):
        return context.area is not None and context.area.type == "VIEW_3D"


def _menu(self, _context):
    self.layout.operator(REPOUSSE_OT_import_volume.bl_idname, text="Repoussé Volume (.pvm, .vdb)")


def register():
    bpy.utils.register_class(REPOUSSE_OT_import_volume)
    bpy.utils.register_class(REPOUSSE_FH_volume)
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister():
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    bpy.utils.unregister_class(REPOUSSE_FH_volume)
    bpy.utils.unregister_class(REPOUSSE_OT_import_volume)
