# SPDX-License-Identifier: GPL-3.0-or-later
"""Quality: what a step may cost, and so how near it comes to the exact one."""

from __future__ import annotations

from dataclasses import dataclass

LONGEST_STEP = 0.5
"""Voxels of travel to a solve, at most: thin sheets are not jumped."""
MOST_SWEEPS = 4
"""Sweeps to a solve: the first, and at most three that correct for what left the reach."""


@dataclass(frozen=True)
class Quality:
    """What a step may cost.

    ``longest_step`` is how far the tool moves in a solve, in voxels; ``most_sweeps`` how many a solve may take until
    sigma meets sigma_f; ``leap`` whether the flux leaps through full material far from the tool (dispersion.py).
    """

    name: str
    longest_step: float = LONGEST_STEP
    most_sweeps: int = MOST_SWEEPS
    leap: bool = False


QUALITIES = {
    quality.name: quality
    for quality in (
        Quality("exact"),
        Quality("balanced", most_sweeps=1, leap=True),
        Quality("draft", 2.0 * LONGEST_STEP, most_sweeps=1, leap=True),
    )
}
"""By name, the most exact first. All keep every invariant of a push: mass, bounds, borders, the band."""


def quality_named(name: object) -> Quality:
    """One of :data:`QUALITIES`. Raises ValueError for another name."""
    if not isinstance(name, str) or name not in QUALITIES:
        raise ValueError(f'there is no quality "{name}": choose from {", ".join(QUALITIES)}')
    return QUALITIES[name]
