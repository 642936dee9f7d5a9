# SPDX-License-Identifier: GPL-3.0-or-later
"""The live grid: what one volume's voxels are while it is sculpted. At most one is alive.

Blender's own undo goes from file to file (`revisions`); between two of them the voxels are here. Nothing of Blender's
is held on to from one event to the next, for undo frees it: names and session_uid stand for it.
"""

from __future__ import annotations

from itertools import count
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

import bpy

from ..core import DensityGrid
from ..core.formats import VolumeFile
from ..core.grid import Box
from ..core.level import automatic_level
from ..core.stroke import hash_of
from . import revisions
from .volumes import note, path_of

if TYPE_CHECKING:
    from ..core.engine import Engine
    from ..core.quality import Choice
    from .aim import Pointer

_live: Session | None = None

_generations = count(1)

STAND_IN = "BOUNDS"
"""How Blender draws an object while the live view draws its voxels."""


def live() -> Session | None:
    """The session of the volume that is sculpted, if there is one."""
    return _live


def open_session(obj: bpy.types.Object) -> Session:
    """The session of the volume that ``obj`` shows, as its file is now; a session of another volume is closed.

    Raises ValueError with one line where the volume must not be changed or its file cannot be read.
    """
    global _live
    path = path_of(obj.data)
    if _live is not None and (_live.volume_uid, _live.path) == (obj.data.session_uid, path):
        return _live
    opened = Session(obj.data, path)
    close_session()
    _live = opened
    return opened


def close_session() -> None:
    """Take back the stroke that may run, give objects their display back, and forget the grid."""
    global _live
    if _live is not None:
        end_stroke()
        _live.end()
        _live = None
        give_back_displays()


def end_stroke(restore: bool = True) -> None:
    """End the stroke that may run; the voxels are as before it, or with ``restore=False`` as it left them."""
    if _live is None or _live.engine is None:
        return
    engine, _live.engine = _live.engine, None
    if restore:
        engine.cancel()
    else:
        engine.finish()
    _live.changed(None)


def follow() -> None:
    """Let the session be where Blender now is, after undo, redo or whatever else changed the path of its volume.

    When the volume is no more, or its file cannot be read, the session is closed.
    """
    if _live is None:
        return
    volume = _live.volume
    try:
        if volume is None:
            close_session()
        elif path_of(volume) != _live.path:
            end_stroke()
            _live.load(volume)
    except (ValueError, MemoryError):
        close_session()


