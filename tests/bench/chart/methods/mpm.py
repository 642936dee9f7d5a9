# SPDX-License-Identifier: GPL-3.0-or-later
"""MLS-MPM: material points on a grid (Hu et al., SIGGRAPH 2018), elastoplastic, a rigid sphere without friction.

Explicit, so a slow press takes many substeps: what is slow is only slow against the speed of sound. Mass is scaled so
that this is 1 cell a unit of time; the tool moves at ``SPEED`` of it, and inertia is then E/Y SPEED^2, 1 %, of the
yield stress. The transfers' own dissipation is all the damping: a drag of 2 % a cell of sound's way, tried, raised the
force by 6 %. E/Y = 500, nu = .3. Points are eight a cell around the tool's path, and one a cell elsewhere, where
strains are small.

The sphere pushes each point that reaches into it, not the nodes within it: by nodes (tried) the contact was felt half a
cell early, and points sank a third of a cell into the tool, so that the force rose half as fast as it should.

Gets wrong: a contact narrower than some three cells is too stiff (at R/10 deep the force is a third over that of finite
elements where R is 5.3 cells, a sixth where it is 8, though as straight), and the rim is half as high as theirs or
less; hundreds of substeps a step; numerical diffusion and fracture at large strain; a foam has no locking, so it may be
crushed beyond what a voxel holds. ``density`` is what the points' parallelepipeds (their cubes, deformed) cover, less
what they covered at first, added to the scene's and clipped to [0, 1]: `Points.clipped` is the mass that this hides,
for a solid that fills its voxels a third to a half of what the tool displaces, most of it elastic compression.
"""

from __future__ import annotations

from functools import cache, partial
from math import ceil

import numpy as np
from numba import njit

from tests.bench.chart.method import Method, Scene, Vector
from tests.bench.chart.methods.elastoplastic import (
    FOAM,
    VON_MISES,
    cauchy_green_of,
    returned,
    strain_of,
    stress_of,
)

STIFFNESS_OVER_YIELD, POISSON = 500.0, 0.3
SPEED = 0.005
"""Of the tool, in speeds of sound."""
COURANT = 0.4
"""Cells that sound travels in a substep."""
CONTACT = 0.3
"""Share of the depth by which a point reaches into the sphere that the contact alone would undo in a substep."""
FELT = 0.25
"""The last part of a step over which the force is averaged."""
NEAR = 2.0
"""Distance in radii from the tool's path within which there are eight points a cell."""
FRAME = 3
"""Cells of grid around the scene."""
SPLIT = 3
"""Parts along each edge of a point's parallelepiped when it is drawn into voxels."""


@njit(error_model="numpy")
def _weights(x):
    """Base node and quadratic B-spline weights of a point on one axis."""
    base = int(x - 0.5)
    f = x - base
    return base, (0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2)


@njit(error_model="numpy")
def _touch(x, v, deformed, mass, half, centre, radius, reaction, dt):
    """Push the points that reach into the sphere out along its normal; add up the force on it.

    A point reaches as far as its cube does, deformed: half edge times |F^T n|.
    """
    for p in range(len(mass)):
        nx, ny, nz = x[p, 0] - centre[0], x[p, 1] - centre[1], x[p, 2] - centre[2]
        r = np.sqrt(nx * nx + ny * ny + nz * nz)
        if r > radius + 2.0 or r == 0.0:
            continue
        nx, ny, nz = nx / r, ny / r, nz / r
        f, reach2 = deformed[p], 0.0
        for axis in range(3):
            reach2 += (f[0, axis] * nx + f[1, axis] * ny + f[2, axis] * nz) ** 2
        depth = radius + half[p] * np.sqrt(reach2) - r
        if depth > 0.0:
            gain = CONTACT / dt * depth
            v[p, 0] += gain * nx
            v[p, 1] += gain * ny
            v[p, 2] += gain * nz
            push = mass[p] * gain / dt
            reaction[0] -= push * nx
            reaction[1] -= push * ny
            reaction[2] -= push * nz


