# SPDX-License-Identifier: GPL-3.0-or-later
"""What the methods are measured against: finite elements of a sphere pressed into a half space (README.md)."""

from .cache import load
from .case import CASES, Case
from .indentation import Indentation

__all__ = ["CASES", "Case", "Indentation", "load"]
