# SPDX-License-Identifier: GPL-3.0-or-later
"""The arm's end in Blender's process: who may talk to its loop, and the hand that an engine sees. No bpy: 1 kHz."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from threading import Lock
from typing import TYPE_CHECKING

from ..core.stroke import Sample
from ..device.fault import State
from .arm_mapping import ArmMapping

if TYPE_CHECKING:
    from ..core.local_model import LocalModel
    from ..device import HapticLoop
    from ..device.protocol import ArmState

POSED = frozenset({State.HOMED, State.ARMED, State.RUN})
"""States in which it is known where the arm is."""
ENGAGED = frozenset({State.ARMED, State.RUN})
"""States in which its user wants it to push, and a stroke may run."""
STYLUS, SECOND = 1, 2
"""Bits of the buttons: the one that pushes, and the one that is a clutch."""


class Line:
    """The one line to an arm's loop, for the threads of engines and Blender's own: none waits for the arm.

    A loop may be gone at any time; then there is no pose, and who sends sends into the void.
    """

    def __init__(self, loop: HapticLoop) -> None:
        self._loop: HapticLoop | None = loop
        self._last = loop.state()
        self._lock = Lock()  # a record of the shared memory has one reader and one writer; held for microseconds

    def state(self) -> ArmState:
        """The newest state; the last one once the line is cut."""
        with self._lock:
            if self._loop is not None:
                self._last = self._loop.state()
            return self._last

    def send(self, mapping: ArmMapping, model: LocalModel, scene: int) -> None:
        """What is felt from now on."""
        told = mapping.force_model(model, scene)
        with self._lock:
            if self._loop is not None:
                self._loop.send(told)

    def send_nothing(self) -> None:
        """Nothing is there to be felt."""
        with self._lock:
            if self._loop is not None:
                self._loop.send(None)

    def cut(self) -> None:
        """From here on nobody talks to the loop: it may be stopped."""
        with self._lock:
            self._loop = None

    @property
    def is_cut(self) -> bool:
        """Whether the arm was let go."""
        return self._loop is None


def is_posed(state: ArmState) -> bool:
    """Whether it is known where the arm is."""
    return state.state in POSED and isfinite(state.time) and all(isfinite(x) for x in state.position)


class ArmHand:
    """The hand of an engine that only feels: the arm's poses in voxels, and what is there back to its loop."""

    def __init__(self, line: Line, mapping: ArmMapping, scene: int, began: float) -> None:
        self.line, self.mapping, self.scene, self.began = line, mapping, scene, began
        self._state: ArmState | None = None
        self._sample: Sample | None = None

    def sample(self) -> Sample | None:
        """The arm's newest pose; None while it is not known."""
        state = self.line.state()
        if not is_posed(state):
            return None
        if state is not self._state:
            self._state = state
            self._sample = Sample(max(0.0, state.time - self.began), self.mapping.position(state.position))
        return self._sample

    def feel(self, model: LocalModel) -> None:
        """Tell the loop."""
        self.line.send(self.mapping, model, self.scene)


class StrokeHand(ArmHand):
    """The hand of an engine that deforms: it lets go by itself when the stylus is released, or the arm is lost.

    Attributes
    ----------
    by_touch
        An arm without a button: it pushes until it is told to :meth:`let_go`.
    release
        What is called when it lets go: the engine's ``release``. What is felt is felt on.
    over
        Whether it has let go.
    lost
        Whether that was none of its user's doing: the arm has no pose any more.
    """

    def __init__(self, line: Line, mapping: ArmMapping, scene: int, began: float, by_touch: bool) -> None:
        super().__init__(line, mapping, scene, began)
        self.by_touch = by_touch
        self.release: Callable[[], None] = lambda: None
        self.over = self.lost = False

    def sample(self) -> Sample | None:
        """The newest pose, as ArmHand has it; with the button no longer held the engine deforms no more."""
        state = self.line.state()
        if not self.over and not (state.state in ENGAGED and (self.by_touch or state.buttons & STYLUS)):
            self.let_go(lost=state.state not in POSED)
        return super().sample()

    def let_go(self, lost: bool = False) -> None:
        """The stroke ends here, as if the button were released. Any thread's to call."""
        self.lost = self.lost or lost
        self.over = True
        self.release()
