# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror symmetry: the artist's tool and its mirror images, each a push of its own through one grid."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from functools import reduce
from itertools import product
from math import isfinite
from typing import TYPE_CHECKING

from .grid import DensityGrid, union
from .history import History
from .material import Material
from .push import Contact, Push
from .tool import CapsuleTool, Tool, Vector, vector

if TYPE_CHECKING:
    from .stroke import Sample, Stroke


class SymmetricPush:
    """A :class:`Push` whose every move is repeated by its mirror images, one after the other.

    Parameters are those of :class:`Push`, and ``axes``: which of "x", "y", "z" are mirrored, at planes that meet in
    ``centre`` (x, y, z) in voxels. Where mirrored tools overlap each finds what the one before it has left.

    The artist's tool is the first of :attr:`pushes`; what is said of one tool is said of that one.

    Raises
    ------
    ValueError
        As :class:`Push`, or for axes that are not some of x, y and z, or a centre that is not three finite numbers.
    """

    def __init__(
        self,
        grid: DensityGrid,
        tool: Tool,
        material: Material,
        method: str = "sweep",
        border: str = "grow",
        band: float | None = None,
        rim: float = 2.0,
        wake: float = 1.0,
        verb: str = "push",
        quality: str = "exact",
        *,
        axes: str,
        centre: Iterable[float],
    ) -> None:
        if not (isinstance(axes, str) and axes and set(axes) <= set("xyz") and len(set(axes)) == len(axes)):
            raise ValueError(f'symmetry names some of the axes x, y and z, once each, not "{axes}"')
        self.axes, self.centre = axes, vector(centre)
        if not all(isfinite(c) for c in self.centre):
            raise ValueError(f"mirror planes meet in three finite numbers of voxels, not {self.centre}")
        turns = [(1.0, -1.0) if axis in axes else (1.0,) for axis in "xyz"]
        self._turns: list[Vector] = [vector(signs) for signs in product(*turns)]
        first = Push(grid, tool, material, method, border, band, rim, wake, verb, quality)
        how = (material, method, border, band, rim, wake, verb, quality)
        self.pushes = [first] + [Push(grid, _mirrored_tool(tool, turn), *how) for turn in self._turns[1:]]
        self._carries = [push.carry for push in self.pushes]

    @property
    def grid(self) -> DensityGrid:
        """The live grid."""
        return self.pushes[0].grid

    @property
    def tool(self) -> Tool:
        """The artist's tool."""
        return self.pushes[0].tool

    @property
    def tools(self) -> list[Tool]:
        """The artist's tool and its mirror images."""
        return [push.tool for push in self.pushes]

    @property
    def material(self) -> Material:
        """What all of them push."""
        return self.pushes[0].material

    @property
    def verb(self) -> str:
        """What all of them do."""
        return self.pushes[0].verb

    @property
    def k_t(self) -> float:
        """Newtons per voxel's worth in the tool (paper equation 4)."""
        return self.pushes[0].k_t

    @property
    def k_s(self) -> float:
        """Newtons per voxel's worth in the reach (paper equation 5)."""
        return self.pushes[0].k_s

    @property
    def origin(self) -> tuple[int, int, int]:
        """Where the grid's first voxel lies in the frame of the poses."""
        return self.pushes[0].origin

    @property
    def epoch(self) -> int:
        """Odd while mass of any of the tools is in flight, for only one at a time has any; only ever rises."""
        return sum(push.epoch for push in self.pushes)

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """The last contact of each tool, the artist's first."""
        return tuple(contact for push in self.pushes for contact in push.contacts)

    @property
    def voxels_visited(self) -> int:
        """Voxels of flux that all sweeps so far have looked at."""
        return sum(push.voxels_visited for push in self.pushes)

    @property
    def flow(self) -> str:
        """How density moves at the artist's tool; see :attr:`Push.flow`."""
        return self.pushes[0].flow

    def lift(self) -> None:
        """Take all tools out."""
        for push in self.pushes:
            push.lift()

    def move_to(
        self,
        position: Iterable[float],
        radius: float | None = None,
        continuous: bool = False,
        direction: Iterable[float] | None = None,
        strength: float | None = None,
        quality: str | None = None,
    ) -> Contact:
        """Move the artist's tool to ``position``, then each mirror image to where it stands then; see
        :meth:`Push.move_to`.

        The contact is the artist's tool's, with the masses of all and a box around all that changed.
        """
        place = tuple(position)
        flow = None if direction is None else vector(direction)
        met = []
        for push, turn in zip(self.pushes, self._turns, strict=True):
            there = None if flow is None else _turned(flow, turn)
            met.append(push.move_to(self._mirrored_place(place, turn), radius, continuous, there, strength, quality))
        return dataclasses.replace(
            met[0],
            moved_mass=sum(contact.moved_mass for contact in met),
            mass_out=sum(contact.mass_out for contact in met),
            blocked=any(contact.blocked for contact in met),
            sweeps=sum(contact.sweeps for contact in met),
            dirty=reduce(union, (contact.dirty for contact in met)),
        )

    def walk(self, sample: Sample, continuous: bool = False) -> Contact:
        """Move to one sample of a Stroke."""
        return self.move_to(
            sample.position, sample.radius, continuous, sample.direction, sample.strength, sample.quality
        )

    def follow(self, stroke: Stroke) -> list[Contact]:
        """Move through every sample of a Stroke."""
        return [self.walk(sample, stroke.continuous) for sample in stroke.samples]

    def remember(self) -> History:
        """Keep before-images of all that changes from here on."""
        history = self.pushes[0].remember()
        for push in self.pushes[1:]:
            push.join(history)
        self._carries = [push.carry for push in self.pushes]
        return history

    def restore(self, history: History) -> None:
        """Make the grid what it was when ``history`` began, bit for bit, and lift the tools."""
        self.pushes[0].restore(history)
        for push, carry in zip(self.pushes[1:], self._carries[1:], strict=True):
            push.forget(history, carry)

    def _mirrored_place(self, place: tuple[float, ...], turn: Vector) -> tuple[float, ...]:
        if len(place) != 3:
            return place  # for the push to refuse
        return tuple(p if sign > 0.0 else 2.0 * c - p for p, c, sign in zip(place, self.centre, turn, strict=True))


def _turned(flow: Vector, turn: Vector) -> Vector:
    return vector(f * sign for f, sign in zip(flow, turn, strict=True))


def _mirrored_tool(tool: Tool, turn: Vector) -> Tool:
    if isinstance(tool, CapsuleTool):
        return dataclasses.replace(tool, half_axis=_turned(tool.half_axis, turn))
    return tool
