# SPDX-License-Identifier: GPL-3.0-or-later
"""Hand: whoever holds the tool and feels it, as the engine sees it. An arm is one; a script in a test is another."""

from __future__ import annotations

from typing import Protocol

from .local_model import LocalModel
from .stroke import Sample


class Hand(Protocol):
    """Poses out, local models in.

    Both methods are called by the engine's collision thread, in turn, a thousand times a second, and never again once
    the engine is finished or cancelled. No lock is held meanwhile. They wait for nothing and touch no bpy: who ends the
    engine waits for them. What they raise ends the stroke as a failure; an arm that is unplugged is none, it has no
    pose.
    """

    def sample(self) -> Sample | None:
        """The newest pose in voxels, in the frame of the push, also when it was given before; None: there is none.

        ``time`` is the hand's own clock, in seconds since the stroke began: it knows when the pose was measured.

        Without a pose nothing is felt: the last local model ages, and a loop that watches its age lets the force fade.
        A pose that is not finite, or with a radius under one voxel, counts as none.
        """
        ...

    def feel(self, model: LocalModel) -> None:
        """The material at the pose that was given last."""
        ...
