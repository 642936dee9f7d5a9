# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror symmetry: what one tool does, its mirror images do as well, in a grid that stays one."""

import numpy as np
import pytest

from repousse.core import (
    CapsuleTool,
    DensityGrid,
    Material,
    Push,
    Sample,
    SphereTool,
    Stroke,
    SymmetricPush,
    dispersion,
)

from .volumes import carried, line

N = 56
CENTRE = ((N - 1) / 2,) * 3
FOAM = Material(3.3, 0.05)
VERBS = {
    "push": ((5.0, 13.0, 14.5), (12.0, 13.4, 14.0), {}),
    "pull": ((16.0, 12.5, 13.0), (17.0, 14.0, 14.5), {"direction": (-1.0, 0.0, 0.0), "strength": 0.3}),
    "smooth": ((10.0, 12.5, 13.0), (11.0, 15.0, 14.0), {"strength": 0.8}),
}


def body():
    """A block with a rough surface, mirror-symmetric about its middle in all three axes."""
    values = np.zeros((N,) * 3, np.float32)
    values[9:-9, 9:-9, 9:-9] = 0.4
    noise = np.random.default_rng(5).random((N,) * 3, np.float32)
    for axis in range(3):
        noise = (noise + np.flip(noise, axis)) / 2.0
    return np.where(values > 0.0, values + 0.3 * noise, 0.0).astype(np.float32)


def mirrors(axes):
    """Each mirror image of a grid of its own, as `carried` wants it."""
    return [tuple(a == axis for a in "xyz") for axis in axes]


def off_mirror(values, axes):
    return max(float(np.abs(values - carried(values, (0, 1, 2), turned)).max()) for turned in mirrors(axes))


@pytest.mark.parametrize("axes", ["x", "yz", "xyz"])
@pytest.mark.parametrize("verb", VERBS)
def test_the_grid_stays_mirror_symmetric(kernels, verb, axes):
    """To 1e-5 where the tools do not overlap; mass stays too, and every image does its share."""
    start, end, said = VERBS[verb]
    before = body()
    grid = DensityGrid(before)
    push = SymmetricPush(grid, SphereTool(4), FOAM, border="wall", verb=verb, axes=axes, centre=CENTRE)
    assert len(push.contacts) == len(push.tools) == 2 ** len(axes)
    contacts = [push.move_to(place, **said) for place in line(start, end, 0.5)]
    assert off_mirror(before, axes) == 0.0
    assert off_mirror(grid.density, axes) <= 1e-5
    assert grid.mass == pytest.approx(before.sum(dtype=np.float64), rel=1e-7)
    alone = Push(DensityGrid(before), SphereTool(4), FOAM, border="wall", verb=verb)
    for place, contact in zip(line(start, end, 0.5), contacts):
        one = alone.move_to(place, **said)
        assert contact.moved_mass == pytest.approx(one.moved_mass * 2 ** len(axes), rel=1e-4, abs=1e-4)
        assert contact.regime is one.regime
        assert contact.stress == pytest.approx(one.stress, rel=1e-6)
        assert contact.yield_stress == pytest.approx(one.yield_stress, rel=1e-6)
    assert sum(contact.moved_mass for contact in contacts) > 10.0
    changed = np.argwhere(grid.density != before)
    low = np.min([contact.dirty[0] for contact in contacts if contact.dirty], axis=0)
    high = np.max([contact.dirty[1] for contact in contacts if contact.dirty], axis=0)
    assert (changed >= low).all() and (changed < high).all()


def test_growth(kernels):
    """Every image makes the grid grow on its side, and the others follow."""
    values = np.zeros((40, 40, 40), np.float32)
    values[:, 4:36, 4:36] = 0.95
    grid = DensityGrid(values)
    push = SymmetricPush(grid, SphereTool(4), FOAM, axes="xz", centre=(19.5,) * 3)
    contacts = [push.move_to(place) for place in line((10.0, 19.5, 10.0), (2.0, 19.0, 9.5), 0.5)]
    assert grid.mass == pytest.approx(values.sum(dtype=np.float64), rel=1e-7)
    below, above = -push.origin[0], grid.shape[0] - 40 + push.origin[0]
    assert below == above > 0 and push.origin == tuple(-n for n in grid.grown)
    assert off_mirror(grid.density, "xz") <= 1e-5
    boxes = [contact.dirty for contact in contacts if contact.dirty]
    assert min(low[0] for low, _ in boxes) < 0 and max(high[0] for _, high in boxes) > 40
    assert min(low[0] for low, _ in boxes) == 40 - max(high[0] for _, high in boxes)


def test_a_finger_is_mirrored(kernels):
    """A capsule that lies aslant lies aslant the other way in the mirror, and its flow with it."""
    before = body()
    grid = DensityGrid(before)
    tool = CapsuleTool((1.0, 4.0, 2.0), 3.0)
    push = SymmetricPush(grid, tool, FOAM, border="wall", axes="y", centre=CENTRE)
    assert push.tool == tool and push.tools[1].half_axis == (1.0, -4.0, 2.0)
    for place in line((6.0, 15.0, 26.0), (12.0, 15.0, 26.0), 0.5):
        push.move_to(place, direction=(0.8, 0.0, 0.6))
    assert np.abs(grid.density - before).sum() > 50.0
    assert off_mirror(grid.density, "y") <= 1e-5


