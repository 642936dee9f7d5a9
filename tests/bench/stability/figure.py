# SPDX-License-Identifier: GPL-3.0-or-later
"""A figure that was measured, and the mark that it has to meet."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """One line of the table: ``what`` of which ``case`` was ``measured``, and is to be ``at_most`` or ``at_least``."""

    case: str
    what: str
    measured: float
    unit: str = ""
    at_most: float | None = None
    at_least: float | None = None

    @property
    def passes(self) -> bool:
        """Whether it is within its marks; what is no number is not."""
        return (self.at_most is None or self.measured <= self.at_most) and (
            self.at_least is None or self.measured >= self.at_least
        )

    @property
    def mark(self) -> str:
        """The mark in words."""
        low, high = self.at_least, self.at_most
        if low is not None and low == high:
            return f"{low:.3g}"
        bounds = (("at least", low), ("at most", high))
        return ", ".join(f"{bound} {value:.3g}" for bound, value in bounds if value is not None)

    def __str__(self) -> str:
        verdict = "" if self.passes else ": missed"
        return f"{self.case}: {self.what}: {self.measured:.3g} {self.unit} (mark: {self.mark}){verdict}"


def exactly(case: str, what: str, measured: float, value: float, unit: str = "") -> Figure:
    """A figure that has to have one value."""
    return Figure(case, what, measured, unit, value, value)
