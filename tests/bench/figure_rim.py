# SPDX-License-Identifier: GPL-3.0-or-later
"""Figure 2: where a reflecting band sends the material, and the rim that it raises over that of finite elements."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from drawing import INK, View, save, show, surface
from scipy import sparse
from scipy.sparse import linalg
from truths import load

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.material import packing

RADIUS, SURFACE, SIDE = 32.0, 112, 193
COMPARED, DEEP = (0.15, 0.3), 0.5
"""Depths in radii: those of the finite elements, and one at which the flow can be seen."""
RIM = packing(young_modulus=500.0, yield_stress=1.0).rim
"""Of the solid that the finite elements are of: its hats' radius in contact radii, by the rule."""
FLOW_ACROSS, FLOW_DEEP, FLOW_ABOVE = 78, 72, 14
"""Extent in voxels of the half section in which the flow is drawn."""


def press(depth_in_radii: float, rim: float = 2.0) -> np.ndarray:
    """Press a sphere into a packed block, the band one radius ahead of it; the density after (nx, ny, nz)."""
    block = np.zeros((SIDE, SIDE, SURFACE + 28), np.float32)
    block[:, :, :SURFACE] = 1.0
    push = Push(DensityGrid(block), SphereTool(RADIUS), Material(3.3, 0.002), border="wall", band=RADIUS, rim=rim)
    top, depth = SURFACE - 0.5 + RADIUS, depth_in_radii * RADIUS
    for z in np.linspace(top, top - depth, int(np.ceil(depth / 0.5)) + 1):
        push.move_to((SIDE // 2, SIDE // 2, z))
    return push.grid.density


def by_radius(values: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Means of ``values`` (nx, ny, ...) over rings of ``width`` voxels about the middle: radii (n,), means (n, ...)."""
    offsets = np.arange(SIDE) - SIDE // 2
    ring = np.floor(np.hypot(*np.meshgrid(offsets, offsets, indexing="ij")) / width + 0.5).astype(int).ravel()
    count = np.bincount(ring)
    flat = values.reshape(SIDE * SIDE, -1)
    means = np.stack([np.bincount(ring, column) / np.maximum(count, 1) for column in flat.T], axis=1)
    return np.arange(len(count)) * width, means.reshape(len(count), *values.shape[2:])


def least_flow(change: np.ndarray, material: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The potential flow that carries ``change`` (rings, heights), voxels' worth of each voxel, through ``material``.

    Axisymmetric: the flow (radial, upward) at the cells' centres, with no flow through the edge of the material or of
    the array. Of all flows that do it, this one has the least sum of squares.
    """
    rings, heights = change.shape
    number = np.full(change.shape, -1)
    number[material] = np.arange(material.sum())
    radius = np.arange(rings)
    area = np.where(radius > 0, 2 * np.pi * radius, np.pi / 4)[:, None]  # of a ring, a voxel wide
    outer = (2 * np.pi * (radius + 0.5))[:, None] * np.ones(heights)  # of the wall between it and the next
    links = []
    for first, second, size in (
        (number[:-1], number[1:], outer[:-1]),
        (number[:, :-1], number[:, 1:], (area * np.ones(heights))[:, :-1]),
    ):
        joined = (first >= 0) & (second >= 0)
        links.append((first[joined], second[joined], size[joined]))
    a, b, size = (np.concatenate(part) for part in zip(*links))
    laplacian = sparse.csgraph.laplacian(
        sparse.coo_matrix((np.r_[size, size], (np.r_[a, b], np.r_[b, a])), shape=(number.max() + 1,) * 2)
    )
    source = (change * area)[material]
    source -= source.sum() * (area * np.ones(heights))[material] / (area * np.ones(heights))[material].sum()
    potential = np.zeros(change.shape)
    solved = linalg.spsolve((laplacian + 1e-9 * sparse.identity(len(source))).tocsc(), source)
    potential[material] = solved
    # Mass flows up the potential: where it arrives, change > 0 is a peak of it.
    radial, upward = np.zeros(change.shape), np.zeros(change.shape)
    step = np.where(material[1:] & material[:-1], potential[1:] - potential[:-1], 0.0)
    radial[1:] += step / 2
    radial[:-1] += step / 2
    step = np.where(material[:, 1:] & material[:, :-1], potential[:, 1:] - potential[:, :-1], 0.0)
    upward[:, 1:] += step / 2
    upward[:, :-1] += step / 2
    return radial, upward


def draw(path) -> None:
    figure = plt.figure(figsize=(13.2, 4.7), layout="constrained")
    flow, profile, picture = figure.subplots(1, 3, width_ratios=[1.25, 1.1, 1.0])
    deep = press(DEEP)
    _draw_flow(flow, deep)
    _draw_profile(profile)
    show(picture, surface(deep[20:-20, 20:-20, 40:], View(-60, 38, 460, 222)), f"the rim at {DEEP:g} R")
    save(figure, path)


def _draw_flow(axes, density: np.ndarray) -> None:
    bottom = SURFACE - FLOW_DEEP
    _, means = by_radius(density[:, :, bottom : SURFACE + FLOW_ABOVE], 1.0)
    means = means[: FLOW_ACROSS + 1]
    before = np.zeros(means.shape)
    before[:, :FLOW_DEEP] = 1.0
    tip = FLOW_DEEP - DEEP * RADIUS - 0.5
    band = int(np.floor(tip - RADIUS + 0.5))
    material = (means > 0.02) | (before > 0.0)
    material[:, :band] = False
    radial, upward = least_flow(means - before, material)
    change = np.concatenate([(means - before)[:0:-1], means - before])
    extent = (-FLOW_ACROSS - 0.5, FLOW_ACROSS + 0.5, -FLOW_DEEP, FLOW_ABOVE)
    image = axes.imshow(change.T, origin="lower", extent=extent, cmap="RdBu_r", vmin=-1, vmax=1, alpha=0.75)
    every = 6
    r, z = np.meshgrid(np.arange(3, FLOW_ACROSS, every), np.arange(band + 2, means.shape[1], every), indexing="ij")
    speed = np.hypot(radial[r, z], upward[r, z])
    drawn = material[r, z] & (speed > 0.01 * np.percentile(speed, 99))
    r, z, speed = r[drawn], z[drawn], speed[drawn]
    length = np.sqrt(speed / np.percentile(speed, 97)) / speed
    u, v = radial[r, z] * length, upward[r, z] * length
    arrows = {"color": INK, "angles": "xy", "scale_units": "xy", "scale": 0.11, "width": 0.0032}
    for side in (-1, 1):
        axes.quiver(side * r, z + 0.5 - FLOW_DEEP, side * u, v, **arrows)
    axes.axhline(band - FLOW_DEEP, color="#b06d00", lw=2.0)
    axes.text(
        -FLOW_ACROSS + 2,
        band - FLOW_DEEP - 1,
        "reflecting band, R ahead of the tool",
        va="top",
        color="#8a5500",
        fontsize=9,
    )
    axes.axhline(0.0, color=INK, lw=0.6, ls=":")
    axes.add_patch(plt.Circle((0, RADIUS - DEEP * RADIUS), RADIUS, fill=False, ec="#e09000", lw=1.6))
    axes.set(
        xlim=(-FLOW_ACROSS, FLOW_ACROSS), ylim=(-FLOW_DEEP + 10, FLOW_ABOVE), xlabel="voxels", ylabel="height (voxels)"
    )
    axes.set_title(f"What moved: R = {RADIUS:g}, {DEEP:g} R deep, packed clay\narrows: the least flow that carries it")
    axes.figure.colorbar(image, ax=axes, orientation="horizontal", shrink=0.7, aspect=30, label="change of density")


def _draw_profile(axes) -> None:
    truth = load("mises-500")
    for depth, style in zip(COMPARED, ("-", "--")):
        at = int(np.argmin(np.abs(truth.depths - depth)))
        label = f"finite elements, {depth:g} R: rim {truth.rim[at]:.2f}"
        axes.plot(truth.profile_r, truth.profile_z[at] / depth, color=INK, lw=2.2, ls=style, label=label)
        for rim, colour, name in ((RIM, "#c8432b", f"hats of {RIM:g} a, the rule's"), (2.0, "#e0a040", "of 2 a")):
            height = (press(depth, rim).sum(axis=2, dtype=np.float64) - SURFACE) / (depth * RADIUS)
            radius, means = by_radius(height, 1.0)
            axes.plot(radius / RADIUS, means, color=colour, lw=1.6, ls=style, label=f"{name}: rim {means.max():.2f}")
    axes.axhline(0.0, color=INK, lw=0.6)
    axes.set(xlim=(0.35, 2.2), ylim=(-0.35, 0.75), xlabel="distance from the axis, r / R", ylabel="height / depth")
    axes.set_title("The rim it raises\nagainst von Mises finite elements, E/Y = 500")
    axes.legend(loc="upper right", fontsize=8)
