# SPDX-License-Identifier: GPL-3.0-or-later
"""The force on the hand: the last local models, felt where the arm is now (DESIGN 4).

A slope that is too steep to be rendered softens the whole force, not only its change since the model was made. Were
only the change less steep, the force would be too small on the way in and put right by the next model at the deepest
point, before the way out: that gives energy to the hand. In simulation (45 g arm, soft grip, a new model each
millisecond) a wall of 1500 N/m felt so with a cap of 800 N/m shakes the hand by 0.8 mm; softened, it is at rest.

A stress that grows as a power m < 1 of the depth has risen by sigma / depth = |gradient| / m on average, and that is
asked for: softened by the tangent's slope, the force of one model after the other would rise by 1 / m times what was
granted. In the same simulation sigma = 3.3 N (depth / 22 mm)^(1/2) then shakes the hand by 0.2 mm; as it is, by 0.001.
Of the tangent and the softened secant the lesser is felt: a force of position alone, and less as the model ages.
"""

from __future__ import annotations

from math import hypot, inf, isfinite, sqrt
from typing import NamedTuple

from .fault import Fault
from .limits import Limits, Triple
from .protocol import Coupling, ForceModel

PLASTIC_FROM = 0.9
"""Of the yield stress: from here to the yield stress itself the force begins to lean, for where the material flows the
two are the same but for noise."""
REST_SPEED = 0.005
"""Metres per second up to which an arm is at rest and has no direction: one encoder step of 0.055 mm (an Omni's, the
coarsest here) in the loop's 15 ms is 0.004."""

LEAST_EXPONENT = 0.1
"""A model's exponent counts as this at least: it is divided by."""


class Felt(NamedTuple):
    """A ``force`` (3,) N on the hand, its ``magnitude`` N before it fades with the normal, and the slopes N/m that the
    material ``asked`` for (the tangent's, or the secant's where that is steeper) and the loop ``granted``: none where
    it interpolates. With a ``fault`` there is no force."""

    force: Triple = (0.0, 0.0, 0.0)
    asked: float = 0.0
    granted: float = 0.0
    magnitude: float = 0.0
    fault: Fault = Fault.NONE


NOTHING = Felt()
NO_NUMBER = Felt(fault=Fault.MODEL_NOT_FINITE)


def felt_force(
    model: ForceModel | None,
    previous: ForceModel | None,
    position: Triple,
    velocity: Triple,
    now: float,
    limits: Limits,
    coupling: Coupling = Coupling.LOCAL,
    taken: float | None = None,
) -> Felt:
    """The force of a model on the tip at ``position`` (m), moving at ``velocity`` (m/s), at the time ``now`` (s).

    Zero without a model or with one of nothing (scene 0), and with its fault where anything is no number. With
    ``LOCAL`` coupling an ageing model never raises the force of an arm that is held. With ``INTERPOLATE``, the paper's,
    ``previous`` is where the force comes from, and position does not count: from when the model was ``taken`` (s; None:
    when it was made) it rises to the newest estimate, and no further.
    """
    if model is None or model.scene == 0:
        return NOTHING
    gx, gy, gz = model.gradient
    mx, my, mz = model.position
    x, y, z = position
    nx, ny, nz = model.normal
    vx, vy, vz = velocity
    asked = hypot(gx, gy, gz)
    rise = gx * (x - mx) + gy * (y - my) + gz * (z - mz)
    stress, yield_stress, age = model.stress, model.yield_stress, now - model.time
    turning = sum((*model.turning_x, *model.turning_y, *model.turning_z))
    numbers = asked + rise + nx + ny + nz + vx + vy + vz + stress + yield_stress + model.damping + model.exponent + age
    if not isfinite(numbers + turning):
        return NO_NUMBER
    granted, softness, tangent = 0.0, 1.0, stress
    if coupling is Coupling.INTERPOLATE:
        stress = tangent = _interpolated(model, previous, now - (model.time if taken is None else taken))
    elif asked > 0.0:
        exponent = min(max(model.exponent, LEAST_EXPONENT), 1.0)
        asked /= exponent
        granted = granted_slope(asked, limits)
        softness = granted / asked
        tangent, stress = stress + rise, stress + rise / exponent
    magnitude = min(tangent, min(stress, yield_stress) * softness)
    if not magnitude > 0.0:
        return Felt(asked=asked, granted=granted)
    if model.damping > 0.0:
        damping = min(model.damping, limits.max_damping)
        magnitude = _damped(magnitude, yield_stress * softness, damping, vx * nx + vy * ny + vz * nz)
    length = hypot(nx, ny, nz)
    if length > 1.0:
        nx, ny, nz, length = nx / length, ny / length, nz / length, 1.0
    normal = nx, ny, nz
    if granted > 0.0 and magnitude > 0.0:
        normal = _turned(model, normal, length, (x - mx, y - my, z - mz), granted_slope(inf, limits) / magnitude)
    speed = hypot(vx, vy, vz)
    if speed > REST_SPEED and tangent > PLASTIC_FROM * yield_stress and magnitude > 0.0:
        flowing = min((tangent / yield_stress - PLASTIC_FROM) / (1.0 - PLASTIC_FROM), 1.0)
        share = min(flowing * limits.max_damping * (speed - REST_SPEED) / magnitude, 1.0)
        normal = _leaning(normal, length, (-vx / speed, -vy / speed, -vz / speed), share)
    nx, ny, nz = normal
    return Felt((magnitude * nx, magnitude * ny, magnitude * nz), asked, granted, magnitude)


