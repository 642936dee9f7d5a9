# SPDX-License-Identifier: GPL-3.0-or-later
"""A turn that one thread asks for, and another gives: between two of its steps, or at once while it rests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Condition


class Turn:
    """Without a lock around their work, one thread gets a moment in which the other does nothing."""

    def __init__(self) -> None:
        self._told = Condition()
        self._asked = self._given = False
        self._resting = True

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """What the giver does its steps in; outside of this it rests."""
        self._resting = False
        try:
            yield
        finally:
            with self._told:
                self._resting = True
                self._told.notify_all()

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Ask, wait until the other lets in, and make it wait until this is left."""
        with self._told:
            self._asked, self._given = True, False
            self._told.wait_for(lambda: self._given or self._resting)
        try:
            yield
        finally:
            with self._told:
                self._asked = self._given = False
                self._told.notify_all()

    def give(self, patience: float) -> None:
        """Let in who asks, and wait at most ``patience`` seconds until that is over; go on at once when nobody does."""
        if not self._asked:  # without the lock: who asks just now is let in after the next step
            return
        with self._told:
            self._given = True
            self._told.notify_all()
            self._told.wait_for(lambda: not self._asked, patience)
            self._asked = False  # who takes longer takes a chance: the next step does not wait as well
