# SPDX-License-Identifier: GPL-3.0-or-later
"""The reports of Haptikfabriken's HID protocol, for both ends: encoders and a button in, milliamperes out.

All fields are 16-bit little-endian, counters wrap. Sources: firmware/main.cpp and src/fsusbhapticdevicethread.cpp in
the repository forsslund/haptikfabrikenapi; mbed-code/WoodenHapticsHID/main.cpp in WoodenHaptics/woody-experimental.

============  =====================================================  ===================================================
layout        from the device                                        to the device, after a report number of 0
============  =====================================================  ===================================================
protocol-1    encoders a b c, counter of reports                     mA of motors a b c, 0
protocol-2    encoders a b c d e f, 1 after the calibration button   mA of motors a b c, command, three attributes
============  =====================================================  ===================================================

Command 0 sets currents; 1 sets encoders a b c to the attributes, and d e f to what stands in the currents' place.
A stylus' button adds 10000 to encoder d. What a link has beyond the layout is zeros.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

from .profile import Link

_PROTOCOL_1 = struct.Struct("<3hH")
_PROTOCOL_2 = struct.Struct("<7h")
_CURRENTS, _CALIBRATE = 0, 1
_BUTTON, _BUTTON_ADDS = 5000, 10000

Counts = tuple[int, int, int]
Triple = tuple[float, float, float]


class Report(NamedTuple):
    """What the device says: encoder counts as 16-bit numbers in the profile's sense of turning, the stylus' button, the
    calibration button, and the report's number modulo 2^16 where the link gives it.
    """

    counts: Counts
    button: bool
    calibrate: bool
    counter: int | None


class Output(NamedTuple):
    """What the device is told: currents in amperes, the command, and the counts to set where the command is 1."""

    currents: Triple
    command: int
    home: Counts


def decode(link: Link, data: bytes | Sequence[int]) -> Report:
    """A report as hidapi reads it; ValueError where its length is not the link's, or the link has no known reports."""
    if len(data) != link.report_length:
        raise ValueError(f"a report of {len(data)} bytes came, {link.name} sends {link.report_length}")
    if link.layout == "protocol-2":
        a, b, c, d, _, f, info = _PROTOCOL_2.unpack_from(bytes(data[: _PROTOCOL_2.size]))
        counts, button, calibrate = (a, b, c), d > _BUTTON, info == 1
        counter = f & 0xFFFF if link.counted else None
    elif link.layout == "protocol-1":
        a, b, c, counter = _PROTOCOL_1.unpack(bytes(data))
        counts, button, calibrate = (a, b, c), False, False
    else:
        raise _unknown(link)
    return Report(counts if link.encoder_sign > 0 else _negated(counts), button, calibrate, counter)


def encode_currents(link: Link, amperes: Triple) -> bytes:
    """What hidapi writes to set motor currents, rounded to milliamperes.

    ValueError where one is not finite or over the link's ``firmware_current_limit``: some firmware then drops to zero,
    other takes anything. The loop's limits are lower; this is the last door.
    """
    a, b, c = amperes
    most = link.firmware_current_limit
    if not (abs(a) <= most and abs(b) <= most and abs(c) <= most):  # written so that NaN fails too
        raise ValueError(f"a current of {a:g}, {b:g} or {c:g} A is over the {most:g} A of {link.name}")
    a, b, c = round(a * 1000.0), round(b * 1000.0), round(c * 1000.0)
    if link.layout == "protocol-2":
        return _padded(link, _PROTOCOL_2.pack(a, b, c, _CURRENTS, 0, 0, 0))
    if link.layout == "protocol-1":
        return _padded(link, _PROTOCOL_1.pack(a, b, c, 0))
    raise _unknown(link)


def encode_home(link: Link, counts: Counts) -> bytes | None:
    """What hidapi writes to set the device's counters (motors get no current), or None where the protocol has no such
    command and the host must remember the difference.
    """
    if link.layout == "protocol-1":
        return None
    if link.layout != "protocol-2":
        raise _unknown(link)
    a, b, c = counts if link.encoder_sign > 0 else _negated(counts)
    return _padded(link, _PROTOCOL_2.pack(0, 0, 0, _CALIBRATE, wrapped(a), wrapped(b), wrapped(c)))


def encode_input(link: Link, counts: Counts, button: bool, calibrate: bool, counter: int) -> bytes:
    """The device's side of decode: the report, without a report number; counts wrap as its counters do."""
    a, b, c = (wrapped(link.encoder_sign * count) for count in counts)
    if link.layout == "protocol-2":
        number = wrapped(counter) if link.counted else 0
        fields = _PROTOCOL_2.pack(a, b, c, _BUTTON_ADDS if button else 0, 0, number, int(calibrate))
        return fields.ljust(link.report_length, b"\0")
    if link.layout == "protocol-1":
        return _PROTOCOL_1.pack(a, b, c, counter & 0xFFFF)
    raise _unknown(link)


def decode_output(link: Link, data: bytes) -> Output:
    """The device's side of encode_currents and encode_home: a report without its number; ValueError as for decode."""
    if len(data) != link.report_length:
        raise ValueError(f"a report of {len(data)} bytes was sent, {link.name} takes {link.report_length}")
    if link.layout == "protocol-2":
        a, b, c, command, *attributes = _PROTOCOL_2.unpack_from(data)
        home: Counts = (attributes[0], attributes[1], attributes[2])
        if link.encoder_sign < 0:
            home = _negated(home)
    elif link.layout == "protocol-1":
        a, b, c, _ = _PROTOCOL_1.unpack(data)
        command, home = _CURRENTS, (0, 0, 0)
    else:
        raise _unknown(link)
    amperes = (0.0, 0.0, 0.0) if command == _CALIBRATE else (a / 1000.0, b / 1000.0, c / 1000.0)
    return Output(amperes, command, home)


def wrapped(count: int) -> int:
    """A count as a 16-bit counter shows it."""
    return (count + 0x8000 & 0xFFFF) - 0x8000


def unwrap(total: int, raw: int) -> int:
    """The count that a 16-bit counter at `raw` stands for, nearest to the last total."""
    return total + wrapped(raw - total)


def _negated(counts: Counts) -> Counts:
    a, b, c = counts
    return wrapped(-a), wrapped(-b), wrapped(-c)


def _padded(link: Link, fields: bytes) -> bytes:
    """With the report number that hidapi wants in front, and zeros up to the link's length."""
    return b"\0" + fields.ljust(link.report_length, b"\0")


def _unknown(link: Link) -> ValueError:
    return ValueError(f"{link.name} has no public protocol, nothing is sent to it")
