# SPDX-License-Identifier: GPL-3.0-or-later
"""What a material point does: logarithmic elastic strain, and the return to the yield surface, without any SVD.

Symmetric tensors are tuples (xx, yy, zz, yz, xz, xy). The state is the elastic left Cauchy-Green tensor b. The tensors
that are multiplied here are functions of one b, so they commute and their products are symmetric again. Isotropic law:
strain = log(b) / 2, stress = K tr(strain) I + 2 G dev(strain), as true (Cauchy) stress.
Yield (Deshpande and Fleck, JMPS 48, 2000): q^2 + alpha^2 p^2 = (1 + (alpha/3)^2) Y^2, associated flow; alpha = 0 is von
Mises, 3/sqrt(2) a foam whose plastic Poisson ratio is 0.
"""

from __future__ import annotations

from math import sqrt

from numba import njit

VON_MISES, FOAM = 0.0, 3.0 / sqrt(2.0)
"""alpha of a solid that keeps its volume, and of a foam that does not widen when it is crushed."""

inline = njit(inline="always", error_model="numpy")


@inline
def product(a, b):
    """a b of two symmetric tensors that commute."""
    return (
        a[0] * b[0] + a[5] * b[5] + a[4] * b[4],
        a[5] * b[5] + a[1] * b[1] + a[3] * b[3],
        a[4] * b[4] + a[3] * b[3] + a[2] * b[2],
        a[5] * b[4] + a[1] * b[3] + a[3] * b[2],
        a[0] * b[4] + a[5] * b[3] + a[4] * b[2],
        a[0] * b[5] + a[5] * b[1] + a[4] * b[3],
    )


@inline
def combined(x, a, y, b, one):
    """x a + y b + one I."""
    return (
        x * a[0] + y * b[0] + one,
        x * a[1] + y * b[1] + one,
        x * a[2] + y * b[2] + one,
        x * a[3] + y * b[3],
        x * a[4] + y * b[4],
        x * a[5] + y * b[5],
    )


@inline
def inverse(a):
    xx = a[1] * a[2] - a[3] * a[3]
    xy = a[4] * a[3] - a[5] * a[2]
    xz = a[5] * a[3] - a[4] * a[1]
    scale = 1.0 / (a[0] * xx + a[5] * xy + a[4] * xz)
    return (
        scale * xx,
        scale * (a[0] * a[2] - a[4] * a[4]),
        scale * (a[0] * a[1] - a[5] * a[5]),
        scale * (a[5] * a[4] - a[0] * a[3]),
        scale * xz,
        scale * xy,
    )


@inline
def strain_of(b):
    """log(b) / 2 = artanh(s), s = (b - I)(b + I)^-1, as s + s^3/3 + s^5/5: 1e-8 off at a strain of .1."""
    s = product(combined(1.0, b, 0.0, b, -1.0), inverse(combined(1.0, b, 0.0, b, 1.0)))
    s2 = product(s, s)
    return product(s, combined(1.0 / 3.0, s2, 0.2, product(s2, s2), 1.0))


@inline
def cauchy_green_of(strain):
    """exp(2 strain) = (I + t)(I - t)^-1, t = tanh(strain) = e - e^3/3 + 2 e^5/15: the inverse of `strain_of`."""
    e2 = product(strain, strain)
    t = product(strain, combined(-1.0 / 3.0, e2, 2.0 / 15.0, product(e2, e2), 1.0))
    return product(combined(1.0, t, 0.0, t, 1.0), inverse(combined(-1.0, t, 0.0, t, 1.0)))


@inline
def returned(strain, bulk, shear, yield_stress, alpha):
    """Elastic strain after plastic flow, and whether there was any.

    Associated flow shrinks dev by 1/(1 + 6 G x) and volume by 1/(1 + 2 K alpha^2 x); Newton finds x. The function is
    convex and falls, so from x = 0 Newton never overshoots.
    """
    mean = (strain[0] + strain[1] + strain[2]) / 3.0
    dev = combined(1.0, strain, 0.0, strain, -mean)
    norm2 = dev[0] ** 2 + dev[1] ** 2 + dev[2] ** 2 + 2.0 * (dev[3] ** 2 + dev[4] ** 2 + dev[5] ** 2)
    q2 = 6.0 * shear * shear * norm2  # q^2 = 3/2 |2 G dev|^2
    p2 = (3.0 * alpha * bulk * mean) ** 2  # (alpha p)^2
    limit = (1.0 + alpha * alpha / 9.0) * yield_stress * yield_stress
    if q2 + p2 <= limit:
        return strain, False
    of_dev, of_volume, x = 6.0 * shear, 2.0 * bulk * alpha * alpha, 0.0
    for _ in range(40):
        a, b = 1.0 / (1.0 + of_dev * x), 1.0 / (1.0 + of_volume * x)
        over = q2 * a * a + p2 * b * b - limit
        if over <= 1e-9 * limit:
            break
        x += over / (2.0 * (q2 * a * a * a * of_dev + p2 * b * b * b * of_volume))
    return combined(1.0 / (1.0 + of_dev * x), dev, 0.0, dev, mean / (1.0 + of_volume * x)), True


@inline
def stress_of(strain, bulk, shear):
    trace = strain[0] + strain[1] + strain[2]
    return combined(2.0 * shear, strain, 0.0, strain, (bulk - 2.0 / 3.0 * shear) * trace)
