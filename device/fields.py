# SPDX-License-Identifier: GPL-3.0-or-later
"""Readers for what comes from a file that anybody may have written: each gives the value it wants or says why not."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import Any

Reader = Callable[[Any], Any]
"""Takes any value of a parsed file; gives the checked one, or raises FieldError."""

SHOWN = 40
"""How many characters of a wrong value are repeated in a message."""


class FieldError(ValueError):
    """A field of a file is wrong: its dotted name, and the reason in words."""

    def __init__(self, field: str, reason: str) -> None:
        super().__init__(f"{field}: {reason}" if field else reason)
        self.field = field
        self.reason = reason


def shown(value: object) -> str:
    """A value in a message: on one line, of printable characters, cut where it is long."""
    if isinstance(value, int) and value.bit_length() > 64:
        return "a number far too large"  # its digits might be too many for Python to write
    if isinstance(value, list | dict):
        return f"a list of {len(value)}" if isinstance(value, list) else "a table"
    text = ascii(value[: SHOWN + 1] if isinstance(value, str) else value)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


def within(field: str, read: Reader, value: object) -> Any:
    """What a reader makes of a value; its FieldError names the field that the value is in."""
    try:
        return read(value)
    except FieldError as error:
        raise FieldError(f"{field}.{error.field}" if error.field else field, error.reason) from None


def number(low: float, high: float) -> Reader:
    """A finite number from low to high, as float."""

    def read(value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise FieldError("", f"a number is wanted, not {shown(value)}")
        if not low <= value <= high:  # written so that NaN fails too
            raise FieldError("", f"{shown(value)} is not from {low:g} to {high:g}")
        return float(value)

    return read


def integer(low: int, high: int) -> Reader:
    """A whole number from low to high; 1.0 is none."""

    def read(value: object) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise FieldError("", f"a whole number is wanted, not {shown(value)}")
        if not low <= value <= high:
            raise FieldError("", f"{shown(value)} is not from {low} to {high}")
        return value

    return read


def flag(value: object) -> bool:
    """True or false; 0 and 1 are neither."""
    if not isinstance(value, bool):
        raise FieldError("", f"true or false is wanted, not {shown(value)}")
    return value


def text(longest: int) -> Reader:
    """A text that says something, on one line: what space and line breaks it has are single spaces after."""

    def read(value: object) -> str:
        if not isinstance(value, str):
            raise FieldError("", f"a text is wanted, not {shown(value)}")
        if len(value) > longest:
            raise FieldError("", f"{len(value)} characters are more than {longest}")
        line = " ".join(value.split())
        if not line or not line.isprintable():
            raise FieldError("", f"a text of printable characters is wanted, not {shown(value)}")
        return line

    return read


def word(pattern: str, wanted: str) -> Reader:
    """A text that is all as the regular expression; `wanted` says in words what that is."""
    matches = re.compile(pattern).fullmatch

    def read(value: object) -> str:
        if not isinstance(value, str) or not matches(value):
            raise FieldError("", f"{wanted} is wanted, not {shown(value)}")
        return value

    return read


def choice(*values: str | int) -> Reader:
    """One of these."""

    def read(value: object) -> Any:
        for one in values:
            if type(value) is type(one) and value == one:
                return one
        raise FieldError("", f"one of {', '.join(map(str, values))} is wanted, not {shown(value)}")

    return read


def listed(read: Reader, shortest: int, longest: int) -> Reader:
    """A list of values that one reader takes, as a tuple."""
    lengths = str(shortest) if shortest == longest else f"{shortest} to {longest}"

    def read_list(value: object) -> tuple:
        if not isinstance(value, list):
            raise FieldError("", f"a list of {lengths} is wanted, not {shown(value)}")
        if not shortest <= len(value) <= longest:
            raise FieldError("", f"a list of {lengths} is wanted, not of {len(value)}")
        return tuple(within(str(at), read, one) for at, one in enumerate(value))

    return read_list


def table(kind: type, readers: Mapping[str, Reader], check: Callable[[Any], None] | None = None) -> Reader:
    """A table as a dataclass: each field by its reader, none unknown, none missing that has no default.

    `check` then raises FieldError for fields that do not go together.
    """
    required = {field.name for field in dataclasses.fields(kind) if field.default is dataclasses.MISSING}

    def read(value: object) -> Any:
        if not isinstance(value, dict):
            raise FieldError("", f"a table is wanted, not {shown(value)}")
        for name in value:
            if not isinstance(name, str) or name not in readers:
                near = get_close_matches(name[:SHOWN], readers, 1) if isinstance(name, str) else []
                raise FieldError(shown(name), f"there is no such field{f', but {near[0]}' if near else ''}")
        for name in readers:
            if name in required and name not in value:
                raise FieldError(name, "is missing")
        made = kind(**{name: within(name, readers[name], one) for name, one in value.items()})
        if check is not None:
            check(made)
        return made

    return read
