# SPDX-License-Identifier: GPL-3.0-or-later
"""The live grid: what one volume's voxels are while it is sculpted. At most one is alive.

Blender's own undo goes from file to file (`revisions`); between two of them the voxels are here. Nothing of Blender's
is held on to from one event to the next, for undo frees it: names and session_uid stand for it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core import DensityGrid
from ..core.formats import read_volume, write_volume
from ..core.grid import Box
from ..core.level import automatic_level
from ..core.stroke import hash_of
from . import revisions
from .volumes import note, path_of

if TYPE_CHECKING:
    from ..core.engine import Engine

_live: Session | None = None


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
    """End the stroke that may run, and forget the grid."""
    global _live
    if _live is not None:
        end_stroke()
        _live = None


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


class Session:
    """The voxels of one volume, its file, and what has changed since the view last asked.

    ``grid`` is live: a stroke's threads write into it. ``path`` is the file that holds it as of the last commit;
    ``volume_uid`` the volume's session_uid; ``notes`` what its reader did to the values; ``auto_level`` the density at
    which the surface is seen where the artist has not said; ``last_trace`` that of the last stroke.
    ``engine`` is set while a stroke runs.
    """

    def __init__(self, volume: bpy.types.Volume, path: Path) -> None:
        self.grid: DensityGrid = read_volume(path)
        self.path = path
        self.volume_uid = volume.session_uid
        self.notes = list(self.grid.notes)
        self.auto_level = automatic_level(self.grid.density)
        self.engine: Engine | None = None
        self.last_trace: list[tuple[float, float, float]] = []
        self.pointer = None
        self._boxes: list[Box] = []
        self._seen = None  # the array that the view has

    def changed(self, box: Box | None) -> None:
        """Tell the view that the voxels of ``box`` (array indices) are not what they were; None: any of them."""
        if box is None:
            self._seen = None
        else:
            self._boxes.append(box)

    def take_changes(self) -> tuple[bool, list[Box]]:
        """Whether all must be drawn anew, else the boxes (array indices) that changed since this was last asked.

        There is one asker, the live view.
        """
        boxes, self._boxes = self._boxes, []
        engine = self.engine
        if engine is not None:
            origin = engine.push.origin
            for low, high in engine.take_changes() or ():
                boxes.append((_shifted(low, origin), _shifted(high, origin)))
        if self.grid.density is not self._seen:  # a grid that grows moves into another array
            self._seen = self.grid.density
            return True, []
        return False, boxes

    def commit(self, obj: bpy.types.Object, boxes: list[Box] | None, mass_out: float = 0.0) -> None:
        """Make what the grid is now the next revision of the volume that ``obj`` shows.

        ``boxes`` (array indices) hold all that changed since the last revision; None: anything may have. ``mass_out``
        is what left the grid, in voxels' worth. Raises ValueError with one line, and the volume shows what it did.
        """
        volume = obj.data
        path = revisions.new_path(volume)
        write_volume(self.grid, path)
        volume.filepath = str(path)
        self.path = path
        note(volume, self.grid, volume.repousse.mass - mass_out)

    def grid_hash(self) -> str:
        """The hash of the grid by which a recorded stroke knows what it began on."""
        return hash_of(self.grid)


def _shifted(corner: tuple[int, int, int], origin: tuple[int, int, int]) -> tuple[int, int, int]:
    x, y, z = (int(c - o) for c, o in zip(corner, origin))
    return x, y, z
