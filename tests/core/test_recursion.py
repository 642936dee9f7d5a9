# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's recursion, literally: that it is that, that its budget holds, and how far the sweep is from it."""

import importlib.util
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool, recursion
from repousse.core.plasticity import RELAXED

from .volumes import apart, half_space, line, net_moved, tilted_half_space, walk

_spec = importlib.util.spec_from_file_location("batched", Path(__file__).parents[1] / "bench" / "batched.py")
batched_runs = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(batched_runs)

DIRECTIONS = {
    "along 0": (1.0, 0.0, 0.0),
    "along 2": (0.0, 0.0, 1.0),
    "face": (1.0, 1.0, 0.0),
    "body": (1.0, 1.0, 1.0),
    "general": (0.8, 0.5, 0.33),
}


def literal(density, tool, centre, direction, kappa, open_border=True):
    """Section 7 of the paper, read aloud: float64, one call a voxel, nothing shared with the product but the shapes."""
    u = np.array(direction) / np.linalg.norm(direction)
    forward = []
    for offset in np.ndindex(3, 3, 3):
        offset = np.array(offset) - 1
        cosine = offset @ u / max(np.linalg.norm(offset), 1e-9)
        if cosine > 0.5 + 1e-9:
            forward.append((offset, cosine))
    total = sum(cosine for _, cosine in forward)
    index = np.indices(density.shape)
    offsets = [index[a] - centre[a] for a in range(3)]
    inside = tool.volume.coverage(*offsets)
    around = tool.surroundings.coverage(*offsets) - inside
    d = density.astype(np.float64)
    gone = 0.0

    def pass_on(voxel, amount):
        nonlocal gone
        for offset, cosine in forward:
            share = amount * cosine / total
            beside = tuple(np.array(voxel) + offset)
            if min(beside) < 0 or any(i >= n for i, n in zip(beside, d.shape)):
                gone += share
                continue
            taken = min(share, 1.0 - d[beside])
            d[beside] += taken
            if share - taken > 1e-5:
                pass_on(beside, share - taken)

    deepest_first = np.argsort(tool.volume.distance(*offsets).ravel(), kind="stable")
    for flat in deepest_first[: int((inside > 0.0).sum())]:
        if (inside * d).sum() <= kappa * (around * d).sum() * (1.0 + RELAXED):
            break
        voxel = np.unravel_index(flat, d.shape)
        taken = inside[voxel] * d[voxel]
        if taken <= 0.0:
            continue
        d[voxel] -= taken
        pass_on(tuple(int(i) for i in voxel), taken)
    return d, gone


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.8, 0.5, 0.33)])
@pytest.mark.parametrize("density", [0.5, 0.8])
def test_is_the_paper_literally(kernels, density, direction):
    """One dispersion against the recursion as one would write it down from the paper."""
    u = np.array(direction) / np.linalg.norm(direction)
    before = half_space(18, density, 7).density
    tool, kappa = SphereTool(3, 5), 0.05
    start, centre = np.array([1.3, 8.4, 8.6]), np.array([1.3, 8.4, 8.6]) + 4.4 * u
    push = Push(DensityGrid(before), tool, Material(3.3, kappa), method="recursive", border="open")
    push.move_to(start)
    push._position = tuple(centre - 0.5 * u)  # one solve, and one whose direction is u
    push._turned_at = tuple(start)
    contact = push.move_to(centre)
    expected, _ = literal(before, tool, centre, u, kappa)
    assert contact.moved_mass > 5.0
    assert apart(expected, push.grid.density, before) < 1e-4


