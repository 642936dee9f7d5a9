# SPDX-License-Identifier: GPL-3.0-or-later
"""A truth: what is known of the press of one case, from all the meshes that it was made on.

Lengths are in radii R of the sphere, forces in E R^2, stresses in E. z = 0 is the surface at first, up is positive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .case import Case
from .measures import CELL, PROFILE_R, TOP, Press


@dataclass(frozen=True)
class Indentation:
    """The press of one case.

    Over ``depth`` (n,): ``force`` (n,) in E R^2 and ``contact_radius`` (n,), both of the finest mesh.

    At ``depths`` (m,): ``rim`` (m,), the greatest height of the surface over the depth, extrapolated over the meshes;
    ``rim_h`` (meshes, m) on each mesh and ``edge_h`` (meshes, m) the height over the depth where the contact ends,
    negative where the surface sinks in; ``rim_radius`` (m,) where the rim is highest, nan where there is none;
    ``profile_z`` (m, k) the surface at radii ``profile_r`` (k,), under the sphere too; ``density`` (m, nz, nr), mean
    over rings of square section ``cell`` of rho / rho0: above 1 where a foam is crushed, and for a dense solid how much
    of the ring it fills. Row i is centred at z = ``top`` - (i + 1/2) ``cell``, column j at r = (j + 1/2) ``cell``.

    ``h`` is the size of the finest mesh's elements; ``kinetic`` the greatest share that kinetic energy had in the work
    done, past a depth of .02.
    """

    case: Case
    h: float
    depth: np.ndarray
    force: np.ndarray
    contact_radius: np.ndarray
    depths: np.ndarray
    rim: np.ndarray
    rim_h: np.ndarray
    edge_h: np.ndarray
    rim_radius: np.ndarray
    profile_r: np.ndarray
    profile_z: np.ndarray
    cell: float
    top: float
    density: np.ndarray
    kinetic: float

    @property
    def mean_pressure(self) -> np.ndarray:
        """Force over the area of contact, (n,), in E."""
        return self.force / (np.pi * self.contact_radius**2)

    @property
    def force_in_yield(self) -> np.ndarray:
        """Force (n,) in Y R^2."""
        return self.force / self.case.solid.yield_stress


def extrapolated(values: np.ndarray) -> np.ndarray:
    """Limit of ``values`` (meshes, m) over meshes whose elements halve: Richardson's, of the order that three show.

    Where the last two differences do not shrink in one direction, by a factor of 2 to 4, the finest stands as it is.
    """
    if len(values) < 3:
        return values[-1].copy()
    former, last = values[-2] - values[-3], values[-1] - values[-2]
    ratio = np.divide(former, last, out=np.zeros_like(last), where=last != 0.0)
    regular = (ratio >= 2.0) & (ratio <= 4.0)
    return values[-1] + np.where(regular, last / np.where(regular, ratio - 1.0, 1.0), 0.0)


def joined(case: Case, presses: list[Press]) -> Indentation:
    """All but the rim is the finest mesh's."""
    finest, rims = presses[-1], np.array([one.rim for one in presses])
    return Indentation(
        case,
        case.sizes[-1],
        finest.depth,
        finest.force,
        finest.contact_radius,
        finest.depths,
        extrapolated(rims),
        rims,
        np.array([one.edge for one in presses]),
        finest.rim_radius,
        PROFILE_R,
        finest.profile_z,
        CELL,
        TOP,
        finest.density,
        finest.kinetic,
    )
