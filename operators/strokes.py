# SPDX-License-Identifier: GPL-3.0-or-later
"""Recorded strokes: each is kept as a text of the .blend file, listed with the volume that it was made on.

So they are saved, undone, copied and appended with their volume.
"""

from __future__ import annotations

import re
from pathlib import Path

import bpy

from ..core import Stroke
from .replay_stroke import replay
from .volumes import OnActiveVolume, active_volume


class RepousseStroke(bpy.types.PropertyGroup):
    text: bpy.props.PointerProperty(
        type=bpy.types.Text, name="Text", description="The stroke as lines of JSON, as in a .jsonl file"
    )


class RepousseStrokes(bpy.types.PropertyGroup):
    kept: bpy.props.CollectionProperty(
        type=RepousseStroke, name="Strokes", description="The strokes recorded on this volume, first to last"
    )
    active: bpy.props.IntProperty(name="Active Stroke", description="Number of the chosen stroke, counted from 0")


def keep(stroke: Stroke, volume: bpy.types.Volume) -> bpy.types.Text:
    """Keep a stroke with the volume that it was made on, after those kept before."""
    strokes = volume.repousse_strokes
    text = bpy.data.texts.new(f"Stroke {len(strokes.kept) + 1:03d} {volume.name}")
    text.from_string(stroke.to_text())
    strokes.kept.add().text = text
    strokes.active = len(strokes.kept) - 1
    return text


def kept(volume: bpy.types.Volume) -> list[bpy.types.Text]:
    """The texts of a volume's strokes, first to last, without those that were deleted."""
    return [item.text for item in volume.repousse_strokes.kept if item.text is not None]


def stroke_in(text: bpy.types.Text) -> Stroke:
    """The stroke that a text holds. Raises ValueError with one line that names the text, its line and what is wrong."""
    return Stroke.from_lines((line.body for line in text.lines if line.body), text.name)


class OnKeptStrokes(OnActiveVolume):
    """What the operators have in common that work on the recorded strokes of the active volume."""

    @classmethod
    def poll(cls, context):
        if not super().poll(context):
            return False
        if not len(active_volume(context).data.repousse_strokes.kept):
            cls.poll_message_set("No stroke has been recorded on this volume")
            return False
        return True


class REPOUSSE_OT_save_strokes(OnKeptStrokes, bpy.types.Operator):
    bl_idname = "repousse.save_strokes"
    bl_label = "Save Strokes"
    bl_description = (
        "Write the recorded strokes of the active volume into a folder, numbered in their order. "
        "No file of another content is overwritten"
    )
    bl_options = {"REGISTER"}

    directory: bpy.props.StringProperty(
        name="Folder", description="Where the numbered .jsonl files go", subtype="DIR_PATH"
    )
    filter_glob: bpy.props.StringProperty(default="*.jsonl", options={"HIDDEN"})

    def invoke(self, context, _event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        volume = active_volume(context).data
        stem = re.sub(r"[^\w-]+", "_", volume.name)
        folder = Path(bpy.path.abspath(self.directory))
        try:
            strokes = {folder / f"{stem}-{n:03d}.jsonl": stroke_in(text) for n, text in enumerate(kept(volume), 1)}
            for path, stroke in strokes.items():
                if path.exists() and path.read_text(encoding="utf-8") != stroke.to_text():
                    raise ValueError(f"{path}: is there already: choose another folder")
            for path, stroke in strokes.items():
                stroke.save(path)
        except (ValueError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{len(strokes)} strokes saved in {folder}")
        return {"FINISHED"}


class REPOUSSE_OT_replay_kept_stroke(OnActiveVolume, bpy.types.Operator):
    bl_idname = "repousse.replay_kept_stroke"
    bl_label = "Replay Recorded Stroke"
    bl_description = "Push a stroke that is kept as a text of this file through the active volume"
    bl_options = {"REGISTER", "UNDO"}

    text: bpy.props.StringProperty(name="Text", description="The text that holds the stroke")

    def invoke(self, context, _event):
        if self.text:
            return self.execute(context)
        texts = kept(active_volume(context).data)
        self.text = texts[-1].name if texts else ""
        return context.window_manager.invoke_props_dialog(self)

    def draw(self, _context):
        self.layout.prop_search(self, "text", bpy.data, "texts")

    def execute(self, context):
        text = bpy.data.texts.get(self.text)
        if text is None:
            self.report({"ERROR"}, f"There is no text {self.text!r}: choose one that holds a stroke")
            return {"CANCELLED"}
        return replay(self, context, lambda: stroke_in(text))


class REPOUSSE_OT_forget_stroke(OnKeptStrokes, bpy.types.Operator):
    bl_idname = "repousse.forget_stroke"
    bl_label = "Forget Stroke"
    bl_description = "Delete the chosen recorded stroke. The volume stays as it is"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        strokes = active_volume(context).data.repousse_strokes
        index = min(max(strokes.active, 0), len(strokes.kept) - 1)
        text = strokes.kept[index].text
        strokes.kept.remove(index)
        strokes.active = max(min(index, len(strokes.kept) - 1), 0)
        if text is not None and not any(text in kept(volume) for volume in bpy.data.volumes):
            bpy.data.texts.remove(text)
        return {"FINISHED"}


_CLASSES = (
    RepousseStroke,
    RepousseStrokes,
    REPOUSSE_OT_save_strokes,
    REPOUSSE_OT_replay_kept_stroke,
    REPOUSSE_OT_forget_stroke,
)


def register():
    for made in _CLASSES:
        bpy.utils.register_class(made)
    bpy.types.Volume.repousse_strokes = bpy.props.PointerProperty(type=RepousseStrokes)


def unregister():
    del bpy.types.Volume.repousse_strokes
    for made in reversed(_CLASSES):
        bpy.utils.unregister_class(made)
