# SPDX-License-Identifier: GPL-3.0-or-later
"""What the methods are tried on: each trial has its scenes, the truth about them, and says how wrong an outcome is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from . import column, errors, physics, scenes
from .measure import Outcome
from .method import Scene

Errors = dict[str, float]


@dataclass(frozen=True)
class Trial:
    """One truth.

    ``scenes`` are pressed one after another, each in a process of its own; the first is the one that is timed.
    ``judge`` gets their outcomes, and for a trial with a ``reference`` (module, name, setting) the outcome of that
    method in the first scene.
    """

    name: str
    title: str
    scenes: Callable[[], Sequence[Scene]]
    judge: Callable[[Sequence[Outcome], Outcome | None], Errors]
    reference: tuple[str, str, str] | None = None


@cache
def _column() -> tuple[Scene]:
    return (column.scene(),)


def _judge_column(outcomes: Sequence[Outcome], _reference: Outcome | None) -> Errors:
    (scene,), found = _column(), outcomes[0]
    depth = scenes.depths(scene)
    truth = np.zeros(scene.density.shape)
    truth[:] = column.density(depth[-1], scenes.face(scene), scene.density.shape[2])
    return {
        "err_mass": errors.mass(scene.density, found.density),
        "err_density_l1": errors.density_l1(scene.density, truth, found.density),
        "err_density_w1": errors.density_w1(scene.density, truth, found.density, 2, scenes.face(scene)),
        "err_force": errors.force(column.LAW.pressed(depth), found.force),
        "yield depth": abs(errors.yield_depth(depth, found.force) / column.LAW.yield_depth - 1.0),
    }


@cache
def _recursion() -> tuple[Scene]:
    return (scenes.press(80, 56, 24, 16.0, 12.0, 0.5, 0.1),)


def _judge_recursion(outcomes: Sequence[Outcome], reference: Outcome | None) -> Errors:
    (scene,), found = _recursion(), outcomes[0]
    assert reference is not None
    return {
        "err_mass": errors.mass(scene.density, found.density),
        "err_density_l1": errors.density_l1(scene.density, reference.density, found.density),
        "err_density_w1": errors.density_w1(scene.density, reference.density, found.density, 2, scenes.face(scene)),
        "err_force": errors.force(reference.force, found.force),
    }


DIRECTIONS = ((0.0, 0.0, -1.0), (1.0, 1.0, 0.0), (1.0, 1.0, 1.0), (0.8, 0.5, 0.33))


@cache
def _direction() -> tuple[Scene, ...]:
    return tuple(scenes.aslant(64, 12.0, 10.0, 0.5, 0.1, u) for u in DIRECTIONS)


def _judge_direction(outcomes: Sequence[Outcome], _reference: Outcome | None) -> Errors:
    straight, *oblique = (scenes.rings(scene, found.density) for scene, found in zip(_direction(), outcomes))
    first = _direction()[0]
    return {
        "err_mass": max(errors.mass(s.density, o.density) for s, o in zip(_direction(), outcomes)),
        "err_direction": errors.direction(straight, oblique),
        "symmetry": errors.symmetry(first.density, outcomes[0].density, 2),
    }


def _judge_press(name: str, outcomes: Sequence[Outcome]) -> Errors:
    scene, found = physics.scene(name), outcomes[0]
    press = physics.truth(name)
    wrong = {
        "err_mass": errors.mass(scene.density, found.density),
        "err_force": errors.force(physics.force(name, scene), found.force),
        "err_pileup": errors.pile_up(float(press.rim[-1]), physics.rim(scene, found.density)),
        "symmetry": errors.symmetry(scene.density, found.density, 2),
    }
    if physics.crushable(name):
        truth = physics.density(scene, press.density[-1])
        wrong["err_density_l1"] = errors.density_l1(scene.density, truth, found.density)
        wrong["err_density_w1"] = errors.density_w1(scene.density, truth, found.density, 2, scenes.face(scene))
    else:
        wrong["err_density_l1"] = errors.occupancy(
            physics.surface(scene, press.profile_z[-1]), physics.heights(scene, found.density)
        )
    return wrong


def _press(name: str, title: str) -> Trial:
    return Trial(name, title, lambda: (physics.scene(name),), lambda outcomes, _: _judge_press(name, outcomes))


TRIALS = {
    trial.name: trial
    for trial in (
        _press("foam-500", "finite elements of a crushable foam, E/Y = 500"),
        _press("mises-500", "finite elements of a von Mises solid, E/Y = 500"),
        Trial("column", "the law in closed form", _column, _judge_column),
        Trial(
            "recursion", "the paper's recursion", _recursion, _judge_recursion, ("recursive", "recursive", "literal")
        ),
        Trial("direction", "the same push along an axis", _direction, _judge_direction),
    )
}
