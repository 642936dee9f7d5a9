# SPDX-License-Identifier: GPL-3.0-or-later
"""The force on the hand, from the last local model at the arm's present position (DESIGN 4)."""

from __future__ import annotations

from math import hypot, isfinite
from typing import NamedTuple

from .limits import Limits, Triple
from .protocol import Coupling, ForceModel
from .safety import Fault

ZERO: Triple = (0.0, 0.0, 0.0)


class Felt(NamedTuple):
    """A force (3,) in N on the hand, its ``magnitude`` in N, and the slopes in N/m that the material asked for and the
    loop could grant. ``fault`` is MODEL_NOT_FINITE or NOT_FINITE where nothing can be felt because of that."""

    force: Triple = ZERO
    asked: float = 0.0
    granted: float = 0.0
    magnitude: float = 0.0
    fault: Fault = Fault.NONE


NOTHING = Felt()


def felt_force(
    model: ForceModel | None,
    previous: ForceModel | None,
    position: Triple,
    velocity: Triple,
    now: float,
    limits: Limits,
    coupling: Coupling = Coupling.LOCAL,
) -> Felt:
    """The force of a model at ``position`` (m), moving at ``velocity`` (m/s), at the time ``now`` (s)."""
    if model is None or model.scene == 0:
        return NOTHING
    gx, gy, gz = model.gradient
    nx, ny, nz = model.normal
    mx, my, mz = model.position
    x, y, z = position
    vx, vy, vz = velocity
    rise = gx * (x - mx) + gy * (y - my) + gz * (z - mz)
    asked = hypot(gx, gy, gz)
    age = max(now - model.time, 0.0)
    granted = min(asked, limits.max_stiffness)
    if rise > 0.0:
        granted = min(granted, limits.damping / (0.5 * limits.period + age))
    if asked > 0.0:
        rise *= granted / asked
    magnitude = min(max(model.stress + rise, 0.0), model.yield_stress)
    if not isfinite(magnitude + nx + ny + nz + vx + vy + vz):
        return Felt(fault=Fault.MODEL_NOT_FINITE)
    return Felt((magnitude * nx, magnitude * ny, magnitude * nz), asked, granted, magnitude)
