# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of a page that a program writes: between two comments, which stay."""

from __future__ import annotations

from pathlib import Path

from .rows import write_text

BEGIN, END = "<!-- chart: from here on written by `make chart PAGE=1` -->", "<!-- chart: up to here -->"


def rewrite(path: Path, text: str) -> None:
    """Put ``text`` between the two comments of a page.

    Raises
    ------
    ValueError
        When the page has not one of each, in order.
    """
    page = path.read_text(encoding="utf-8")
    if page.count(BEGIN) != 1 or page.count(END) != 1 or page.index(BEGIN) > page.index(END):
        raise ValueError(f'{path}: there must be one line "{BEGIN}", and one "{END}" after it')
    before, after = page.split(BEGIN)[0], page.split(END)[1]
    write_text(path, f"{before}{BEGIN}\n\n{text.strip()}\n\n{END}{after}")
