# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests of sessions share: a small volume, and strokes that are quick to make and to recognise."""

import os
from pathlib import Path

import bpy
import numpy as np

from repousse.core.formats import read_volume
from repousse.operators import session


def new_clay(resolution=24, name=None):
    """A block of clay as the active object, its data found by name."""
    assert bpy.ops.repousse.new_clay_block(resolution=resolution, size=1.2) == {"FINISHED"}
    made = bpy.context.object
    made.name = made.data.name = name or made.name
    bpy.ops.ed.undo_push(message="New Clay Block")  # operators called by a script push no step of their own
    return made


def stroke(obj, seed, push=True):
    """Change a box of an object's volume as a stroke does, and commit it; the density as it then is."""
    live = session.open_session(obj)
    random = np.random.default_rng(seed)
    density = live.grid.density
    low = random.integers(0, np.array(density.shape) - 6)
    inside = tuple(slice(a, a + 6) for a in low)
    density[inside] = random.random((6, 6, 6), dtype=np.float32)
    box = (tuple(low.tolist()), tuple((low + 6).tolist()))
    live.commit(obj, [box])
    if push:
        bpy.ops.ed.undo_push(message="Sculpt")
    return density.copy()


def file_of(obj):
    return Path(os.path.normpath(bpy.path.abspath(obj.data.filepath)))


def in_file(obj):
    """The density in the file that an object's volume shows."""
    return read_volume(file_of(obj)).density


def same(one, other):
    """Whether two arrays agree in every bit."""
    return one.shape == other.shape and one.tobytes() == other.tobytes()


def the(name):
    """An object by its name: undo and loading leave no other reference valid."""
    return bpy.data.objects[name]
