# SPDX-License-Identifier: GPL-3.0-or-later
"""A period that is kept: absolute deadlines, and the right to go first where the system gives it."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PRIORITY = 60
"""Of SCHED_FIFO: before all that is ordinary. The loop sleeps most of its period, so nothing starves."""
_HIGH_PRIORITY_CLASS = 0x80


class Pace:
    """Deadlines a period apart.

    ``time.sleep`` waits for an absolute time by clock_nanosleep on POSIX and by a high-resolution timer on Windows
    (both since Python 3.11), so what a period is late by does not add up.
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self._due = time.perf_counter() + period

    def wait(self) -> float:
        """Sleep until the next deadline and return the time. Deadlines that were missed are not made up for."""
        now = time.perf_counter()
        if now < self._due:
            time.sleep(self._due - now)
            now = time.perf_counter()
        self._due += self.period
        if self._due < now:
            self._due = now + self.period
        return now


@contextmanager
def first_in_line() -> Iterator[bool]:
    """In this context the process goes before others, and Python collects no garbage; tells whether the system agreed.

    An ordinary user of Linux needs a real-time limit for that (``ulimit -r``); without it the loop runs all the same.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield _go_first()
    finally:
        gc.enable()


def _go_first() -> bool:
    if sys.platform == "win32":
        system = ctypes.WinDLL("kernel32")
        system.GetCurrentProcess.restype = ctypes.c_void_p
        return bool(system.SetPriorityClass(ctypes.c_void_p(system.GetCurrentProcess()), _HIGH_PRIORITY_CLASS))
    if not hasattr(os, "sched_setscheduler"):
        return False
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        return True
    return False