def surface_known(model: ForceModel, before: ForceModel | None) -> ForceModel:
    """What is to be followed once a ``model`` has come: the model itself, or where it feels nothing, the surface that
    was known ``before``.

    A tip that has just left a surface comes back to it sooner than to any other. A model of nothing has no tangent, so
    an arm that followed it would come through the surface until the next one, and be thrown out again: what it came in
    for without a force, it is given back with one. The surface is forgotten in another scene, and as soon as a model
    feels nothing where it should be felt.
    """
    if not model.stress <= 0.0 or before is None or before.scene != model.scene:
        return model
    numbers = (
        model.stress,
        model.yield_stress,
        model.damping,
        model.exponent,
        *model.position,
        *model.gradient,
        *model.normal,
        *model.turning_x,
        *model.turning_y,
        *model.turning_z,
    )
    rise = sum(g * (m - b) for g, m, b in zip(before.gradient, model.position, before.position, strict=True))
    if not (isfinite(sum(numbers)) and before.stress + rise <= 0.0):  # what is no number is told by felt_force
        return model
    return before._replace(time=model.time)


def granted_slope(asked: float, limits: Limits) -> float:
    """N/m of a slope that a loop renders stably, and its device at all.

    A followed tangent is late by half a period of the loop, however old its model is: so the damping of device and hand
    bounds it by b > K T/2 (Colgate and Schenkel), which the eigenvalues of the sampled loop confirm to 0.2 %. A bound
    that falls with the model's age would itself shake the hand: the force would sag and come back with every model.
    """
    return min(asked, limits.max_stiffness, 2.0 * limits.damping / limits.period)


def _turned(model: ForceModel, normal: Triple, length: float, way: Triple, most: float) -> Triple:
    """The normal as it is after a ``way`` (m) since the model was made: as long as it was, turned by less than a right
    angle. It turns by ``most`` (1/m) at most, for a force that turns is a slope across as well.

    In a pit the walls hold the tip from the side by no more than this turning. A normal that stood still until the next
    model would hold it there like a held force, which is stable up to damping over half of the collision's period only.
    """
    (dx, dy, dz), (nx, ny, nz) = way, normal
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = model.turning_x, model.turning_y, model.turning_z
    steepest = hypot(ax, ay, az, bx, by, bz, cx, cy, cz)
    if not 0.0 < steepest < inf:
        return normal
    share = min(1.0, most / steepest)
    nx += share * (ax * dx + bx * dy + cx * dz)
    ny += share * (ay * dx + by * dy + cy * dz)
    nz += share * (az * dx + bz * dy + cz * dz)
    turned = hypot(nx, ny, nz)
    if not turned > 0.0:
        return normal
    share = length / turned
    return nx * share, ny * share, nz * share


def _interpolated(model: ForceModel, previous: ForceModel | None, since: float) -> float:
    """The stress ``since`` so many seconds on its way from the last estimate but one to the last, in the time that was
    between them.

    Each is at most its own yield stress, as it was felt. Without one before in the same scene the last holds.
    """
    last = min(model.stress, model.yield_stress)
    if previous is None or previous.scene != model.scene:
        return last
    between = model.time - previous.time
    if not (isfinite(previous.stress + previous.yield_stress + between) and between > 0.0):
        return last
    first = min(previous.stress, previous.yield_stress)
    return first + (last - first) * min(max(since / between, 0.0), 1.0)


def _damped(force: float, yield_stress: float, damping: float, speed: float) -> float:
    """A force with damping against the ``speed`` (m/s) along the normal: at most doubled, so that a touch begins
    without a step, never negative, and never more than the material bears."""
    return min(max(force - damping * speed, 0.0), 2.0 * force, yield_stress)


def _leaning(normal: Triple, length: float, back: Triple, share: float) -> Triple:
    """The normal, turned by a share of 0 to 1 towards ``back``, the direction opposite to the motion.

    As long as it was, so the force keeps its strength, and never over to the other side of the surface: on the way in
    the whole share is ``back`` itself (the paper's "opposed to motion"), along the surface it is a drag no greater than
    the device's highest damping, on the way out it does not pull. What the normal has faded by, a share of ``back``
    fills: in uniform material there is no outside, only drag.
    """
    nx, ny, nz = normal
    ux, uy, uz = back
    fill = (1.0 - length) * share
    if length < 1e-6:
        return fill * ux, fill * uy, fill * uz
    along = (ux * nx + uy * ny + uz * nz) / length
    k = along / length
    tx, ty, tz = ux - k * nx, uy - k * ny, uz - k * nz  # the part of `back` in the surface
    across = share * share * max(1.0 - along * along, 0.0)
    upright, aside = sqrt(max(1.0 - across, 0.0)), share * length
    return (
        upright * nx + aside * tx + fill * ux,
        upright * ny + aside * ty + fill * uy,
        upright * nz + aside * tz + fill * uz,
    )