class Session:
    """The voxels of one volume, its file, and what has changed since the view last asked.

    Attributes
    ----------
    grid
        Live: a stroke's threads write into it.
    path
        The file that holds the grid as of the last commit.
    volume_uid
        The volume's session_uid.
    notes
        What reading the file did to its values, a sentence each.
    auto_level
        The density at which the surface is seen where the artist has not said.
    last_trace
        Depth, stress and yield stress along the last stroke, as the engine keeps them.
    last_choice
        The quality that was chosen last in it, and why; None where nobody chose.
    pointer
        Where the tool is, for the view; None: nowhere.
    generation
        Another number whenever voxels may have changed by anything but a stroke that was finished; no two sessions
        have the same.
    """

    def __init__(self, volume: bpy.types.Volume, path: Path) -> None:
        self.volume_uid = volume.session_uid
        self._engine: Engine | None = None
        self.last_trace: list[tuple[float, float, float]] = []
        self.last_choice: Choice | None = None
        self.pointer: Pointer | None = None
        self.generation = next(_generations)
        self._feeling: Engine | None = None
        self.shown_uid: int | None = None
        self._boxes: list[Box] = []
        self._seen = None  # the array that the view has
        self._hash: _Hash | None = None
        self._read(path)
        self.auto_level = automatic_level(self.grid.density)

    def _read(self, path: Path) -> None:
        self._file = VolumeFile(path)
        self.path = path
        self.notes = list(self.grid.notes)
        self._mass = self.grid.mass
        self._hash_ahead()

    @property
    def engine(self) -> Engine | None:
        """The stroke that runs."""
        return self._engine

    @engine.setter
    def engine(self, engine: Engine | None) -> None:
        if engine is not None:
            self._forget_hash()  # it changes what was hashed
        self._engine = engine

    @property
    def feeling(self) -> Engine | None:
        """What feels the voxels while no stroke runs: ended before anything changes them, or another one feels."""
        return self._feeling

    @feeling.setter
    def feeling(self, engine: Engine | None) -> None:
        former, self._feeling = self._feeling, engine
        if former is not None:
            former.cancel()

    @property
    def grid(self) -> DensityGrid:
        """The live grid."""
        return self._file.grid

    @property
    def volume(self) -> bpy.types.Volume | None:
        """The volume; None when it has been removed."""
        return next((volume for volume in bpy.data.volumes if volume.session_uid == self.volume_uid), None)

    def load(self, volume: bpy.types.Volume) -> None:
        """Read the volume's present file in place of the former. Raises ValueError, and all is as it was."""
        self.feeling = None
        self._read(path_of(volume))
        self.changed(None)

    def changed(self, box: Box | None) -> None:
        """The voxels of ``box`` (array indices) are not what they were; None: any. The view and the map are told."""
        self.grid.bricks.changed(box)
        if box is None:
            self._seen = None
            self.generation = next(_generations)
        else:
            self._boxes.append(box)

    def take_changes(self) -> tuple[bool, list[Box]]:
        """Whether all must be drawn anew, else the boxes (array indices) that changed since this was last asked.

        There is one asker, the live view.
        """
        boxes, self._boxes = self._boxes, []
        engine = self.engine
        if engine is not None:
            changes, origin = engine.take_changes() or (), engine.push.origin
            boxes += [in_array(box, origin) for box in changes]
        if self.grid.density is not self._seen:  # a grid that grows moves into another array
            self._seen = self.grid.density
            return True, []
        return False, boxes

    def commit(self, obj: bpy.types.Object, boxes: list[Box] | None, mass_out: float = 0.0) -> None:
        """Make what the grid is now the next revision of the volume that ``obj`` shows.

        ``boxes`` (array indices) hold all that changed since the last revision; None: anything may have. ``mass_out``
        is what has left the grid, in voxels' worth. Raises ValueError with one line, and the volume shows what it did.
        """
        volume = obj.data
        if volume is None or volume.session_uid != self.volume_uid:
            raise ValueError(f"{obj.name}: does not show the volume that was sculpted any more")
        path_of(volume)
        try:
            path = revisions.new_path(volume)
        except OSError as error:
            raise ValueError(f"the folder for the session's volumes cannot be made: {error}") from error
        self._file.write(path, boxes)
        revisions.commit(volume, path)
        self.path = path
        self._mass -= mass_out
        note(volume, self.grid, self._mass)
        self._hash_ahead()

    def moved_to(self, path: Path) -> None:
        """The same voxels are now read from ``path``."""
        self.path = self._file.path = path

    def grid_hash(self) -> str:
        """The hash of the grid by which a recorded stroke knows what it began on; not while a stroke runs."""
        if self._hash is None:
            self._hash = _Hash(self.grid)
        return self._hash.digest()

    def end(self) -> None:
        """End what may still run for this session."""
        self.feeling = None
        self._forget_hash()

    def _hash_ahead(self) -> None:
        """Where strokes are recorded the next one asks for the hash, and shall not wait for it."""
        self._forget_hash()
        if bpy.context.scene is not None and bpy.context.scene.repousse.record:
            self._hash = _Hash(self.grid)

    def _forget_hash(self) -> None:
        if self._hash is not None:
            self._hash.digest()
            self._hash = None

    def take_display(self, obj: bpy.types.Object) -> None:
        """Let Blender draw ``obj`` as a box, for the live view draws its voxels; others get their display back."""
        self.shown_uid = obj.session_uid
        give_back_displays(but=self.shown_uid)
        if not obj.repousse_display:
            obj.repousse_display = obj.display_type
        if obj.display_type != STAND_IN:
            obj.display_type = STAND_IN

    def give_back_display(self, obj: bpy.types.Object) -> None:
        """Let Blender draw ``obj`` as it did."""
        self.shown_uid = None
        _give_back(obj)


class _Hash:
    """The hash of a grid, made by a thread."""

    def __init__(self, grid: DensityGrid) -> None:
        self._found = ""
        self._thread = Thread(target=self._make, args=(grid,), name="repousse hash", daemon=True)
        self._thread.start()

    def _make(self, grid: DensityGrid) -> None:
        self._found = hash_of(grid)

    def digest(self) -> str:
        """Waits for it."""
        self._thread.join()
        return self._found


def give_back_displays(but: int | None = None) -> None:
    """Let Blender draw every object as it did before it was taken, except for the one with the session_uid ``but``."""
    for obj in bpy.data.objects:
        if obj.repousse_display and obj.session_uid != but:
            _give_back(obj)


def put_displays_in_step() -> None:
    """After Blender's data changed as a whole: the live view's object alone is drawn as a box."""
    shown = _live.shown_uid if _live is not None else None
    give_back_displays(but=shown)
    found = next((obj for obj in bpy.data.objects if obj.session_uid == shown), None)
    if found is not None:
        _live.take_display(found)


def _give_back(obj: bpy.types.Object) -> None:
    former = obj.repousse_display
    if former and obj.is_editable:
        if obj.display_type == STAND_IN:  # else the artist has chosen another meanwhile
            obj.display_type = former
        obj.property_unset("repousse_display")


def in_array(box: Box, origin: tuple[int, int, int]) -> Box:
    """A box in the frame of the poses as indices of the array, whose first voxel lies at ``origin`` in that frame."""
    (i0, j0, k0), (i1, j1, k1) = box
    x, y, z = (int(o) for o in origin)
    return (i0 - x, j0 - y, k0 - z), (i1 - x, j1 - y, k1 - z)


def register():
    bpy.types.Object.repousse_display = bpy.props.StringProperty(
        name="Former Display", description="How Blender drew this object before it was sculpted", options={"HIDDEN"}
    )


def unregister():
    close_session()
    del bpy.types.Object.repousse_display
