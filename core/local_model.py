# SPDX-License-Identifier: GPL-3.0-or-later
"""The local model: the material around one pose, for a loop that is faster than any estimate (DESIGN 4)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot
from time import perf_counter

from .native.state import Probe, shape_state
from .plasticity import FADE, contact_normal, estimate, stress_gradient, stresses
from .push import Push
from .symmetry import SymmetricPush
from .tool import Tool, Vector

Turning = tuple[Vector, Vector, Vector]

NONE: Turning = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
ASIDE = 0.5
"""Voxels by which the tool is felt aside, on both sides, to learn how the normal turns: the skin of a tool is one voxel
thick, so nearer by, which voxels are in it would count for more than where they are."""


@dataclass(frozen=True)
class LocalModel:
    """What the hand feels at one pose, and how that changes nearby.

    At a pose x the force is clamp(stress + gradient . (x - position), 0, yield_stress) along ``normal``, turned by
    sum over axes a of turning[a] (x - position)[a].

    ``position`` is in voxels, in the frame of the push's poses; ``stress`` (sigma) and ``yield_stress`` (sigma_f) are
    in newtons, ``gradient`` is that of sigma in newtons per voxel, ``normal`` points out of the material and fades
    where the surroundings are uniform; ``turning`` is its derivative by each axis, per voxel, across it.
    ``exponent`` is that of the power of M_t as which sigma grows here.
    So the voxels were at ``time`` (perf_counter, seconds), in this ``epoch`` of the push.
    """

    epoch: int
    time: float
    position: Vector
    stress: float
    yield_stress: float
    gradient: Vector
    normal: Vector
    exponent: float = 1.0
    turning: Turning = NONE


class Feeler:
    """Estimates around a pose while another thread pushes, and knows when mass in flight made that worthless.

    ``estimates`` counts those that were made. Of mirrored tools the artist's is felt. How the normal turns is estimated
    where it is asked for with ``turning``: an arm's loop needs it, and it takes two more estimates' time.
    """

    def __init__(self, push: Push | SymmetricPush, turning: bool = False) -> None:
        self.estimates = 0
        self._turns = turning
        self._push = push
        bricks = push.grid.bricks
        self._probe, self._aside = Probe(bricks.density, bricks), Probe(bricks.density, bricks)
        self._tool: Tool | None = None
        self._asked: tuple[int, Vector, Tool] | None = None  # what the last answer holds for
        self._model: LocalModel | None = None

    def feel(self, position: Vector, tool: Tool) -> LocalModel | None:
        """The local model at a pose of the tool, or None when mass was in flight meanwhile.

        As long as neither the pose nor the voxels change, the last answer holds: only its time is new.
        """
        time, epoch = perf_counter(), self._push.epoch
        if epoch % 2:
            return None
        if self._model is not None and self._asked == (epoch, position, tool):
            self._model = replace(self._model, time=time)
            return self._model
        self._estimate(position, tool)
        turning = self._turning() if self._turns else NONE
        if self._push.epoch != epoch:
            return None
        self._asked = (epoch, position, tool)
        masses, material = self._probe.estimate, self._push.material
        stress, yield_stress = stresses(masses, material, self._k_t, self._k_s, self._push.verb == "push")
        slope, exponent = stress_gradient(masses, material, self._k_t)
        normal = contact_normal(tuple(masses.gradient))
        self._model = LocalModel(epoch, time, position, stress, yield_stress, slope, normal, exponent, turning)
        return self._model

    def _estimate(self, position: Vector, tool: Tool) -> None:
        """Into the probe; nonsense, but harmless, when the grid grows meanwhile."""
        probe, bricks, origin = self._probe, self._push.grid.bricks, self._push.origin
        if tool is not self._tool:
            self._tool = tool
            probe.take_up(tool)
            self._aside.take_up(tool)
            self._aside.surroundings = self._aside.volume  # nobody asks how hard it is there
            self._aside.tool.surroundings = shape_state(self._aside.volume)
            self._k_t, self._k_s = self._push.material.stiffness(tool)
        if bricks is not probe.bricks:
            probe.attach(bricks.density, bricks)
            self._aside.attach(bricks.density, bricks)
        probe.tool.centre[:] = [p - o for p, o in zip(position, origin, strict=True)]
        estimate(probe)
        self.estimates += 1

    def _turning(self) -> Turning:
        """How the normal n = -g/|g| turns with the tool: dn = -(dg - (dg . n) n) / |g|, with g = grad M_t felt aside
        along each axis. None where the normal fades: what points nowhere does not turn."""
        gx, gy, gz = self._probe.estimate.gradient
        length = hypot(gx, gy, gz)
        if length < FADE:
            return NONE
        nx, ny, nz = gx / length, gy / length, gz / length
        share = -0.5 / (ASIDE * length)
        rows = []
        for axis in range(3):
            (ax, ay, az), (bx, by, bz) = self._gradient_aside(axis, -ASIDE), self._gradient_aside(axis, ASIDE)
            x, y, z = bx - ax, by - ay, bz - az
            along = x * nx + y * ny + z * nz
            rows.append((share * (x - along * nx), share * (y - along * ny), share * (z - along * nz)))
        return rows[0], rows[1], rows[2]

    def _gradient_aside(self, axis: int, way: float) -> Vector:
        """grad M_t where the tool is not."""
        aside = self._aside
        aside.tool.centre[:] = self._probe.tool.centre[:]
        aside.tool.centre[axis] += way
        estimate(aside)
        x, y, z = aside.estimate.gradient
        return x, y, z
