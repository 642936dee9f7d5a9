# SPDX-License-Identifier: GPL-3.0-or-later
"""A rigid, frictionless sphere of radius 1 pressed into a half space: axisymmetric finite elements of our own.

Updated Lagrangian, explicit: quadrilaterals with one point of integration, hourglass modes held by a weak spring
(Flanagan and Belytschko, IJNME 17, 1981, 679-706), stress turned with the material (Jaumann rate). What is sought is
the state of rest at each depth, so mass and damping are devices: each element is as heavy as makes its own critical
step one step, and damping is Cundall's, a share of the force that is out of balance, against the velocity: unlike drag
it does not hold back what flows steadily. Time is counted in steps.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .yielding import hardened, returned

STEPS_TIMES_SIZE = 500.0
"""Steps of a whole press times the size of an element: a wave crosses one in two steps, so a radius 250 times."""
EASED_IN = 0.1
"""Share of the steps in which the sphere gathers speed."""
COURANT = 0.7
"""Of the greatest stable step."""
DAMPING = 0.7
"""Share of a force out of balance that goes against the velocity (Cundall 1987; .8 is usual)."""
HOURGLASS = 0.05
"""Stiffness of the springs over that of the element."""
HEAVIER_EVERY = 100
"""Steps after which masses are told anew: elements get thinner."""


@njit(cache=True)
def depth_at(share, deepest):
    """Depth after a ``share`` of all steps: speed grows evenly, then stays."""
    speed = deepest / (1.0 - 0.5 * EASED_IN)
    return 0.5 * speed * share * share / EASED_IN if share < EASED_IN else speed * (share - 0.5 * EASED_IN)


def depth_at_each(shares: np.ndarray, deepest: float) -> np.ndarray:
    """The same for ``shares`` (n,)."""
    return np.array([depth_at(share, deepest) for share in shares])


@njit(cache=True, inline="always")
def gradients(r, z, i, j):
    """Element (i, j): its area, mean radius, and derivatives of its shape functions at its middle along r and z.

    Nodes run anticlockwise from the lower inner one; opposite ones have opposite derivatives, so two are enough.
    """
    r0, r1, r2, r3 = r[i, j + 1], r[i + 1, j + 1], r[i + 1, j], r[i, j]
    z0, z1, z2, z3 = z[i, j + 1], z[i + 1, j + 1], z[i + 1, j], z[i, j]
    area = 0.5 * ((r2 - r0) * (z3 - z1) - (r3 - r1) * (z2 - z0))
    half = 0.5 / area
    mean = 0.25 * (r0 + r1 + r2 + r3)
    return area, mean, (z1 - z3) * half, (z2 - z0) * half, (r3 - r1) * half, (r0 - r2) * half


@njit(cache=True)
def weigh(r, z, modulus, mass):
    """Masses of the nodes: each element as dense as makes its critical step one step.

    Its highest frequency is at most 2 sqrt(M S / density), S = sum of squares of all its derivatives (Flanagan and
    Belytschko, equation 41), the hoop's 1 / (4 r) each among them; a step is stable up to 2 / frequency.
    """
    mass[:] = 0.0
    for i in range(r.shape[0] - 1):
        for j in range(r.shape[1] - 1):
            area, mean, br0, br1, bz0, bz1 = gradients(r, z, i, j)
            squares = 2.0 * (br0 * br0 + br1 * br1 + bz0 * bz0 + bz1 * bz1) + 0.25 / (mean * mean)
            part = modulus * squares / COURANT**2 * 2.0 * np.pi * mean * area / 4.0
            mass[i, j] += part
            mass[i + 1, j] += part
            mass[i, j + 1] += part
            mass[i + 1, j + 1] += part


@njit(cache=True)
def strain_and_forces(r, z, vr, vz, stress, strain, hourglass, constants, fr, fz):
    """One step of every element: its stress (rr, zz, tt, rz) and plastic strain go on, its forces are added up."""
    bulk, shear, yield_stress, hardening, locking_strain, alpha = constants
    fr[:] = 0.0
    fz[:] = 0.0
    for i in range(r.shape[0] - 1):
        for j in range(r.shape[1] - 1):
            area, mean, br0, br1, bz0, bz1 = gradients(r, z, i, j)
            u0, u1, u2, u3 = vr[i, j + 1], vr[i + 1, j + 1], vr[i + 1, j], vr[i, j]
            w0, w1, w2, w3 = vz[i, j + 1], vz[i + 1, j + 1], vz[i + 1, j], vz[i, j]
            # Strains of this step, and its turn.
            rr = br0 * (u0 - u2) + br1 * (u1 - u3)
            zz = bz0 * (w0 - w2) + bz1 * (w1 - w3)
            tt = 0.25 * (u0 + u1 + u2 + u3) / mean
            r_by_z = bz0 * (u0 - u2) + bz1 * (u1 - u3)
            z_by_r = br0 * (w0 - w2) + br1 * (w1 - w3)
            rz, turn = 0.5 * (r_by_z + z_by_r), 0.5 * (r_by_z - z_by_r)
            # The stress turns with the material (Jaumann), then takes the elastic strain, then returns to yield.
            s_rr = stress[i, j, 0] + 2.0 * turn * stress[i, j, 3]
            s_zz = stress[i, j, 1] - 2.0 * turn * stress[i, j, 3]
            s_tt = stress[i, j, 2]
            s_rz = stress[i, j, 3] + turn * (stress[i, j, 1] - stress[i, j, 0])
            volume_strain = rr + zz + tt
            former = (s_rr + s_zz + s_tt) / 3.0
            p = former + bulk * volume_strain
            d_rr = s_rr - former + 2.0 * shear * (rr - volume_strain / 3.0)
            d_zz = s_zz - former + 2.0 * shear * (zz - volume_strain / 3.0)
            d_tt = s_tt - former + 2.0 * shear * (tt - volume_strain / 3.0)
            d_rz = s_rz + 2.0 * shear * rz
            q = np.sqrt(1.5 * (d_rr * d_rr + d_zz * d_zz + d_tt * d_tt + 2.0 * d_rz * d_rz))
            strength, rise = hardened(strain[i, j], yield_stress, hardening, locking_strain)
            of_deviator, of_mean, plastic = returned(p, q, strength, bulk, shear, rise, alpha)
            strain[i, j] += plastic
            p *= of_mean
            s_rr, s_zz, s_tt = p + of_deviator * d_rr, p + of_deviator * d_zz, p + of_deviator * d_tt
            s_rz = of_deviator * d_rz
            stress[i, j, 0], stress[i, j, 1], stress[i, j, 2], stress[i, j, 3] = s_rr, s_zz, s_tt, s_rz
            # Hourglass: the pattern (1, -1, 1, -1) less what a linear field has of it. The springs yield as it does.
            r_pattern = r[i, j + 1] - r[i + 1, j + 1] + r[i + 1, j] - r[i, j]
            z_pattern = z[i, j + 1] - z[i + 1, j + 1] + z[i + 1, j] - z[i, j]
            g0 = 1.0 - r_pattern * br0 - z_pattern * bz0
            g1 = -1.0 - r_pattern * br1 - z_pattern * bz1
            g2 = 1.0 + r_pattern * br0 + z_pattern * bz0
            g3 = -1.0 + r_pattern * br1 + z_pattern * bz1
            volume = 2.0 * np.pi * mean * area
            spring = HOURGLASS * shear * 2.0 * (br0 * br0 + br1 * br1 + bz0 * bz0 + bz1 * bz1) * volume
            h_r = of_deviator * (hourglass[i, j, 0] + spring * (g0 * u0 + g1 * u1 + g2 * u2 + g3 * u3))
            h_z = of_deviator * (hourglass[i, j, 1] + spring * (g0 * w0 + g1 * w1 + g2 * w2 + g3 * w3))
            hourglass[i, j, 0], hourglass[i, j, 1] = h_r, h_z
            # Forces on the nodes, against the stress: - volume B^T stress.
            hoop = 0.25 * s_tt / mean * volume
            r0, r1 = volume * (br0 * s_rr + bz0 * s_rz), volume * (br1 * s_rr + bz1 * s_rz)
            z0, z1 = volume * (bz0 * s_zz + br0 * s_rz), volume * (bz1 * s_zz + br1 * s_rz)
            fr[i, j + 1] -= r0 + hoop + g0 * h_r
            fr[i + 1, j + 1] -= r1 + hoop + g1 * h_r
            fr[i + 1, j] -= -r0 + hoop + g2 * h_r
            fr[i, j] -= -r1 + hoop + g3 * h_r
            fz[i, j + 1] -= z0 + g0 * h_z
            fz[i + 1, j + 1] -= z1 + g1 * h_z
            fz[i + 1, j] -= -z0 + g2 * h_z
            fz[i, j] -= -z1 + g3 * h_z


@njit(cache=True, inline="always")
def damped(force, velocity):
    """A force out of balance, less Cundall's share of it against the velocity."""
    return force - DAMPING * abs(force) * np.sign(velocity)


