# SPDX-License-Identifier: GPL-3.0-or-later
"""A push leaves the same pit and the same compacted front whichever way it goes through the lattice."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.core import Material, Push, Regime, SphereTool, dispersion

from .volumes import TINY, line, net_moved, tilted_half_space, walk

WITHIN = 0.05
N, RADIUS, DEPTH, BIN = 100, 16, 20.0, 2.0
OBLIQUE = {"face": (1.0, 1.0, 0.0), "body": (1.0, 1.0, 1.0), "general": (0.8, 0.5, 0.33)}
CASES = {"compacts": (0.6, 0.1, None), "wholly emptied": (0.6, TINY, None), "rises": (1.0, TINY, RADIUS)}


def profile(density, kappa, band, direction):
    """Change of mass in rings around the push, (bins along it, bins of radius), and the net moved mass.

    Each ring holds the mean change of its voxels times its true volume, so that the lattice's counting is not in it.
    """
    u = np.array(direction) / np.linalg.norm(direction)
    grid = tilted_half_space(N, density, direction)
    before = grid.density.copy()
    surface = np.full(3, (N - 1) / 2)  # where the push meets it
    push = Push(grid, SphereTool(RADIUS), Material(3.3, kappa), border="wall", band=band)
    walk(push, line(surface - (RADIUS + 1) * u, surface + (DEPTH - RADIUS) * u, 0.5))
    change = grid.density.astype(np.float64) - before
    offsets = np.indices(change.shape).reshape(3, -1) - surface[:, None]
    along = u @ offsets
    radius = np.sqrt(np.maximum((offsets**2).sum(axis=0) - along**2, 0.0))
    near = (np.abs(along) < 40.0) & (radius < 40.0)
    rows, columns = int(80 / BIN), int(40 / BIN)
    ring = ((along[near] + 40.0) / BIN).astype(int) * columns + (radius[near] / BIN).astype(int)
    total = np.bincount(ring, change.ravel()[near], rows * columns)
    voxels = np.bincount(ring, minlength=rows * columns)
    edges = np.arange(columns + 1) * BIN
    volume = np.tile(np.pi * np.diff(edges**2) * BIN, rows)
    return (total / np.maximum(voxels, 1) * volume).reshape(rows, columns), net_moved(before, grid.density)


@cache
def along_the_axis(case):
    return profile(*CASES[case], (1.0, 0.0, 0.0))


@pytest.mark.parametrize("direction", OBLIQUE)
@pytest.mark.parametrize("case", ["compacts", "wholly emptied"])
def test_pit_and_front(case, direction):
    (straight, net), (oblique, oblique_net) = along_the_axis(case), profile(*CASES[case], OBLIQUE[direction])
    assert net > 1000.0
    assert oblique_net == pytest.approx(net, rel=0.02)
    distance = np.abs(oblique - straight).sum() / np.abs(straight).sum()
    assert distance <= WITHIN


@pytest.mark.parametrize("direction", OBLIQUE)
def test_pit_with_a_rim(direction):
    """Packed material: the pit is the same; the rim, laid on whole voxels' faces, is as large and as far away."""
    (straight, net), (oblique, oblique_net) = along_the_axis("rises"), profile(*CASES["rises"], OBLIQUE[direction])
    assert oblique_net == pytest.approx(net, rel=0.02)
    pit = [np.minimum(change, 0.0) for change in (straight, oblique)]
    distance = np.abs(pit[1] - pit[0]).sum() / np.abs(pit[0]).sum()
    assert distance <= WITHIN
    rim = [np.maximum(change, 0.0) for change in (straight, oblique)]
    heights, radii = (np.arange(n)[:, None] * BIN for n in straight.shape)
    for mean in (lambda ring: (heights * ring).sum() / ring.sum(), lambda ring: (radii.T * ring).sum() / ring.sum()):
        assert mean(rim[1]) == pytest.approx(mean(rim[0]), abs=0.05 * RADIUS)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda u: np.linalg.norm(u) > 0.1))
