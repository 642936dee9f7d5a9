# SPDX-License-Identifier: GPL-3.0-or-later
"""The truths by name: which solid, on which meshes."""

from __future__ import annotations

from dataclasses import dataclass

from .solid import FOAM, Solid

COARSE, MIDDLE, FINE = 0.04, 0.02, 0.01
DEPTHS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
"""In radii: where the surface and the density are kept."""
FINELY = ("mises-500", "mises-500-h100", "mises-200", "mises-100", "foam-500")
"""Pressed on three meshes, not two."""
UNSEEN = ("mises-300", "mises-150-h33")
"""What the rule from material to rim was not fitted to."""


@dataclass(frozen=True)
class Case:
    """A solid, and the meshes that it is pressed on: ``sizes`` of their smallest elements in radii, finest last."""

    name: str
    solid: Solid
    sizes: tuple[float, ...]

    @property
    def crushable(self) -> bool:
        """Whether it gets denser for good: then density is compared, else occupancy."""
        return self.solid.alpha > 0.0


def _cases() -> list[Case]:
    solids = {}
    for ratio in (500, 200, 100, 50):
        for suffix, hardening in (("", 0.0), ("-h100", 0.01), ("-h10", 0.1)):
            solids[f"mises-{ratio}{suffix}"] = Solid(1.0 / ratio, hardening)
    for ratio in (500, 50):
        for suffix, hardening in (("", 0.0), ("-h100", 0.01)):
            solids[f"foam-{ratio}{suffix}"] = Solid(1.0 / ratio, hardening, FOAM, filled=0.5)
    for name in UNSEEN:
        ratio, _, hardening = name.removeprefix("mises-").partition("-h")
        solids[name] = Solid(1.0 / int(ratio), 1.0 / int(hardening) if hardening else 0.0)
    return [
        Case(name, solid, (COARSE, MIDDLE, FINE) if name in FINELY else (COARSE, MIDDLE))
        for name, solid in solids.items()
    ]


CASES = {case.name: case for case in _cases()}
""""mises-500-h100": von Mises, E/Y = 500, H = E/100; "foam-50": foam half full, E/Y = 50, perfectly plastic."""