@njit(cache=True)
def move(r, z, vr, vz, fr, fz, mass):
    """All nodes but those of the surface: velocity and place go one step on. The axis and the far walls hold."""
    last_i, last_j = r.shape[0] - 1, r.shape[1] - 1
    for i in range(last_i + 1):
        for j in range(1, last_j + 1):
            vr[i, j] += damped(fr[i, j], vr[i, j]) / mass[i, j] if 0 < i < last_i else 0.0
            vz[i, j] += damped(fz[i, j], vz[i, j]) / mass[i, j] if j < last_j else 0.0
            r[i, j] += vr[i, j]
            z[i, j] += vz[i, j]


@njit(cache=True)
def move_surface(r, z, vr, vz, fr, fz, mass, depth, touching):
    """The surface: as the others, and what would enter the sphere is put on it, along its normal. Returns the force.

    On the sphere only the part of a force along it is out of balance, so only that is damped.
    """
    centre, pressed = 1.0 - depth, 0.0
    for i in range(r.shape[0]):
        fixed = i == 0 or i == r.shape[0] - 1
        if touching[i]:
            away = np.hypot(r[i, 0], z[i, 0] - centre)
            nr, nz = r[i, 0] / away, (z[i, 0] - centre) / away
            normal, along = fr[i, 0] * nr + fz[i, 0] * nz, fz[i, 0] * nr - fr[i, 0] * nz
            along = damped(along, vz[i, 0] * nr - vr[i, 0] * nz)
            force_r, force_z = normal * nr - along * nz, normal * nz + along * nr
        else:
            force_r, force_z = damped(fr[i, 0], vr[i, 0]), damped(fz[i, 0], vz[i, 0])
        vr[i, 0] += 0.0 if fixed else force_r / mass[i, 0]
        vz[i, 0] += force_z / mass[i, 0]
        to_r, to_z = r[i, 0] + vr[i, 0], z[i, 0] + vz[i, 0]
        away = np.hypot(to_r, to_z - centre)
        touching[i] = away < 1.0 and to_z < centre
        if touching[i]:
            back_r, back_z = to_r * (1.0 / away - 1.0), (to_z - centre) * (1.0 / away - 1.0)
            vr[i, 0] += back_r
            vz[i, 0] += back_z
            to_r, to_z = to_r + back_r, to_z + back_z
            pressed -= mass[i, 0] * back_z
        r[i, 0], z[i, 0] = to_r, to_z
    return pressed


