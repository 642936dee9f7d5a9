# SPDX-License-Identifier: GPL-3.0-or-later
"""From models that come at the collision's rate to a force at the loop's: the couplings that are compared.

``hold`` keeps the last force; ``interpolate`` goes from the last but one to the last (the paper); ``local`` follows the
tangent of the last; ``in_loop`` estimates within the loop itself, on a grid that it shares. All of them are felt by the
product's own device/force.py.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

from repousse.device.force import Felt, felt_force, surface_known
from repousse.device.limits import PERIOD, Limits
from repousse.device.protocol import Coupling as Way
from repousse.device.protocol import ForceModel

Triple = tuple[float, float, float]
ZERO: Triple = (0.0, 0.0, 0.0)


class Coupling(Enum):
    """Which, by its name in the table."""

    HOLD = "hold"
    INTERPOLATE = "interpolate"
    LOCAL = "local"
    IN_LOOP = "in_loop"


class Coupled:
    """A coupling at work. ``feel`` is what the loop would find if it asked the material itself."""

    def __init__(self, coupling: Coupling, limits: Limits, feel: Callable[[Triple, float], ForceModel]) -> None:
        self._coupling, self._limits, self._feel = coupling, limits, feel
        self.model: ForceModel | None = None
        self._former = self._surface = self.model
        self._taken = 0.0

    def take(self, model: ForceModel, now: float) -> None:
        """A model has arrived."""
        self._former, self.model, self._taken = self.model, model, now
        self._surface = surface_known(model, self._surface)

    def felt(self, place: Triple, velocity: Triple, now: float) -> Felt:
        """The force on the tip, before safety."""
        model, way = self.model, Way.LOCAL
        if self._coupling is Coupling.LOCAL:
            model = self._surface
        elif self._coupling is Coupling.IN_LOOP:
            model = self.model = self._feel(place, now)
        elif self._coupling is Coupling.INTERPOLATE:
            way = Way.INTERPOLATE
        elif model is not None:
            model = model._replace(gradient=ZERO)
        return felt_force(model, self._former, place, velocity, now, self._limits, way, self._taken)


class Passivity:
    """A passivity observer and controller (Hannaford and Ryu, IEEE T-RA 18(1), 2002) at the port to the hand.

    The observer counts what the hand has put in, exactly so for a force that is held: E(n) = E(n-1) - F(n-1) . dx(n).
    Of the period that begins it takes that the tip moves on as it did. Where the hand would then have got back more
    than it gave, E - F . v T < 0, the controller adds the damping alpha that makes this 0: F - alpha v, with
    alpha = (F . v T - E) / (T v^2), at most ``most`` (N s/m).
    """

    def __init__(self, place: Triple, most: float) -> None:
        self.energy = 0.0
        self._most = most
        self._force, self._place = ZERO, place

    def controlled(self, force: Triple, place: Triple) -> Triple:
        """The force that is given, in place of ``force``; called once in a period."""
        x, y, z = (b - a for a, b in zip(self._place, place, strict=True))
        self.energy -= _dot(self._force, (x, y, z))
        missing, square = _dot(force, (x, y, z)) - self.energy, x * x + y * y + z * z
        if missing > 0.0 and square > 0.0:
            share = min(missing / square, self._most / PERIOD)
            force = force[0] - share * x, force[1] - share * y, force[2] - share * z
        self._force, self._place = force, place
        return force


def _dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
