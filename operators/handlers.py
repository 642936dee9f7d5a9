# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens when Blender undoes, saves, loads and ends: strokes end, voxels follow, files are kept or go."""

from __future__ import annotations

import atexit

import bpy
from bpy.app.handlers import persistent

from . import arm_session, revisions, saving, session

_leaving = False


@persistent
def before_undo(*_):
    session.end_stroke()
    arm_session.quieten()
    revisions.look()
    saving.note_places()


@persistent
def after_undo(*_):
    saving.find_again()
    revisions.follow()
    session.follow()
    session.put_displays_in_step()


@persistent
def before_load(*_):
    arm_session.close_arm()
    session.close_session()
    revisions.look()


@persistent
def after_load(*_):
    session.give_back_displays()
    saving.find_again()
    saving.forget_places()
    saving.note_places()
    revisions.restart()


@persistent
def before_save(path, *_):
    session.end_stroke()
    session.give_back_displays()
    saving.before_save(path)


@persistent
def after_save(path, *_):
    saving.after_save(path)
    saving.find_again()  # without Relative Remap
    saving.note_places()
    session.put_displays_in_step()


@persistent
def after_failed_save(*_):
    saving.after_failed_save()
    session.put_displays_in_step()


@persistent
def after_change(*_):
    """Another operator, or the artist, gave the volume another file, or removed it."""
    stroke = session.live()
    if stroke is not None and stroke.engine is None:
        session.follow()


@persistent
def before_exit(*_):
    global _leaving
    _leaving = True
    arm_session.close_arm()
    session.close_session()
    if bpy.data is not None:  # as a Python module Blender has taken it away by now
        revisions.look()


def at_exit():
    """The last that Python does."""
    arm_session.close_arm()
    session.close_session()
    revisions.clear()


_HANDLERS = {
    "undo_pre": before_undo,
    "redo_pre": before_undo,
    "undo_post": after_undo,
    "redo_post": after_undo,
    "load_pre": before_load,
    "load_post": after_load,
    "save_pre": before_save,
    "save_post": after_save,
    "save_post_fail": after_failed_save,
    "depsgraph_update_post": after_change,
    "exit_pre": before_exit,  # 4.5 has none
}


def register():
    for name, function in _HANDLERS.items():
        if hasattr(bpy.app.handlers, name):
            getattr(bpy.app.handlers, name).append(function)
    atexit.unregister(at_exit)
    atexit.register(at_exit)


def unregister():
    session.close_session()
    revisions.look()
    # Blender disables all add-ons when it ends: only where that is known not to be so, what undo needs has to stay.
    if hasattr(bpy.app.handlers, "exit_pre") and not _leaving:
        atexit.unregister(at_exit)
    for name, function in reversed(_HANDLERS.items()):
        if hasattr(bpy.app.handlers, name):
            getattr(bpy.app.handlers, name).remove(function)
