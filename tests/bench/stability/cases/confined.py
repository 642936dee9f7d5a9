# SPDX-License-Identifier: GPL-3.0-or-later
"""A tool that has no room, or is wholly inside, or at the border of the grid, or not alone, or of an extreme size."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from repousse.core import DensityGrid, Material, Push, SphereTool
from repousse.core.local_model import Feeler
from repousse.core.material import largest_yield_ratio
from repousse.core.symmetry import SymmetricPush
from tests.core.volumes import line

from ..contact import (
    FULL_FORCE,
    MIDDLE,
    RADIUS,
    SIDE,
    SURFACE,
    YIELD_RATIO,
    Run,
    above,
    block,
    coming,
    excess,
    pushed,
    run,
    total,
)
from ..figure import Figure, exactly
from .moving import JND, LEAST_STEP, MASS, SWEEPS

ROUNDING = 1e-9
"""Share of a force by which it may exceed its bound."""
PUT_BACK = 1e-3
"""Density by which a voxel may differ where all that was taken came back: the outermost shells have it first."""


def _sound(case: str, grid: DensityGrid, before: float, met: Run) -> Iterator[Figure]:
    """What holds always: mass, bounds, sweeps, and a force that is min(sigma, sigma_f)."""
    over = (met.strength - np.minimum(met.stress, met.yield_stress)).max()
    yield Figure(case, "mass won or lost", abs(total(grid) + met.out - before) / before, "of all", MASS)
    yield Figure(case, "density out of [0, 1]", excess(grid), "", 0.0)
    yield Figure(case, "sweeps to a solve", met.sweeps, "", SWEEPS)
    yield Figure(case, "force over min(sigma, sigma_f)", max(0.0, float(over)), "N", FULL_FORCE * ROUNDING)


def no_room() -> Iterator[Figure]:
    """A saturated block between walls: nothing can move, and everything says so."""
    for band in (None, float(RADIUS)):
        case = f"no room, band {band}"
        grid = DensityGrid(np.ones((SIDE,) * 3, np.float32))
        push, before = pushed(grid, band=band), total(grid)
        run(push, [(MIDDLE,) * 3])  # there is neither a move nor a normal yet to tell which way
        met = run(push, line((MIDDLE,) * 3, (MIDDLE + 3.0, MIDDLE + 2.0, MIDDLE + 1.0), 0.4)[1:])
        yield from _sound(case, grid, before, met)
        yield exactly(case, "poses that are blocked", met.blocked / len(met.place), 1.0, "of all")
        clamped = np.abs(met.strength - met.yield_stress).max() / met.yield_stress.max()
        yield Figure(case, "force apart from sigma_f", float(clamped), "of it", ROUNDING)
        yield Figure(case, "change of a voxel", float(np.abs(grid.density - 1.0).max()), "", PUT_BACK)


TURNED = 4
"""Poses of a quarter voxel after which a tool that goes back is told to do so: core/push.py asks for a quarter."""


def inside_and_out() -> Iterator[Figure]:
    """Set down wholly inside, moved on by a voxel, and pulled out through the surface: it drags, all the way.

    Which way the force points turns round with the tool (the paper's "opposed to motion"): a hand that is led there by
    device/force.py is another case. How strong it is does not step.
    """
    for density, band in ((0.5, None), (1.0, None), (1.0, float(RADIUS))):
        case = f"inside and out, density {density}, band {band}"
        grid = block(density)
        push, before = pushed(grid, band=band), total(grid)
        first = run(push, [above(2.0 * RADIUS + 1.0), above(2.0 * RADIUS + 2.0, 0.5)])
        met = run(push, [above(depth, 0.5) for depth in coming(2.0 * RADIUS + 2.0, -1.0, 0.25)])
        steps = np.abs(np.diff(met.strength)) / np.maximum(JND * met.strength[:-1], LEAST_STEP)
        yield from _sound(case, grid, before, met)
        yield Figure(case, "force where it was set down and moved", float(first.strength[-1]), "N", at_least=0.01)
        yield Figure(case, "step of its strength over what is felt", float(steps.max()), "", 1.0)
        yield Figure(case, "force upward while it goes up", float(met.force[TURNED:, 2].max()), "N", 0.0)


def corners_and_edges() -> Iterator[Figure]:
    """Along and over the eight corners and twelve edges of a full grid, half outside: each alike."""
    places = [p for p in product((0.0, 0.5, 1.0), repeat=3) if p.count(0.5) <= 1]
    for border in ("grow", "wall", "open"):
        case = f"corners and edges, border {border}"
        ends, figures = {True: [], False: []}, []
        for place in places:
            grid = DensityGrid(np.full((SIDE - 8,) * 3, 0.7, np.float32))
            before, at = total(grid), np.array(place) * (SIDE - 9)
            inward = np.sign(0.5 - np.array(place))
            inward /= np.linalg.norm(inward)
            met = run(pushed(grid, 5, border=border), line(at - 7.0 * inward, at + 3.0 * inward, 0.5))
            figures += _sound(case, grid, before, met)
            ends[0.5 in place].append((met.force[-1] @ inward, met.strength[-1]))
        for what in dict.fromkeys(figure.what for figure in figures):
            yield max((figure for figure in figures if figure.what == what), key=lambda figure: figure.measured)
        for edge, forces in ends.items():
            along, strength = np.array(forces).T
            kind = "edges" if edge else "corners"
            yield Figure(case, f"force inward at {kind}", float((along / strength).max()), "of it", -0.99)
            yield Figure(case, f"unlikeness of {kind}", float(np.ptp(strength) / strength.mean()), "", SAME)


SAME = 1e-3
"""Share of their force by which corners of one grid may differ: the order in which sums are added."""
OVERLAP = 0.05
"""Share of what moved by which the halves of a grid may differ where two mirrored tools overlap: each finds what the
other has left, so the second has less to do (core/symmetry.py)."""


def overlapping_tools() -> Iterator[Figure]:
    """Two mirrored tools that share half of their radius, pressed in and drawn apart and together again."""
    for density, band in ((0.5, None), (1.0, float(RADIUS))):
        case = f"two tools that overlap, density {density}"
        grid = block(density)
        middle = (MIDDLE,) * 3
        tool, material = SphereTool(RADIUS), Material(FULL_FORCE, YIELD_RATIO)
        push = SymmetricPush(grid, tool, material, border="wall", band=band, axes="x", centre=middle)
        before, start = total(grid), grid.density.astype(np.float64)
        path = [above(depth, RADIUS / 2) for depth in coming(-1.0, 4.0, 0.25)]
        path += [above(4.0, aside) for aside in (*coming(RADIUS / 2, RADIUS, 0.25), *coming(RADIUS, 0.0, 0.25))]
        met = run(push, path)
        sweeps = met._replace(sweeps=-(-met.sweeps // 2))
        yield from _sound(case, grid, before, sweeps)
        after = grid.density.astype(np.float64)
        unlike = np.abs(after - after[::-1]).sum() / np.abs(after - start).sum()
        yield Figure(case, "unlikeness of the halves", float(unlike), "of what moved", OVERLAP)


DIG = Material(FULL_FORCE, 1e-6)
"""What another tool sees: it empties itself wholly."""


def vanishing() -> Iterator[Figure]:
    """What is under a tool that rests goes away: over an open border, by another tool, by a pull."""
    down, aside = (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)
    through, across = coming(SURFACE + 14.0, 2.0, 0.5), coming(MIDDLE - 8.0, MIDDLE + 20.0, 0.5)
    ways = {
        "an open border": ("push", 14.0, down, [(MIDDLE, MIDDLE, z) for z in through]),
        "another tool": ("push", 7.0, aside, [(x, MIDDLE, SURFACE - 3.0) for x in across]),
        "a pull": ("pull", 7.0, aside, [(x, MIDDLE, SURFACE - 3.0) for x in across]),
    }
    for name, (verb, radius, along, path) in ways.items():
        case = f"material taken by {name}"
        grid = block(1.0)
        push = pushed(grid)
        run(push, [above(depth) for depth in coming(-1.0, 3.0, 0.25)])
        taker, before, out = pushed(grid, radius, DIG, border="open", verb=verb), total(grid), 0.0
        felt, normals = [_felt(push)[0]], []
        for place in path:
            out += taker.move_to(place, direction=along).mass_out
            force, normal = _felt(push)
            felt.append(force)
            normals.append(normal)
        steps = np.diff(felt)
        yield Figure(case, "force before", felt[0], "N", at_least=0.05)
        yield Figure(case, "force that is left", felt[-1] / felt[0], "of it", 0.5)
        yield Figure(
            case, "greatest loss while the taker moves half a voxel", float(-steps.min()) / felt[0], "of it", 0.5
        )
        yield Figure(case, "least force", min(felt), "N", at_least=0.0)
        yield Figure(case, "longest normal", max(normals), "", 1.0 + ROUNDING)
        yield Figure(case, "mass won or lost", abs(total(grid) + out - before) / before, "of all", MASS)


def _felt(push: Push) -> tuple[float, float]:
    """The force (N) that a hand feels that rests where a push is, and the length of the normal."""
    assert push.position is not None
    model = Feeler(push).feel(push.position, push.tool)
    assert model is not None
    return max(0.0, min(model.stress, model.yield_stress)), float(np.linalg.norm(model.normal))


PROPORTIONAL = 1e-9
"""Share of the force by which it may be off its proportion to the material's stiffness."""
RADII = (1.0, 2.0, 30.0)
STIFFNESSES = (1e-6, 1e6)
"""Newtons of a tool wholly inside."""
VOXELS = (1e-9, 1e9)
"""Edges of a voxel in world units."""


def extremes() -> Iterator[Figure]:
    """The smallest tool there may be and one as large as its block; forces and voxels a million times off; yield
    ratios from next to none to the bound."""
    for radius in RADII:
        case = f"radius {radius:g}"
        side = int(4 * radius) + 12
        grid = block(0.7, side // 2, side)
        push, before, middle = pushed(grid, radius, band=radius), total(grid), (side - 1) / 2
        heights = coming(side // 2 + radius, side // 2 - radius, 0.5)
        yield from _sound(case, grid, before, run(push, [(middle, middle, z) for z in heights]))
    plain_grid = block(0.7)
    plain = run(pushed(plain_grid), PRESS)
    for newtons in STIFFNESSES:
        case = f"full force {newtons:g} N"
        grid = block(0.7)
        met = run(pushed(grid, material=Material(newtons, YIELD_RATIO)), PRESS)
        apart = np.abs(met.force * (FULL_FORCE / newtons) - plain.force).max() / plain.strength.max()
        yield Figure(case, "force out of proportion", float(apart), "of it", PROPORTIONAL)
        yield exactly(case, "voxels that differ", float((grid.density != plain_grid.density).sum()), 0.0)
    for edge in VOXELS:
        case = f"voxels of {edge:g}"
        grid = DensityGrid(block(0.7).density, np.diag((edge, edge, edge, 1.0)))
        met = run(pushed(grid), PRESS)
        yield exactly(case, "forces that differ", float((met.force != plain.force).sum()), 0.0)
        yield exactly(case, "voxels that differ", float((grid.density != plain_grid.density).sum()), 0.0)
    for ratio in (1e-9, 0.999 * largest_yield_ratio(SphereTool(RADIUS))):
        case = f"yield ratio {ratio:.3g}"
        grid = block(0.7)
        before = total(grid)
        yield from _sound(case, grid, before, run(pushed(grid, material=Material(FULL_FORCE, ratio)), PRESS))


PRESS = [above(depth) for depth in coming(-1.0, 6.0, 0.25)]

CASES = (no_room, inside_and_out, corners_and_edges, overlapping_tools, vanishing, extremes)
