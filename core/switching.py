# SPDX-License-Identifier: GPL-3.0-or-later
"""Python's interval of switching threads, short as long as any engine runs."""

from __future__ import annotations

import sys
from threading import Lock

SWITCH_INTERVAL = 5e-4
"""Seconds after which Python's threads take turns while an engine runs: with Python's own 5 ms a main thread that is
busy leaves 100 estimates a second of 10,000 (DESIGN 4)."""

_lock = Lock()
_engines = 0
_former = 0.0


def hurry() -> None:
    """One engine more."""
    global _engines, _former
    with _lock:
        if _engines == 0:
            _former = sys.getswitchinterval()
            sys.setswitchinterval(min(SWITCH_INTERVAL, _former))
        _engines += 1


def relax() -> None:
    """One engine less; after the last one the interval is as it was before the first."""
    global _engines
    with _lock:
        _engines -= 1
        if _engines == 0:
            sys.setswitchinterval(_former)
