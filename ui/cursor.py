# SPDX-License-Identifier: GPL-3.0-or-later
"""The cursor: where the tool touches, and what it meets there."""

from __future__ import annotations

from dataclasses import dataclass

from ..core import Regime
from ..core.tool import Vector


@dataclass(frozen=True)
class CursorState:
    """What the cursor shows: position and unit normal in the world, lengths in world units, share of stress over yield
    stress from 0 to 1, and a text beside it."""

    position: Vector
    normal: Vector
    radius: float
    reach: float
    regime: Regime
    share: float
    text: str


_state: CursorState | None = None


def set_state(state: CursorState | None) -> None:
    """Show this from the next drawing on; None shows nothing."""
    global _state
    _state = state
