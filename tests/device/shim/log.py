# SPDX-License-Identifier: GPL-3.0-or-later
"""What the emulated arm sent, got and did, each with its time: what tests hold the loop's words against.

A record is a kind (one byte), a time in ``time.perf_counter`` seconds, a length, and that many bytes.
"""

import struct
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

_HEADER = struct.Struct("<BdH")
_STATE = struct.Struct("<?9d")


class Kind(IntEnum):
    """What a record tells."""

    SENT = 1
    """A report went to a program."""
    DROPPED = 2
    """A report found the program's queue full."""
    RECEIVED = 3
    """A report came, with its number in front as it was written."""
    STATE = 4
    """The arm after a millisecond: a :class:`Moment`."""
    EVENT = 5
    """An order, or a program that opened or closed the device: text."""


class Entry(NamedTuple):
    """One record; `data` is the report, the moment's bytes or the text."""

    kind: Kind
    time: float
    data: bytes


class Moment(NamedTuple):
    """The arm at a time: whether its amplifiers are on, the currents that its motors have (A), the tip (m, m/s)."""

    enabled: bool
    currents: tuple[float, float, float]
    position: tuple[float, float, float]
    velocity: tuple[float, float, float]


class Log:
    """Records in memory, for a list of bytes never has to be moved as it grows."""

    def __init__(self) -> None:
        self._records: list[bytes] = []

    def add(self, kind: Kind, time: float, data: bytes) -> None:
        """Add a record of up to 65535 bytes."""
        self._records.append(_HEADER.pack(kind, time, len(data)) + data)

    def add_state(self, time: float, moment: Moment) -> None:
        """Add a moment."""
        enabled, currents, position, velocity = moment
        self.add(Kind.STATE, time, _STATE.pack(enabled, *currents, *position, *velocity))

    def append_to(self, path: Path) -> None:
        """Move the records to the end of a file."""
        with path.open("ab") as file:
            file.write(b"".join(self._records))
        self._records.clear()


def moment(entry: Entry) -> Moment:
    """The moment of an entry of kind STATE."""
    enabled, *values = _STATE.unpack(entry.data)
    a, b, c, x, y, z, vx, vy, vz = values
    return Moment(enabled, (a, b, c), (x, y, z), (vx, vy, vz))


def read_log(path: Path) -> Iterator[Entry]:
    """The records of a file, in their order."""
    data = path.read_bytes()
    at = 0
    while at < len(data):
        kind, time, length = _HEADER.unpack_from(data, at)
        at += _HEADER.size
        yield Entry(Kind(kind), time, data[at : at + length])
        at += length
