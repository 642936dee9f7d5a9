# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids that the tests push into, and the marks that what they do to them is read by."""

import contextlib
from itertools import permutations, product

import numpy as np

from repousse.core import DensityGrid

TINY = 1e-6
"""A yield ratio with which a tool is emptied wholly."""


def half_space(shape, density=1.0, first=None, axis=0):
    """Material of one density from index ``first`` on along ``axis`` (default: a third of the way), air before it."""
    shape = (shape,) * 3 if np.isscalar(shape) else tuple(shape)
    values = np.zeros(shape, np.float32)
    inside = [slice(None)] * 3
    inside[axis] = slice(shape[axis] // 3 if first is None else first, None)
    values[tuple(inside)] = density
    return DensityGrid(values)


def tilted_half_space(n, density, direction):
    """Material beyond the plane with normal ``direction`` through the middle of a cube, cut smoothly."""
    u = np.array(direction, float) / np.linalg.norm(direction)
    centre = (n - 1) / 2
    along = sum(u[a] * (np.arange(n) - centre).reshape([-1 if b == a else 1 for b in range(3)]) for a in range(3))
    return DensityGrid((density * np.clip(along + 0.5, 0.0, 1.0)).astype(np.float32))


def speckled(shape, seed=0):
    """CT-like: a smooth body with a dense core and 4 % noise, air around it."""
    shape = (shape,) * 3 if np.isscalar(shape) else tuple(shape)
    x, y, z = (np.linspace(-1.0, 1.0, n).reshape([-1 if b == a else 1 for b in range(3)]) for a, n in enumerate(shape))
    radius = np.sqrt(x * x + y * y + z * z)
    body = 0.45 * np.clip((0.85 - radius) * 8.0, 0.0, 1.0) + 0.5 * np.clip((0.35 - radius) * 8.0, 0.0, 1.0)
    noise = np.random.default_rng(seed).normal(0.0, 0.04, shape)
    return DensityGrid(np.where(body > 0.0, np.clip(body + noise, 0.0, 1.0), 0.0).astype(np.float32))


def cube_motions():
    """The 48 rotations and mirrors of the cube: for each the order of its axes and which of them are turned round."""
    return list(product(permutations(range(3)), product((False, True), repeat=3)))


def carried(values, order, turned):
    """An array as a motion of the cube carries it."""
    moved = np.transpose(values, order)
    return moved[tuple(slice(None, None, -1) if t else slice(None) for t in turned)]


def carried_point(point, n, order, turned):
    """A point in index space as the same motion carries it, in a cube with ``n`` voxels along each edge."""
    moved = np.array(point, float)[list(order)]
    return np.where(turned, n - 1 - moved, moved)


def net_moved(before, after):
    """Mass that changed its place: half the sum of all changes."""
    return float(np.abs(after.astype(np.float64) - before).sum()) / 2.0


def apart(first, second, before):
    """Distance between two outcomes of one push, as a share of what the first moved (L1 over net moved mass)."""
    return float(np.abs(first.astype(np.float64) - second).sum()) / 2.0 / max(net_moved(before, first), 1e-30)


def walk(push, points, **how):
    """The contacts of a push that is moved through points."""
    return [push.move_to(point, **how) for point in points]


def line(start, end, step=0.25):
    """Points from start to end, at most ``step`` voxels apart."""
    start, end = np.array(start, float), np.array(end, float)
    count = max(1, int(np.ceil(np.linalg.norm(end - start) / step - 1e-9)))
    return [tuple(start + (end - start) * i / count) for i in range(count + 1)]


def in_frame(grid, origin, low, shape):
    """A copy of the box of a frame that begins at ``low``; ``origin`` is where the grid's first voxel lies in it."""
    cut = np.zeros(shape, np.float32)
    start = [lo - o for lo, o in zip(low, origin)]
    source, target = [], []
    for begin, size, limit in zip(start, shape, grid.shape):
        first, last = max(begin, 0), min(begin + size, limit)
        source.append(slice(first, max(first, last)))
        target.append(slice(first - begin, max(first, last) - begin))
    cut[tuple(target)] = grid.density[tuple(source)]
    return cut


@contextlib.contextmanager
def kernels_chosen(monkeypatch, name):
    """Make all pushes that begin meanwhile use the kernels "compiled" or "numpy"."""
    with monkeypatch.context() as patch:
        patch.setenv("REPOUSSE_KERNELS", "numpy" if name == "numpy" else "")
        yield
