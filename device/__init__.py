# SPDX-License-Identifier: GPL-3.0-or-later
"""The arm: poses out, forces in. Knows neither Blender nor the material, and needs nothing but Python and hidapi.

What is in the subprocess and what in Blender is told in README.md. Nothing here is imported before it is asked for:
the subprocess starts fast, and Blender pays for the arm only when there is one.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .haptic_loop import HapticLoop
    from .profile import DeviceProfile

__all__ = ["DeviceProfile", "HapticLoop"]

_WHERE = {"DeviceProfile": "profile", "HapticLoop": "haptic_loop"}


def __getattr__(name: str) -> Any:
    if name in _WHERE:
        return getattr(import_module(f".{_WHERE[name]}", __package__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
