# SPDX-License-Identifier: GPL-3.0-or-later
"""How tests hold an engine's threads at a known place, and wait for what they do; nothing waits for a time."""

import threading
import time

PATIENCE = 30.0
"""Seconds after which a thread that should have come is taken for lost."""


def until(true):
    """Wait until something is so."""
    deadline, pause = time.monotonic() + PATIENCE, threading.Event()
    while not true():
        assert time.monotonic() < deadline, "waited in vain"
        pause.wait(1e-3)


class Gate:
    """Holds whoever calls through it, from the ``number``-th call on, until it is opened."""

    def __init__(self, number=1):
        self.calls, self.number = 0, number
        self.reached, self._open = threading.Event(), threading.Event()

    def before(self, call):
        def held(*args, **kwargs):
            self.calls += 1
            if self.calls >= self.number:
                self.reached.set()
                assert self._open.wait(PATIENCE)
            return call(*args, **kwargs)

        return held

    def after(self, call):
        def held(*args, **kwargs):
            result = call(*args, **kwargs)
            self.before(lambda: None)()
            return result

        return held

    def open(self):
        self._open.set()


def names():
    """Of the engines' threads that run."""
    return sorted(thread.name for thread in threading.enumerate() if thread.name.startswith("repousse"))