@pytest.mark.parametrize("border", ["grow", "wall", "open"])
def test_mass_and_bounds(kernels, border):
    before = np.full((9, 8, 10), 0.4, np.float32)
    push = Push(DensityGrid(before), SphereTool(2, 3), Material(3.3, 0.03), method="recursive", border=border)
    contacts = walk(push, line((4.0, 3.6, 4.0), (4.3, 3.8, 7.0), 0.5))
    out = sum(contact.mass_out for contact in contacts)
    assert sum(contact.moved_mass for contact in contacts) > 2.0
    assert push.grid.mass + out == pytest.approx(before.sum(dtype=np.float64), rel=1e-6)
    assert push.grid.density.min() >= 0.0 and push.grid.density.max() <= 1.0
    assert (out > 0.0) == (border == "open")
    assert (push.grid.shape != before.shape) == (border == "grow")


@pytest.mark.parametrize("amount", [1, 1000])
def test_the_budget_ends_it(kernels, amount, monkeypatch):
    """Through saturated material it is exponential: a clear error, and not a voxel has changed."""
    monkeypatch.setattr(recursion, "BUDGET", amount)
    push = Push(half_space(32, 1.0, 10), SphereTool(4), Material(3.3, 0.02), method="recursive", border="wall")
    history = push.remember()
    before = push.grid.density.tobytes()
    with pytest.raises(ValueError, match="sweep") as error:
        walk(push, line((5.0, 15.5, 15.5), (12.0, 15.5, 15.5), 0.5))
    assert "\n" not in str(error.value) and str(amount) in str(error.value)
    assert push.grid.density.tobytes() == before
    push.restore(history)
    assert push.grid.density.tobytes() == before


def test_forward_neighbours():
    """Their mean is along u where the lattice is symmetric about it, and 8.7 degrees off at worst."""
    for direction, count, off in (
        ((1, 0, 0), 9, 0.0),
        ((1, 1, 0), 5, 0.0),
        ((1, 1, 1), 7, 0.0),
        ((0.8, 0.5, 0.33), 7, 8.8),
    ):
        u = np.array(direction) / np.linalg.norm(direction)
        offsets, weights = recursion.forward_neighbours(u)
        assert len(offsets) == count
        assert weights.sum() == pytest.approx(1.0) and weights.min() > 0.0
        mean = weights @ offsets
        angle = np.degrees(np.arccos(np.clip(mean @ u / np.linalg.norm(mean), -1.0, 1.0)))
        assert angle <= off + 1e-4


@cache
def compared(way):
    """The volume before, and after the same push by the recursion, in batches, and by the sweep."""
    u, radius, n = np.array(DIRECTIONS[way]) / np.linalg.norm(DIRECTIONS[way]), 12, 60
    before = tilted_half_space(n, 0.5, u).density
    surface = (n - 1) / 2 + np.array([0.31, -0.17, 0.08])  # off the lattice, where fewer voxels are equally deep
    path = line(surface - (radius + 4) * u, surface - 0.4 * radius * u, 0.5)
    ends = []
    for method in ("recursive", "sweep"):
        push = Push(DensityGrid(before), SphereTool(radius), Material(3.3, 0.1), method=method, border="open")
        walk(push, path)
        ends.append(push.grid.density)
    batched = before.astype(np.float64)
    batched_runs.push_batched(batched, SphereTool(radius), 0.1, u, path)
    return before, ends[0], batched, ends[1]


@pytest.mark.parametrize("way", DIRECTIONS)
def test_batches_agree_with_the_recursion(way):
    """With the same 26-neighbour weights, to 5 % of what moved; the recursion's own ties are worth 4 %."""
    before, recursive, batched, _ = compared(way)
    assert net_moved(before, recursive) > 400.0
    assert apart(recursive, batched, before) <= 0.05
    assert batched.sum() == pytest.approx(before.sum(dtype=np.float64), rel=1e-6)


@pytest.mark.parametrize("way", DIRECTIONS)
def test_how_far_the_sweep_is(way):
    """Its kernel is rounder: 8 to 23 % of what moved, by direction."""
    before, recursive, _, sweep = compared(way)
    assert apart(recursive, sweep, before) < 0.25
    assert net_moved(before, sweep) == pytest.approx(net_moved(before, recursive), rel=0.1)
