# SPDX-License-Identifier: GPL-3.0-or-later
"""HID devices: which are there, which of them are ours, and one of them opened.

hidapi is called here alone, and only in a subprocess: it has crashed its host at unplugging and while enumerating.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .child import load_hidapi, read_config
from .profile import DeviceProfile, Link, builtin_profiles, load_profiles, recognise

LARGEST_REPORT = 64
"""Bytes: a full-speed interrupt packet."""
LONGEST_DRAIN = 130
"""Reports that are read in one go at most: twice what the kernel keeps. More means that they come faster than they can
be read, and the period must end some time."""

EMULATED = "emulated"
"""The path of the arm in software, which is within the loop's own process."""
READY, NO_PERMISSION, VENDOR_DRIVER = "ready", "no permission", "vendor driver needed"


@dataclass(frozen=True)
class Found:
    """A device that a profile knows.

    ``path`` is hidapi's, ``report_length`` in bytes is None where it cannot be known without opening. ``candidates``
    are the (profile key, link name) that fit: a vendor's default id fits many. ``message`` says what to do.
    """

    path: str
    vendor: int
    product: int
    name: str
    usage_page: int
    report_length: int | None
    state: str
    message: str
    candidates: tuple[tuple[str, str], ...]


def input_length(descriptor: Sequence[int]) -> int:
    """Bytes of the input report that a HID report descriptor without report ids describes; 0 for none.

    Items are a byte (tag, type, size) and up to four of data (USB HID 1.11, 6.2.2.2).
    """
    bits = size = count = at = 0
    while at < len(descriptor):
        item = descriptor[at]
        length = (0, 1, 2, 4)[item & 3]
        value = int.from_bytes(bytes(descriptor[at + 1 : at + 1 + length]), "little")
        kind = item & 0xFC
        if kind == 0x74:  # report size
            size = value
        elif kind == 0x94:  # report count
            count = value
        elif kind == 0x80:  # input
            bits += size * count
        at += 1 + length
    return bits // 8


def descriptor_length(path: str) -> int | None:
    """Bytes of the input report of a hidraw node, as Linux tells it without opening the device; None elsewhere."""
    try:
        return input_length(Path("/sys/class/hidraw", Path(path).name, "device", "report_descriptor").read_bytes())
    except OSError:
        return None


def recognised(devices: Iterable[dict[str, Any]], profiles: Iterable[DeviceProfile]) -> list[Found]:
    """Which of hidapi's ``enumerate()`` a profile knows, in its order. Nothing is opened."""
    profiles = list(profiles)
    return [found for device in devices if (found := _found(device, profiles)) is not None]


def _found(device: dict[str, Any], profiles: list[DeviceProfile]) -> Found | None:
    path = os.fsdecode(device["path"])
    page, length = device.get("usage_page") or 0, descriptor_length(path)
    matches = recognise(profiles, device["vendor_id"], device["product_id"], page, length)
    if not matches:
        return None
    state, message = READY, ""
    refused = next((profile for profile, _ in matches if not profile.driven), None)
    if refused is not None:
        state, message = VENDOR_DRIVER, refused.message
    elif path.startswith("/dev/") and not os.access(path, os.R_OK | os.W_OK):
        state, message = NO_PERMISSION, f"{path}: you may not read and write it; a udev rule lets you"
    return Found(
        path=path,
        vendor=device["vendor_id"],
        product=device["product_id"],
        name=device.get("product_string") or matches[0][0].name,
        usage_page=page,
        report_length=length,
        state=state,
        message=message,
        candidates=tuple((profile.key, link.name) for profile, link in matches if profile.driven),
    )


def udev_rule(links: Iterable[Link]) -> str:
    """The lines that let who sits at the machine use these devices, for a file in /etc/udev/rules.d whose name sorts
    before 73 (where systemd hands out the seat's devices)."""
    ids = sorted({(link.vendor, link.product) for link in links})
    return "".join(
        f'KERNEL=="hidraw*", ATTRS{{idVendor}}=="{vendor:04x}", ATTRS{{idProduct}}=="{product:04x}", TAG+="uaccess"\n'
        for vendor, product in ids
    )


class OpenError(RuntimeError):
    """The device cannot be used; the text is one line."""


class UnpluggedError(RuntimeError):
    """The device is gone."""


class Wire:
    """An open device, read and written without ever waiting. For one thread.

    ``superseded`` counts reports that a newer one was there for when they were read.
    """

    def __init__(self, device: Any, link: Link) -> None:
        self._device, self._link = device, link
        self.superseded = 0

    @classmethod
    def open(cls, hid: Any, path: str, link: Link) -> Wire:
        """Open the device at ``path``, when it speaks as ``link`` says. Raises OpenError with one line."""
        device = hid.device()
        try:
            device.open_path(os.fsencode(path))
            device.set_nonblocking(1)
            length = input_length(device.get_report_descriptor())
        except (OSError, RuntimeError, ValueError) as error:
            device.close()
            raise OpenError(f"{path}: cannot be opened ({error}): is it plugged in, and may you use it?") from error
        if length != link.report_length:
            device.close()
            raise OpenError(
                f"{path}: sends reports of {length} bytes, not {link.report_length} as {link.name} does: "
                "choose the profile of this arm"
            )
        return cls(device, link)

    def newest(self) -> list[int] | None:
        """The newest report that has come since this was last asked; None when there is none.

        After a pause the kernel hands out the oldest first, so all are read. Raises UnpluggedError.
        """
        newest = None
        try:
            for _ in range(LONGEST_DRAIN):
                data = self._device.read(LARGEST_REPORT + 1)
                if not data:
                    break
                self.superseded += newest is not None
                newest = data
        except (OSError, ValueError) as error:
            raise UnpluggedError(str(error)) from error
        return newest

    def write(self, report: bytes) -> bool:
        """Send a report, with its leading id; whether all of it went."""
        try:
            return bool(self._device.write(report) == len(report))
        except (OSError, ValueError):
            return False

    def close(self) -> None:
        """Let go of the device."""
        self._device.close()


def main() -> int:
    """Print what is there as JSON, in a subprocess: ``{"hidapi": [name, file], "profiles": folder or null}``."""
    try:
        config = read_config()
        folder = config.get("profiles")
        profiles = builtin_profiles() | (load_profiles(folder)[0] if folder else {})
        hid = load_hidapi(*config["hidapi"])
        found = recognised(hid.enumerate(), profiles.values())
    except (ImportError, OSError, ValueError, KeyError, TypeError) as error:
        print(f"the devices cannot be listed: {error}", file=sys.stderr)
        return 1
    print(json.dumps([asdict(device) for device in found]))
    return 0
