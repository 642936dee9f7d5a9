# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a stroke's end takes, from the last voxel to the volume that shows it, and how long its undo."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="asks how long Blender takes")

import addon_utils  # noqa: E402  Blender makes it importable with bpy

from repousse.core import DensityGrid  # noqa: E402  the add-on, which needs Blender here
from repousse.operators import session, volumes  # noqa: E402

ADDON = "bl_ext.user_default.repousse"
STROKES = 8
EDGE = 48
"""Of the box that a stroke has changed, in voxels."""


@pytest.fixture(scope="module", autouse=True)
def addon():
    assert addon_utils.enable(ADDON, default_set=True) is not None
    yield
    session.close_session()
    addon_utils.disable(ADDON, default_set=True)


def ball(size: int) -> np.ndarray:
    """A ball with a soft border and 10 % of noise in it, so that nothing compresses well; 18 % of the grid."""
    axes = np.ogrid[-1.0 : 1.0 : size * 1j, -1.0 : 1.0 : size * 1j, -1.0 : 1.0 : size * 1j]
    distance = np.sqrt(sum(axis.astype(np.float32) ** 2 for axis in axes))
    density = np.clip((0.7 - distance) * (size / 2) + 0.5, 0.0, 1.0).astype(np.float32)
    density *= 0.9 + 0.1 * np.random.default_rng(1).random(density.shape, dtype=np.float32)
    return density


@pytest.fixture(scope="module", params=[128, 256, 512])
def sculpted(request):
    """The size of a grid whose volume has been opened; the object is called Ball."""
    session.close_session()
    bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    made = volumes.add_volume(bpy.context, DensityGrid(ball(request.param), copy=False), "Ball")
    made.name = "Ball"
    bpy.ops.ed.undo_push(message="New")
    session.open_session(made)
    return request.param


def commit(size: int) -> None:
    middle = size // 2
    box = ((middle - EDGE // 2,) * 3, (middle + EDGE // 2,) * 3)
    live = session.live()
    live.grid.density[tuple(slice(a, b) for a, b in zip(*box))] *= np.float32(0.99)
    live.commit(bpy.data.objects["Ball"], [box])


def push_undo() -> None:
    bpy.ops.ed.undo_push(message="Sculpt")


def test_commit(benchmark, figures, sculpted):
    """Dirty box, file, path and undo's bookkeeping; Blender's drawing of it comes after that and is not in it."""
    benchmark.pedantic(commit, args=(sculpted,), setup=push_undo, rounds=STROKES, warmup_rounds=1)
    push_undo()
    report(benchmark, figures, f"commit {sculpted}³", sculpted, 150.0)


def test_undo(benchmark, figures, sculpted):
    """Blender's undo of one stroke, with the voxels read back."""
    assert session.live().path == volumes.path_of(bpy.data.objects["Ball"].data)
    paths = [session.live().path]

    def undo():
        bpy.ops.ed.undo()

    benchmark.pedantic(undo, rounds=STROKES - 2)
    assert session.live().path not in paths
    report(benchmark, figures, f"undo {sculpted}³", sculpted, 300.0)


def report(benchmark, figures, what: str, size: int, limit: float) -> None:
    milliseconds = 1000.0 * np.array(benchmark.stats.stats.data)
    values = {"median": float(np.median(milliseconds)), "least": float(milliseconds.min())}
    limits = {"median": limit} if size == 256 else {}
    benchmark.extra_info.update({f"{name} ms": value for name, value in values.items()})
    benchmark.extra_info.update({f"target {name} ms": value for name, value in limits.items()})
    figures.add("stroke end", what, values, "ms", limits)