@njit(error_model="numpy")
def _to_grid(x, v, affine, stress, mass, volume, momentum, dt):
    """Points to grid: mass and momentum, with the impulse of the stress (MLS-MPM, equation 18); D = 1/4 cell^2."""
    momentum[:] = 0.0
    for p in range(len(mass)):
        i, wx = _weights(x[p, 0])
        j, wy = _weights(x[p, 1])
        k, wz = _weights(x[p, 2])
        m, impulse, s, c = mass[p], 4.0 * dt * volume[p], stress[p], affine[p]
        xx, xy, xz = m * c[0, 0] - impulse * s[0], m * c[0, 1] - impulse * s[5], m * c[0, 2] - impulse * s[4]
        yx, yy, yz = m * c[1, 0] - impulse * s[5], m * c[1, 1] - impulse * s[1], m * c[1, 2] - impulse * s[3]
        zx, zy, zz = m * c[2, 0] - impulse * s[4], m * c[2, 1] - impulse * s[3], m * c[2, 2] - impulse * s[2]
        for a in range(3):
            dx = i + a - x[p, 0]
            for b in range(3):
                dy, wxy = j + b - x[p, 1], wx[a] * wy[b]
                px = m * v[p, 0] + xx * dx + xy * dy
                py = m * v[p, 1] + yx * dx + yy * dy
                pz = m * v[p, 2] + zx * dx + zy * dy
                for d in range(3):
                    dz, w = k + d - x[p, 2], wxy * wz[d]
                    node = momentum[i + a, j + b, k + d]
                    node[0] += w * m
                    node[1] += w * (px + xz * dz)
                    node[2] += w * (py + yz * dz)
                    node[3] += w * (pz + zz * dz)


@njit(error_model="numpy")
def _on_grid(momentum, high):
    """Momentum to velocity at the nodes, none across the walls."""
    for i in range(momentum.shape[0]):
        for j in range(momentum.shape[1]):
            for k in range(momentum.shape[2]):
                node = momentum[i, j, k]
                m = node[0]
                if m <= 0.0:
                    continue
                for axis, at in ((0, i), (1, j), (2, k)):
                    node[1 + axis] *= 0.0 if at <= FRAME or at >= high[axis] else 1.0 / m


@njit(error_model="numpy")
def _to_points(x, v, affine, deformed, green, stress, volume, first_volume, momentum, dt, law):
    """Grid to points: velocity and its gradient, then deformation, plastic flow and the stress of the next substep."""
    bulk, shear, yield_stress, alpha = law
    new, g = np.empty(3), np.empty((3, 3))
    for p in range(len(volume)):
        i, wx = _weights(x[p, 0])
        j, wy = _weights(x[p, 1])
        k, wz = _weights(x[p, 2])
        new[:] = 0.0
        g[:] = 0.0
        for a in range(3):
            dx = i + a - x[p, 0]
            for b in range(3):
                dy, wxy = j + b - x[p, 1], wx[a] * wy[b]
                for d in range(3):
                    dz, w = k + d - x[p, 2], wxy * wz[d]
                    node = momentum[i + a, j + b, k + d]
                    for axis in range(3):
                        part = w * node[1 + axis]
                        new[axis] += part
                        g[axis, 0] += part * dx
                        g[axis, 1] += part * dy
                        g[axis, 2] += part * dz
        for axis in range(3):
            v[p, axis] = new[axis]
            x[p, axis] += dt * new[axis]
            for other in range(3):
                affine[p, axis, other] = 4.0 * g[axis, other]
                g[axis, other] *= 4.0 * dt
            g[axis, axis] += 1.0  # the increment I + dt grad v
        f = deformed[p]
        for column in range(3):
            f0, f1, f2 = f[0, column], f[1, column], f[2, column]
            for axis in range(3):
                f[axis, column] = g[axis, 0] * f0 + g[axis, 1] * f1 + g[axis, 2] * f2
        volume[p] = first_volume[p] * (
            f[0, 0] * (f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1])
            - f[0, 1] * (f[1, 0] * f[2, 2] - f[1, 2] * f[2, 0])
            + f[0, 2] * (f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0])
        )
        b = _carried(g, green[p])
        strain, flowed = returned(strain_of(b), bulk, shear, yield_stress, alpha)
        if flowed:
            b = cauchy_green_of(strain)
        s = stress_of(strain, bulk, shear)
        for part in range(6):
            green[p, part] = b[part]
            stress[p, part] = s[part]


@njit(error_model="numpy")
def _carried(g, b):
    """g b g^T of a symmetric b."""
    ax, ay, az = _row(g[0], b)
    bx, by, bz = _row(g[1], b)
    cx, cy, cz = _row(g[2], b)
    return (
        ax * g[0, 0] + ay * g[0, 1] + az * g[0, 2],
        bx * g[1, 0] + by * g[1, 1] + bz * g[1, 2],
        cx * g[2, 0] + cy * g[2, 1] + cz * g[2, 2],
        bx * g[2, 0] + by * g[2, 1] + bz * g[2, 2],
        ax * g[2, 0] + ay * g[2, 1] + az * g[2, 2],
        ax * g[1, 0] + ay * g[1, 1] + az * g[1, 2],
    )