def test_spreading(vector):
    """The 3x3 weights carry exactly all of the flux, along u, and spread it by D for each voxel of the way."""
    u = np.array(vector) / np.linalg.norm(vector)
    axis = dispersion.dominant_axis(tuple(u.tolist()))
    kernel = dispersion.spreading(tuple(u.tolist()), axis)
    weights = np.array(kernel.weights, np.float32).reshape(3, 3)
    assert weights.min() >= 0.0
    assert weights.astype(np.float64).sum() == 1.0
    across = np.delete(u, axis) / abs(u[axis])
    steps = np.array([-1.0, 0.0, 1.0])
    for slope, shift, part in zip(across, kernel.shift, (weights.sum(axis=1), weights.sum(axis=0))):
        mean = float(part @ steps)
        assert shift + mean == pytest.approx(slope, abs=1e-6)
        wanted = dispersion.DISPERSION / abs(u[axis]) * (1.0 + slope**2)
        rest = slope - shift
        wanted = min(max(wanted, abs(rest) - rest**2), 0.9, 1.0 - rest**2)  # as far as 3 weights can
        assert float(part @ steps**2) - mean**2 == pytest.approx(wanted, abs=2e-6)
    covariance = float(steps @ weights @ steps) - float(weights.sum(1) @ steps) * float(weights.sum(0) @ steps)
    wanted = dispersion.DISPERSION / abs(u[axis]) * across[0] * across[1]
    assert min(0.0, wanted) - 1e-6 <= covariance <= max(0.0, wanted) + 1e-6


@pytest.mark.parametrize("direction", OBLIQUE)
def test_front_lies_ahead(direction):
    """The mass that moved has its centre on the push's line: no bias to an axis of the lattice."""
    density, kappa, band = CASES["compacts"]
    u = np.array(OBLIQUE[direction]) / np.linalg.norm(OBLIQUE[direction])
    grid = tilted_half_space(N, density, u)
    before = grid.density.copy()
    surface = np.full(3, (N - 1) / 2)
    push = Push(grid, SphereTool(RADIUS), Material(3.3, kappa), border="wall", band=band)
    walk(push, line(surface - (RADIUS + 1) * u, surface + (DEPTH - RADIUS) * u, 0.5))
    gain = np.maximum(grid.density.astype(np.float64) - before, 0.0)
    offsets = np.indices(gain.shape).reshape(3, -1) - surface[:, None]
    mean = (offsets * gain.ravel()).sum(axis=1) / gain.sum()
    angle = np.degrees(np.arccos(np.clip(mean @ u / np.linalg.norm(mean), -1.0, 1.0)))
    assert angle < 1.0


@pytest.mark.parametrize("step", [0.25, 0.1, 1 / 32])
def test_a_path_of_small_steps_turns(step):
    """An arm is solved every few hundredths of a voxel: pressed in and drawn along, it leaves the groove that the
    mouse's half voxels leave, and lifts nothing up."""

    def groove(step):
        grid = tilted_half_space(48, 1.0, (0.0, 0.0, 1.0))
        push = Push(grid, SphereTool(6.0), Material(3.3, 0.05), border="wall", band=6.0)
        surface = (48 - 1) / 2
        corners = [(15.0, 23.5, surface - 7.0), (15.0, 23.5, surface - 2.0), (32.0, 23.5, surface - 2.0)]
        for start, end in pairwise(corners):
            walk(push, line(start, end, step))
        return grid.density, push

    untouched = tilted_half_space(48, 1.0, (0.0, 0.0, 1.0)).density
    (wanted, _), (fine, push) = groove(0.5), groove(step)
    assert push._direction == pytest.approx((1.0, 0.0, 0.0), abs=0.05)
    assert np.abs(fine - wanted).sum() < 0.15 * np.abs(wanted - untouched).sum()


def test_a_tool_that_is_drawn_back_does_not_turn():
    """Not even out of material so full that it stays overloaded: nothing is pushed the way it goes."""
    grid = tilted_half_space(40, 1.0, (0.0, 0.0, 1.0))
    push = Push(grid, SphereTool(6.0), Material(33.0, 0.05), border="wall")
    surface = (40 - 1) / 2
    walk(push, line((19.5, 19.5, surface - 7.0), (19.5, 19.5, surface - 1.7), 0.01))
    into = push._direction
    overloaded = 0
    for place in line((19.5, 19.5, surface - 1.7), (19.5, 19.5, surface - 3.7), 0.01):
        contact = push.move_to(place)
        overloaded += contact.regime is Regime.PLASTIC
        assert push._direction == into and contact.force[2] <= 0.0
    assert overloaded > 26
