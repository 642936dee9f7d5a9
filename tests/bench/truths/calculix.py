# SPDX-License-Identifier: GPL-3.0-or-later
"""The same press by CalculiX (`ccx`), an implicit finite-element program of others, where it is installed."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from .mesh import cylinder
from .solid import Solid

FACETS, ARC = 64, 0.6
"""The sphere is a strip of so many elements along so many radians from its lowest point."""
INCREMENTS = 40
MINUTES = 10


def installed() -> bool:
    return shutil.which("ccx") is not None


def force(solid: Solid, size: float, depth: float, penalty: float) -> float:
    """Force in E R^2 on the sphere at ``depth``; what touches overlaps by its pressure over ``penalty``, in E / R.

    Raises
    ------
    RuntimeError
        When CalculiX does not converge, or has nothing to say.
    """
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "press.inp").write_text(deck(solid, size, depth, penalty))
        done = subprocess.run(
            ["ccx", "-i", "press"], cwd=folder, capture_output=True, text=True, timeout=60 * MINUTES, check=False
        )
        results = Path(folder) / "press.dat"
        totals = _totals(results.read_text()) if results.exists() else []
    if len(totals) != 1:
        raise RuntimeError(f"CalculiX gave {len(totals)} forces in place of one: {done.stdout[-300:].strip()}")
    return -totals[0] * 180.0  # it takes an axisymmetric body for a wedge of 2 degrees


def _totals(text: str) -> list[float]:
    """The axial forces of a .dat file's totals of reactions."""
    number = r"\s*([-+.\dE]+)"
    return [float(found[2]) for found in re.finditer(r"total force[^\n]*\n\s*" + number * 3, text)]


def deck(solid: Solid, size: float, depth: float, penalty: float) -> str:
    """The input: our own mesh of the half space, a strip of sphere that is moved as a whole, and contact by penalty."""
    r, z = cylinder(size)
    across, down = r.shape
    number = 1 + np.arange(across * down).reshape(across, down)
    corners = (number[:-1, 1:], number[1:, 1:], number[1:, :-1], number[:-1, :-1])
    elements = np.stack([corner.ravel() for corner in corners], axis=1)
    angles = np.linspace(0.0, ARC, FACETS + 1)
    first_node, first_element = across * down + 1, len(elements) + 1
    rims = [(radius * np.sin(angles), 1.0 - radius * np.cos(angles)) for radius in (1.0, 0.9)]
    nodes = np.vstack([np.stack([r.ravel(), z.ravel()], axis=1), *(np.stack(rim, axis=1) for rim in rims)])
    outer = first_node + np.arange(FACETS)
    inner = outer + FACETS + 1
    strip = np.stack([outer, outer + 1, inner + 1, inner], axis=1)
    top = 1 + (down - 1) * np.arange(across - 1)
    harder = solid.yield_stress + solid.hardening
    return "\n".join(
        [
            "*NODE, NSET=ALL",
            *(f"{1 + n}, {x:.9g}, {y:.9g}, 0" for n, (x, y) in enumerate(nodes)),
            *_element_set("BLOCK", 1, elements),
            *_element_set("BALL", first_element, strip),
            *_node_set("AXIS", number[0]),
            *_node_set("SIDE", number[-1]),
            *_node_set("FLOOR", number[:, -1]),
            *_node_set("MOVED", first_node + np.arange(2 * FACETS + 2)),
            "*MATERIAL, NAME=SOLID",
            "*ELASTIC",
            f"1, {solid.poisson_ratio}",
            *(["*PLASTIC", f"{solid.yield_stress}, 0", f"{harder}, 1"] if solid.yield_stress < 1.0 else []),
            "*MATERIAL, NAME=STIFF",
            "*ELASTIC",
            "100, 0.3",
            "*SOLID SECTION, ELSET=BLOCK, MATERIAL=SOLID",
            "*SOLID SECTION, ELSET=BALL, MATERIAL=STIFF",
            "*SURFACE, NAME=TOP, TYPE=ELEMENT",
            *(f"{e}, S3" for e in top if r.ravel()[elements[e - 1, 2] - 1] < 1.0),
            "*SURFACE, NAME=SPHERE, TYPE=ELEMENT",
            *(f"{e}, S1" for e in first_element + np.arange(FACETS)),
            "*SURFACE INTERACTION, NAME=TOUCH",
            "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
            f"{penalty}, 1e-6",
            "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=NODE TO SURFACE",
            "TOP, SPHERE",
            f"*STEP, NLGEOM, INC={20 * INCREMENTS}",
            "*STATIC",
            f"{1 / INCREMENTS}, 1, {1e-4 / INCREMENTS}, {1 / INCREMENTS}",
            "*BOUNDARY",
            "AXIS, 1, 1",
            "SIDE, 1, 1",
            "FLOOR, 2, 2",
            "MOVED, 1, 1",
            f"MOVED, 2, 2, {-depth}",
            f"*NODE PRINT, NSET=MOVED, TOTALS=ONLY, FREQUENCY={20 * INCREMENTS}",
            "RF",
            "*END STEP",
            "",
        ]
    )


def _element_set(name: str, first: int, elements: np.ndarray) -> list[str]:
    rows = [f"{first + n}, {', '.join(map(str, corners))}" for n, corners in enumerate(elements)]
    return [f"*ELEMENT, TYPE=CAX4, ELSET={name}", *rows]


def _node_set(name: str, nodes: np.ndarray) -> list[str]:
    return [f"*NSET, NSET={name}", *(str(node) for node in nodes)]
