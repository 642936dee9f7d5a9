# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scenario is: a generator that acts on a window and yields how long Blender is to be left to itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

Steps = Iterator[float]
"""What a scenario yields; helpers that wait are such generators too, used with ``yield from``."""


@dataclass(frozen=True)
class Scenario:
    """A scenario and how it is to be played.

    ``limit``: seconds after which it hangs. ``alone``: in a Blender of its own, which may end in it with the exit code
    ``leaves``. ``vulkan``: once more on Vulkan. ``kind``: "test", or "figures" for what only make bench plays.
    """

    name: str
    run: Callable[..., Steps]
    limit: float
    alone: bool
    leaves: int
    vulkan: bool
    kind: str

    def told(self) -> dict:
        """What the outside is told of it."""
        return {name: value for name, value in asdict(self).items() if name != "run"}


REGISTERED: list[Scenario] = []
"""All scenarios that have been loaded, in the order in which they stand."""


def scenario(
    limit: float = 60.0, alone: bool = False, leaves: int = 0, vulkan: bool = False, kind: str = "test"
) -> Callable[[Callable[..., Steps]], Callable[..., Steps]]:
    """Make a function ``(window) -> Steps`` a scenario of its name; see :class:`Scenario`."""

    def register(run):
        REGISTERED.append(Scenario(run.__name__, run, limit, alone, leaves, vulkan, kind))
        return run

    return register