def test_radius_and_lift_reach_all(kernels):
    push = SymmetricPush(DensityGrid(body()), SphereTool(4), FOAM, axes="xy", centre=CENTRE)
    push.move_to((8.0, 14.0, 14.0), 5.0)
    assert [tool.radius for tool in push.tools] == [5.0] * 4
    assert all(contact.stress > 0.0 for contact in push.contacts)
    push.lift()
    assert all(contact.stress == 0.0 for contact in push.contacts)


@pytest.mark.parametrize("verb", VERBS)
def test_restores_bit_for_bit(kernels, verb):
    """All tools' changes, growth included; the same path again leads to the same voxels."""
    start, end, said = VERBS[verb]
    before = body()[9:-9, 9:-9, 9:-9]  # fills its grid: pushed or pulled it grows
    shift = np.array((9.0, 9.0, 9.0))
    grid = DensityGrid(before)
    push = SymmetricPush(grid, SphereTool(4), FOAM, verb=verb, axes="xyz", centre=np.array(CENTRE) - shift)
    ends = []
    for _ in range(2):
        history = push.remember()
        for place in line(start, end, 0.5):
            push.move_to(np.array(place) - shift, **said)
        ends.append((grid.density.tobytes(), grid.shape))
        epoch = push.epoch
        push.restore(history)
        assert grid.density.tobytes() == before.tobytes() and grid.shape == before.shape
        assert push.origin == (0, 0, 0) and push.epoch % 2 == 0 and push.epoch > epoch
    assert ends[0] == ends[1] and ends[0][0] != before.tobytes()
    assert (ends[0][1] != before.shape) == (verb != "smooth")


def test_epoch(kernels, monkeypatch):
    """Odd while mass of any of the tools is in flight; it only rises."""
    push = SymmetricPush(DensityGrid(body()), SphereTool(4), FOAM, axes="xy", centre=CENTRE)
    sweep, seen = dispersion.sweep, []
    monkeypatch.setattr(dispersion, "sweep", lambda work: (seen.append(push.epoch), sweep(work))[1])
    for place in line((6.0, 14.0, 14.0), (10.0, 14.0, 14.0), 0.5):
        push.move_to(place)
        seen.append(push.epoch + 1)  # even at rest
    assert len(set(seen)) > 8 and seen == sorted(seen)
    assert all(epoch % 2 for epoch in seen)


@pytest.mark.parametrize(
    ("axes", "centre"),
    [("", CENTRE), ("xx", CENTRE), ("w", CENTRE), (None, CENTRE), ("x", (1, 2)), ("x", (0, 0, float("inf")))],
)
def test_bad_mirrors(axes, centre):
    with pytest.raises(ValueError, match=r"axes|finite|unpack"):
        SymmetricPush(DensityGrid(body()), SphereTool(4), FOAM, axes=axes, centre=centre)


def test_bad_positions(kernels):
    """Refused before any of the tools has moved anything."""
    grid = DensityGrid(body())
    push = SymmetricPush(grid, SphereTool(4), FOAM, axes="x", centre=CENTRE)
    push.move_to((10.0, 14.0, 14.0))
    before = grid.density.tobytes()
    for place, said in (
        ((11.0, 14.0, float("nan")), {}),
        ((11.0, 14.0), {}),
        ((11.0, 14.0, 14.0), {"radius": 0.5}),
        ((11.0, 14.0, 14.0), {"direction": (1.0, 1.0, 1.0)}),
        ((11.0, 14.0, 14.0), {"strength": 2.0}),
    ):
        with pytest.raises(ValueError):
            push.move_to(place, **said)
    assert grid.density.tobytes() == before


@pytest.mark.parametrize("symmetry", ["", "x", "xyz"])
@pytest.mark.parametrize("verb", VERBS)
def test_a_stroke_of_each_verb_replays_to_the_same_voxels(kernels, tmp_path, verb, symmetry):
    """Through a file, bit for bit: with its direction, strength, radius and mirror."""
    start, end, said = VERBS[verb]
    direction = said.get("direction")
    if direction is not None:
        direction = tuple(np.array((-1.0, 0.03, 0.021)) * 1.0002)  # as an invoker computes it: a unit vector nearly
    samples = [
        Sample(0.01 * n, place, radius=4.0 + 0.02 * n, direction=direction, strength=0.5 - 0.01 * n)
        for n, place in enumerate(line(start, end, 0.37))
    ]
    mirror = CENTRE if symmetry else None
    stroke = Stroke(samples, SphereTool(4), FOAM, verb=verb, symmetry=symmetry, mirror=mirror)
    first, again = DensityGrid(body()), DensityGrid(body())
    stroke.push(first).follow(stroke)
    stroke.save(tmp_path / "stroke")
    loaded = Stroke.load(tmp_path / "stroke")
    assert loaded.symmetry == symmetry and loaded.verb == verb and loaded.mirror == mirror
    loaded.push(again).follow(loaded)
    assert np.abs(first.density - body()).sum() > 10.0
    assert again.density.tobytes() == first.density.tobytes()
    shifted = stroke.moved_by((3, -2, 1))
    assert shifted.samples[0].position == tuple(np.add(samples[0].position, (3, -2, 1)))
    assert shifted.mirror == (tuple(np.add(CENTRE, (3, -2, 1))) if symmetry else None)
