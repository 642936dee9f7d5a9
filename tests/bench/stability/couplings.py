# SPDX-License-Identifier: GPL-3.0-or-later
"""From models that come at the collision's rate to a force at the loop's: the couplings that are compared.

``hold`` keeps the last force; ``interpolate`` goes from the last but one to the last (the paper); ``local`` follows the
tangent of the last; ``in_loop`` estimates within the loop itself, on a grid that it shares. All of them are felt by the
product's own device/force.py.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from math import hypot

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

    The observer counts what the hand has put in, exactly so for a force that is held: E += -F . dx. Where it has got
    back more, E < 0, the controller adds the damping that makes up for it within a period, alpha = -E / (T v^2), but no
    more than the device can render (N s/m).
    """

    def __init__(self, most: float) -> None:
        self.energy = 0.0
        self._most = most
        self._force = self._place = ZERO

    def observe(self, place: Triple) -> Triple:
        """A period is over; returns the way it took."""
        way = tuple(b - a for a, b in zip(self._place, place, strict=True))
        self.energy -= sum(f * w for f, w in zip(self._force, way, strict=True))
        self._place = place
        return way  # type: ignore[return-value]

    def controlled(self, force: Triple, place: Triple) -> Triple:
        """The force that may be given."""
        way = self.observe(place)
        square = hypot(*way) ** 2
        if self.energy < 0.0 and square > 0.0:
            alpha = min(-self.energy * PERIOD / square, self._most)
            x, y, z = (f - alpha * w / PERIOD for f, w in zip(force, way, strict=True))
            force = (x, y, z)
        return force

    def given(self, force: Triple) -> None:
        """This is what the arm got."""
        self._force = force