@njit(cache=True)
def kinetic_energy(vr, vz, mass):
    return 0.5 * np.sum(mass * (vr * vr + vz * vz))


@njit(cache=True)
def press(r, z, state, constants, deepest, first, last, steps):
    """Steps ``first`` to ``last`` of ``steps`` in all. Returns the mean force, and the kinetic energy at the end.

    ``r`` and ``z`` (across, down) and ``state`` are changed in place.
    """
    vr, vz, fr, fz, mass, stress, strain, hourglass, touching = state
    modulus = constants[0] + 4.0 / 3.0 * constants[1]  # of a longitudinal wave
    force = 0.0
    for step in range(first, last):
        if step % HEAVIER_EVERY == 0:
            weigh(r, z, modulus, mass)
        strain_and_forces(r, z, vr, vz, stress, strain, hourglass, constants, fr, fz)
        move(r, z, vr, vz, fr, fz, mass)
        force += move_surface(r, z, vr, vz, fr, fz, mass, depth_at((step + 1) / steps, deepest), touching)
    return force / max(last - first, 1), kinetic_energy(vr, vz, mass)


def at_rest(r: np.ndarray) -> tuple[np.ndarray, ...]:
    """The state of nodes (across, down) and of the elements between them before anything has moved."""
    nodes, elements = r.shape, (r.shape[0] - 1, r.shape[1] - 1)
    return (
        *(np.zeros(nodes) for _ in range(5)),
        np.zeros((*elements, 4)),
        np.zeros(elements),
        np.zeros((*elements, 2)),
        np.zeros(nodes[0], np.bool_),
    )
