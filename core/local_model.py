# SPDX-License-Identifier: GPL-3.0-or-later
"""The local model: the material around one pose, for a loop that is faster than any estimate (DESIGN 4)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

from .native.state import Probe
from .plasticity import contact_normal, estimate, stress_gradient, stresses
from .push import Push
from .symmetry import SymmetricPush
from .tool import Tool, Vector


@dataclass(frozen=True)
class LocalModel:
    """What the hand feels at one pose, and how that changes nearby.

    At a pose x the force is clamp(stress + gradient . (x - position), 0, yield_stress) along ``normal``.

    ``position`` is in voxels, in the frame of the push's poses; ``stress`` (sigma) and ``yield_stress`` (sigma_f) are
    in newtons, ``gradient`` is that of sigma in newtons per voxel, ``normal`` points out of the material and fades
    where the surroundings are uniform. ``exponent`` is that of the power of M_t as which sigma grows here.
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


class Feeler:
    """Estimates around a pose while another thread pushes, and knows when mass in flight made that worthless.

    ``estimates`` counts those that were made. Of mirrored tools the artist's is felt.
    """

    def __init__(self, push: Push | SymmetricPush) -> None:
        self.estimates = 0
        self._push = push
        self._probe = Probe(push.grid.density)
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
        if self._push.epoch != epoch:
            return None
        self._asked = (epoch, position, tool)
        masses, material = self._probe.estimate, self._push.material
        stress, yield_stress = stresses(masses, material, self._k_t, self._k_s, self._push.verb == "push")
        slope, exponent = stress_gradient(masses, material, self._k_t)
        normal = contact_normal(tuple(masses.gradient))
        self._model = LocalModel(epoch, time, position, stress, yield_stress, slope, normal, exponent)
        return self._model

    def _estimate(self, position: Vector, tool: Tool) -> None:
        """Into the probe; nonsense, but harmless, when the grid grows meanwhile."""
        probe, density, origin = self._probe, self._push.grid.density, self._push.origin
        if tool is not self._tool:
            self._tool = tool
            probe.take_up(tool)
            self._k_t, self._k_s = self._push.material.stiffness(tool)
        if density is not probe.density:
            probe.attach(density)
        probe.tool.centre[:] = [p - o for p, o in zip(position, origin, strict=True)]
        estimate(probe)
        self.estimates += 1