@njit(error_model="numpy")
def _row(g, b):
    return (
        g[0] * b[0] + g[1] * b[5] + g[2] * b[4],
        g[0] * b[5] + g[1] * b[1] + g[2] * b[3],
        g[0] * b[4] + g[1] * b[3] + g[2] * b[2],
    )


@njit(error_model="numpy")
def _draw(at, half, deformed, mass, density):
    """Add to ``density`` what the points' parallelepipeds cover: SPLIT^3 cubes each, shared among the voxels they meet.

    ``at`` (n, 3) and ``half`` (n,), half edges, in voxels; a cube's share of a voxel is its overlap on each axis.
    """
    place, first, share = np.empty(3), np.empty(3, np.int64), np.empty((3, 2))
    for p in range(len(mass)):
        edge = 2.0 * half[p] / SPLIT
        part = mass[p] / SPLIT**3
        for cube in range(SPLIT**3):
            u = (cube // SPLIT**2 + 0.5) * edge - half[p]
            v = (cube // SPLIT % SPLIT + 0.5) * edge - half[p]
            w = (cube % SPLIT + 0.5) * edge - half[p]
            f = deformed[p]
            for axis in range(3):
                place[axis] = at[p, axis] + f[axis, 0] * u + f[axis, 1] * v + f[axis, 2] * w
                low = place[axis] - edge / 2.0
                first[axis] = int(np.floor(low + 0.5))
                beyond = (low + edge - (first[axis] + 0.5)) / edge
                share[axis, 1] = min(max(beyond, 0.0), 1.0)
                share[axis, 0] = 1.0 - share[axis, 1]
            for a in range(2):
                for b in range(2):
                    for c in range(2):
                        i = min(max(first[0] + a, 0), density.shape[0] - 1)
                        j = min(max(first[1] + b, 0), density.shape[1] - 1)
                        k = min(max(first[2] + c, 0), density.shape[2] - 1)
                        density[i, j, k] += part * share[0, a] * share[1, b] * share[2, c]


def _overlaps(cells: int, edge: float, voxels: int) -> tuple[np.ndarray, np.ndarray]:
    """(cells, voxels): the length that each cell of ``edge`` voxels shares with each voxel, and the middle of that."""
    low = np.maximum(edge * np.arange(cells)[:, None] - 0.5, np.arange(voxels) - 0.5)
    high = np.minimum(edge * (np.arange(cells)[:, None] + 1) - 0.5, np.arange(voxels) + 0.5)
    return np.maximum(high - low, 0.0), (low + high) / 2.0


def seeds(scene: Scene, cells: tuple[int, ...], edge: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of a scene in cells of ``edge`` voxels: places (n, 3) in voxels, masses (n,), half edges (n,).

    Eight a cell near the path, one elsewhere, each at the centre of its share of mass.
    """
    shared = [_overlaps(2 * c, edge / 2.0, n) for c, n in zip(cells, scene.density.shape)]
    sums = []
    for moment in (None, 0, 1, 2):
        total = scene.density.astype(np.float64)
        for axis, (length, middle) in enumerate(shared):
            total = np.moveaxis(np.tensordot(length * middle if axis == moment else length, total, (1, axis)), 0, axis)
        sums.append(total)
    fine = np.stack(sums, axis=-1)
    coarse = fine.reshape(cells[0], 2, cells[1], 2, cells[2], 2, 4).sum(axis=(1, 3, 5))
    middles = edge * (np.indices(cells).reshape(3, -1).T + 0.5) - 0.5
    distance = np.min([np.linalg.norm(middles - c, axis=1) for c in scene.path], axis=0)
    near = (distance < NEAR * scene.radius + edge).reshape(cells)
    parts = (fine[np.kron(near, np.ones((2, 2, 2))) > 0.0], coarse[~near])
    half = np.concatenate([np.full(len(p), e) for p, e in zip(parts, (edge / 4.0, edge / 2.0))])
    sums = np.concatenate(parts)
    filled = sums[:, 0] > 1e-6
    mass = sums[filled, 0]
    return sums[filled, 1:] / mass[:, None], mass, half[filled]


class Points:
    """A scene as material points, on a grid whose longest side has ``cells`` cells; yields like ``alpha``."""

    def __init__(self, scene: Scene, cells: int, alpha: float, yields_at: float = 1.0 / STIFFNESS_OVER_YIELD) -> None:
        self._scene, self._edge = scene, max(scene.density.shape) / cells
        count = tuple(ceil(n / self._edge - 1e-9) for n in scene.density.shape)
        places, self._mass, self._half = seeds(scene, count, self._edge)
        self.x = (places + 0.5) / self._edge + FRAME
        self._high = np.array(count) + FRAME
        self._momentum = np.zeros((*(c + 2 * FRAME + 1 for c in count), 4))
        n = len(self._mass)
        self.v, self.stress = np.zeros((n, 3)), np.zeros((n, 6))
        self._affine, self._green = np.zeros((n, 3, 3)), np.tile([1.0, 1.0, 1.0, 0.0, 0.0, 0.0], (n, 1))
        self._deformed = np.tile(np.eye(3), (n, 1, 1))
        solid = float(scene.density.max())
        self._first_volume = self._mass / solid / self._edge**3
        self.volume, self.point_mass = self._first_volume.copy(), self._first_volume  # density 1: sound has speed 1
        # lambda + 2 G = 1, the square of the speed of sound.
        self.modulus = (1.0 + POISSON) * (1.0 - 2.0 * POISSON) / (1.0 - POISSON)
        self._law = (
            self.modulus / (3.0 * (1.0 - 2.0 * POISSON)),
            self.modulus / (2.0 * (1.0 + POISSON)),
            self.modulus * yields_at,
            alpha,
        )
        self._position: np.ndarray | None = None
        self._force = 0.0
        self.substeps = 0
        self._at_first = self._drawn()

    def move_to(self, position: Vector) -> float:
        former, self._position = self._position, np.asarray(position, float)
        if former is None or (former == self._position).all():
            return self._force
        way = (self._position - former) / self._edge
        steps = ceil(float(np.linalg.norm(way)) / (SPEED * COURANT))
        start = (former + 0.5) / self._edge + FRAME
        felt, reaction = ceil(FELT * steps), np.zeros(3)
        for step in range(1, steps + 1):
            if step == steps - felt + 1:
                reaction[:] = 0.0
            self._substep(start + way * step / steps, reaction)
        self.substeps += steps
        # In units of Y times a voxel squared.
        area = self._edge**2 / self._law[2] / felt
        self._force = -float(reaction @ np.asarray(self._scene.direction)) * area
        return self._force

    def _substep(self, centre: np.ndarray, reaction: np.ndarray) -> None:
        dt, half = COURANT, self._half / self._edge
        radius = self._scene.radius / self._edge
        if not ((self.x > 1.0) & (self.x < self._high + FRAME - 1.0)).all():  # NaN too
            raise RuntimeError("MLS-MPM became unstable: a point left the grid")
        _touch(self.x, self.v, self._deformed, self.point_mass, half, centre, radius, reaction, dt)
        _to_grid(self.x, self.v, self._affine, self.stress, self.point_mass, self.volume, self._momentum, dt)
        _on_grid(self._momentum, self._high)
        _to_points(
            self.x,
            self.v,
            self._affine,
            self._deformed,
            self._green,
            self.stress,
            self.volume,
            self._first_volume,
            self._momentum,
            dt,
            self._law,
        )

    def _drawn(self) -> np.ndarray:
        drawn = np.zeros(self._scene.density.shape)
        _draw((self.x - FRAME) * self._edge - 0.5, self._half, self._deformed, self._mass, drawn)
        return drawn

    @property
    def density(self) -> np.ndarray:
        return np.clip(self._scene.density + self._drawn() - self._at_first, 0.0, 1.0).astype(np.float32)

    @property
    def clipped(self) -> float:
        """Voxels' worth that `density` cannot show, as its voxels hold at most 1."""
        return float(np.maximum(self._scene.density + self._drawn() - self._at_first - 1.0, 0.0).sum())


LAWS = {"von Mises": VON_MISES, "crushable foam": FOAM}


@cache
def _compile() -> None:
    """Compile all kernels, by a step of a small scene. Not kept on disk: numba's cache sees no change of a constant."""
    corner = np.zeros((4, 4, 4), np.float32)
    corner[:, :, :2] = 1.0
    points = Points(Scene(corner, 1.0, np.array([(1.5, 1.5, 2.5)]), (0.0, 0.0, -1.0), 0.0), 4, FOAM)
    for height in (2.5, 2.49):
        points.move_to((1.5, 1.5, height))


def _begun(scene: Scene, cells: int, alpha: float) -> Points:
    _compile()
    return Points(scene, cells, alpha)


def _methods(*sizes: int) -> list[Method]:
    return [
        Method("MLS-MPM", f"{law}, {cells}^3", partial(_begun, cells=cells, alpha=alpha))
        for law, alpha in LAWS.items()
        for cells in sizes
    ]


METHODS = _methods(32, 48)
SLOW = _methods(64)
"""Minutes a press: only where they are asked for."""
