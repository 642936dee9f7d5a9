# SPDX-License-Identifier: GPL-3.0-or-later
"""Choices that look simpler and fail, in a few plain lines each: for test_naive_choices.py alone, never for core."""

from itertools import product

import numpy as np

from repousse.core import Push

FORWARD = [(1, j, k) for j, k in product((-1, 0, 1), repeat=2)]
"""The nine neighbours ahead of a voxel, along the first axis."""


def whole_voxel_mass(density, centre, radius):
    """M_t with a voxel wholly in the tool, or not at all."""
    offsets = np.ogrid[tuple(slice(0, n) for n in density.shape)]
    distance2 = sum((offset - c) ** 2 for offset, c in zip(offsets, centre))
    return float(density[distance2 < radius * radius].sum(dtype=np.float64))


def empty_innermost_first(density, centre, radius):
    """One pass of "innermost voxels first": each pushes what it holds to the nine ahead of it, and these what they
    cannot take to the nine ahead of them."""
    tool = np.argwhere(_distance(density.shape, centre) < radius)
    for voxel in sorted(map(tuple, tool), key=lambda v: np.linalg.norm(np.subtract(v, centre))):
        mass, density[voxel] = density[voxel], 0.0
        _push_ahead(density, voxel, mass)


def empty_from_the_rear(density, centre, radius):
    """The same from the rear on."""
    for voxel in sorted(map(tuple, np.argwhere(_distance(density.shape, centre) < radius))):
        mass, density[voxel] = density[voxel], 0.0
        _push_ahead(density, voxel, mass)


def _distance(shape, centre):
    return np.sqrt(sum((offset - c) ** 2 for offset, c in zip(np.ogrid[tuple(slice(0, n) for n in shape)], centre)))


def _push_ahead(density, voxel, mass):
    """Plane by plane: what a plane has no room for, each of its voxels pushes on to the nine ahead of it."""
    i, j, k = voxel
    flux = np.zeros(density.shape[1:])
    flux[j - 1 : j + 2, k - 1 : k + 2] = mass / len(FORWARD)
    while flux.any():
        i += 1
        laid = np.minimum(flux, 1.0 - density[i])
        density[i] += laid
        rest = np.pad(flux - laid, 1)
        flux = sum(np.roll(rest, step[1:], (0, 1)) for step in FORWARD)[1:-1, 1:-1] / len(FORWARD)


def share_by_room(density, sources, mass):
    """Each source in turn shares its mass among the nine ahead of it in proportion to the room they have left."""
    for source in sources:
        ahead = [tuple(np.add(source, step)) for step in FORWARD]
        room = np.array([1.0 - density[voxel] for voxel in ahead])
        for voxel, part in zip(ahead, room / room.sum()):
            density[voxel] += min(mass * part, 1.0 - density[voxel])


def share_alike(density, sources, mass):
    """All sources at once share their mass by fixed weights; what a voxel cannot take is given to no other."""
    flux = np.zeros_like(density)
    for source in sources:
        for step in FORWARD:
            flux[tuple(np.add(source, step))] += mass / len(FORWARD)
    density += np.minimum(flux, 1.0 - density)


def opposed_to_motion(strength, velocity):
    """The paper's direction with no more ado: against the velocity."""
    speed = np.linalg.norm(velocity)
    return -strength * np.asarray(velocity) / speed if speed > 0.0 else np.zeros(3)


class OneSolve(Push):
    """A push that solves once for each pose, however far it is."""

    def _steps_to(self, target):
        return [target]


def float32_mass(density):
    """The mass of a grid, summed in its own precision, voxel after voxel as a loop does."""
    return float(np.add.accumulate(density.ravel(), dtype=np.float32)[-1])
