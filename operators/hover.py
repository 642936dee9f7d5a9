# SPDX-License-Identifier: GPL-3.0-or-later
"""Hover: where the tool would touch, while no button is held. Called for every move of the mouse, changes no data."""

from __future__ import annotations

import bpy

from ..core.surface import Surface
from . import arm_session
from .aim import Aim, Pointer, brush_radius, voxels_to_world
from .automatic_level import level_of
from .session import live
from .volumes import active_volume


class REPOUSSE_OT_hover(bpy.types.Operator):
    bl_idname = "repousse.hover"
    bl_label = "Follow the Mouse"
    bl_description = "Show the tool on the surface under the mouse"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context):
        session, arm = live(), arm_session.arm()
        has_pointer = arm is not None and arm.has_pointer
        return session is not None and session.engine is None and not has_pointer and context.region_data is not None

    def invoke(self, context, event):
        session, obj = live(), active_volume(context)
        if obj is None or obj.data.session_uid != session.volume_uid:
            return {"PASS_THROUGH"}
        to_world = voxels_to_world(obj, session)
        aim = Aim.of(context.region, context.region_data, to_world)
        ray = aim.ray(event.mouse_region_x, event.mouse_region_y)
        hit = Surface(session.grid, level_of(obj.data)).hit(*ray)
        former = session.pointer
        if hit is None:
            session.pointer = None
        else:
            session.pointer = Pointer.at(hit, brush_radius(aim, context.scene.repousse, hit.position), to_world)
        if session.pointer != former:
            context.area.tag_redraw()
        return {"PASS_THROUGH"}


def register():
    bpy.utils.register_class(REPOUSSE_OT_hover)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_OT_hover)
