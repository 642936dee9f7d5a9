# SPDX-License-Identifier: GPL-3.0-or-later
"""What the local coupling did before, kept to show that it fails: so that nobody brings it back."""

from __future__ import annotations

from dataclasses import replace

from repousse.device.force import Felt, felt_force

from .couplings import Coupled, Triple


class BoundByAge(Coupled):
    """The slope of the newest model is bounded by the damping over the delay that a held force would have, half a
    period and the model's age, times seven; and a model of nothing is followed into the material."""

    def felt(self, place: Triple, velocity: Triple, now: float) -> Felt:
        if self.model is None:
            return Felt()
        limits = self._limits
        bound = 7.0 * limits.damping / (0.5 * limits.period + now - self.model.time)
        limits = replace(limits, max_stiffness=min(limits.max_stiffness, bound))
        return felt_force(self.model, None, place, velocity, now, limits)


class WithoutMemory(Coupled):
    """The newest model is followed, also where it feels nothing."""

    def felt(self, place: Triple, velocity: Triple, now: float) -> Felt:
        return felt_force(self.model, None, place, velocity, now, self._limits)
