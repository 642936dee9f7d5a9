# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of what was measured, a named tuple a line, as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_type_hints

Line = TypeVar("Line", bound=NamedTuple)


def write(kind: type[Line], lines: Iterable[Line], path: Path) -> None:
    """The table, whole or not at all."""
    unfinished = path.with_suffix(".part")
    with unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(kind._fields)
        writer.writerows([value if isinstance(value, str) else f"{value:.6g}" for value in line] for line in lines)
    unfinished.replace(path)


def read(kind: type[Line], path: Path) -> list[Line]:
    """The table as :func:`write` left it: fields are numbers, but those that ``kind`` has as text."""
    texts = {name for name, of in get_type_hints(kind).items() if of is str}
    with path.open(newline="", encoding="utf-8") as file:
        return [kind(**_values(line, texts)) for line in csv.DictReader(file)]


def _values(line: dict[str, str], texts: set[str]) -> dict[str, Any]:
    return {name: text if name in texts else float(text) for name, text in line.items()}
