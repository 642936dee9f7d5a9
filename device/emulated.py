# SPDX-License-Identifier: GPL-3.0-or-later
"""An arm in software: mechanics, encoders, motors, firmware and a hand, behind the same reports as a real one.

:class:`EmulatedArm` is the arm with its controller; its time goes on by ``step`` alone, so it is the same every time
and as fast as it can be computed. :class:`EmulatedHid` puts it behind hidapi's calls, by a clock.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from math import floor
from typing import Any

from . import kinematics, reports
from .hand import Hand, Intention, Keyframe, built_in, load_intention
from .plant import Plant
from .profile import DeviceProfile, Link

__all__ = ["EmulatedArm", "EmulatedHid", "Hand", "Intention", "Keyframe", "load_intention", "report_descriptor"]

Triple = tuple[float, float, float]

FRAME = 1e-3
"""Seconds: what full-speed USB carries a report in."""
APPROACH = 1.0
"""Seconds that a hand takes from where it held the arm to where its script begins."""
QUEUE = 64
"""Reports that Linux keeps for a program that does not read them; then it drops the new ones."""
LATE = 0.05
"""Seconds that are made up for when nobody asked for so long; beyond, the arm stood still."""
PATH = b"emulated"

_ZERO: Triple = (0.0, 0.0, 0.0)


def report_descriptor(link: Link) -> bytes:
    """The HID report descriptor of the firmware: `report_length` bytes in, as many out, no report numbers."""
    length = link.report_length
    page, usage = link.usage_page.to_bytes(2, "little"), link.usage.to_bytes(2, "little")
    head = b"\x06" + page + b"\x0a" + usage + b"\xa1\x01\x75\x08\x15\x00\x25\xff"
    return head + bytes((0x95, length, 0x09, 0x01, 0x81, 0x02, 0x95, length, 0x09, 0x02, 0x91, 0x02, 0xC0))


class EmulatedArm:
    """An arm of `profile` with the firmware of `link`, in the grip of `hand`; without one it is let go.

    It starts in the home pose with its counters at zero, as a real one that was put there and switched on. The hand
    holds it still until the arm is homed: by the command for it, or where there is none, by the first report, for the
    host sends none to an arm that is not armed. :meth:`begin` is the same by hand. Raises ValueError where the profile
    cannot be emulated.

    Attributes: ``time`` (s), ``enabled`` (the amplifiers are on), ``currents`` (A, those that flow), ``pressed`` (the
    stylus' button, None: as the script says).
    """

    def __init__(self, profile: DeviceProfile, link: Link, hand: Hand | None = None) -> None:
        self.profile, self.link, self.hand = profile, link, hand
        if hand:
            self._plant = Plant(profile, hand.mass, hand.damping, hand.stiffness)
            self._intention = hand.intention or built_in(profile.workspace_radius)
        else:
            self._plant = Plant(profile)
        self.time = 0.0
        self.pressed: bool | None = None
        self._held_at = self._plant.position()
        self._begun: float | None = None
        self.power_up()

    def power_up(self) -> None:
        """Switch the controller off and on: it forgets all, and counts from where the arm is now."""
        self.enabled = False
        self.currents: Triple = _ZERO
        self._torques: Triple = _ZERO
        self._since_output = 0.0
        self._answer_at: float | None = None
        self._calibrate = False
        self._number = 0
        self._offset = (0, 0, 0)
        a, b, c = self.counts
        self._offset = (-a, -b, -c)

    @property
    def angles(self) -> Triple:
        """Of the bodies, in rad."""
        return self._plant.angles

    @property
    def position(self) -> Triple:
        """Of the tip, in m."""
        return self._plant.position()

    @property
    def velocity(self) -> Triple:
        """Of the tip, in m/s."""
        return self._plant.velocity()

    @property
    def plant(self) -> Plant:
        """The mechanics."""
        return self._plant

    @property
    def counts(self) -> tuple[int, int, int]:
        """The controller's counters, not wrapped: whole encoder steps."""
        a, b, c = kinematics.counts_of(self.profile, self._plant.angles)
        oa, ob, oc = self._offset
        return floor(a) + oa, floor(b) + ob, floor(c) + oc

    @property
    def button(self) -> bool:
        """Whether the stylus' button is down."""
        if self.pressed is not None:
            return self.pressed
        return self._begun is not None and self.hand is not None and self._wish(self.time)[2]

    def begin(self) -> None:
        """The hand leaves where it held the arm, and follows its script."""
        if self._begun is None:
            self._begun = self.time

    def press_calibration(self) -> None:
        """The button on the base: reports say so until the counters are set."""
        self._calibrate = True

    def jump(self, counts: Sequence[int]) -> None:
        """The counters lose or win steps."""
        a, b, c = counts
        oa, ob, oc = self._offset
        self._offset = (oa + a, ob + b, oc + c)

    def step(self, dt: float = FRAME) -> None:
        """Let `dt` seconds pass."""
        if self.enabled and self._since_output > self.link.firmware_watchdog_ms / 1000.0 - 1e-9:
            self.enabled, self.currents, self._torques = False, _ZERO, _ZERO
        self._since_output += dt
        self._plant.step(dt, self._torques, self._pull if self.hand else None, self.time)
        self.time += dt

    def input_report(self) -> bytes | None:
        """The report that the firmware sends now; None while one that works in lock step waits for the host."""
        if self.link.lock_step:
            if self._answer_at is None or self.time < self._answer_at:
                return None
            self._answer_at = None
        self._number += 1
        return reports.encode_input(self.link, self.counts, self.button, self._calibrate, self._number)

    def output_report(self, data: bytes) -> None:
        """The firmware takes a report, without its number; one of another length is not taken.

        Any one switches the amplifiers on. A current over the firmware's limit becomes zero, and what is over what the
        motors stand saturates.
        """
        try:
            output = reports.decode_output(self.link, data)
        except ValueError:
            return
        if output.command == 1:
            self._offset = (0, 0, 0)
            a, b, c = self.counts
            ha, hb, hc = output.home
            self._offset = (ha - a, hb - b, hc - c)
            self._calibrate = False
            self.begin()
        elif self.link.layout == "protocol-1":
            self.begin()
        allowed, most = self.link.firmware_current_limit, self.profile.max_current
        ia, ib, ic = (0.0 if abs(current) > allowed else max(-most, min(most, current)) for current in output.currents)
        self.enabled, self.currents, self._since_output = True, (ia, ib, ic), 0.0
        self._torques = kinematics.motor_torques(self.profile, self.currents)
        # The answer goes in the frame after the one that brought the report, so a period takes two.
        self._answer_at = self.time + 1.5 * FRAME

    def _pull(self, now: float) -> tuple[Triple, Triple]:
        position, velocity, _ = self._wish(now)
        return position, velocity

    def _wish(self, now: float) -> tuple[Triple, Triple, bool]:
        """Where the hand wants the tip, in the device's frame."""
        if self._begun is None:
            return self._held_at, _ZERO, False
        elapsed = now - self._begun - APPROACH
        cx, cy, cz = self.profile.workspace_centre
        if elapsed >= 0.0:
            (x, y, z), velocity, button = self._intention.at(elapsed)
            return (x + cx, y + cy, z + cz), velocity, button
        (x, y, z), _, _ = self._intention.at(0.0)
        way = Intention((Keyframe(0.0, self._held_at), Keyframe(APPROACH, (x + cx, y + cy, z + cz))))
        position, velocity, _ = way.at(elapsed + APPROACH)
        return position, velocity, False


class EmulatedHid:
    """What the hidapi module is to a program, with one emulated arm to be found. Its reports appear by `clock` (s).

    `wait` is how a read that blocks lets time pass.
    """

    def __init__(
        self,
        profile: DeviceProfile,
        link: Link,
        hand: Hand | None = None,
        clock: Callable[[], float] = time.perf_counter,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self.arm = EmulatedArm(profile, link, hand)
        self._clock, self._wait = clock, wait
        self._start, self._frames = clock(), 0
        self._plugged = True
        self._reports: deque[bytes] = deque()
        self._open = False
        self.dropped = 0
        """Reports that found the queue full."""

    def enumerate(self, vendor: int = 0, product: int = 0) -> list[dict[str, Any]]:
        """As hidapi's."""
        link = self.arm.link
        if not self._plugged or vendor not in (0, link.vendor) or product not in (0, link.product):
            return []
        return [
            {
                "path": PATH,
                "vendor_id": link.vendor,
                "product_id": link.product,
                "serial_number": "",
                "release_number": 1,
                "manufacturer_string": "Repoussé",
                "product_string": f"{self.arm.profile.name} (emulated)",
                "usage_page": link.usage_page,
                "usage": link.usage,
                "interface_number": 0,
                "bus_type": 1,
            }
        ]

    def device(self) -> EmulatedDevice:
        """As hidapi's: not open yet."""
        return EmulatedDevice(self)

    def unplug(self) -> None:
        """The cable is pulled."""
        self._plugged = False
        self._reports.clear()

    def _pass_time(self) -> None:
        """Let the arm live up to now."""
        frames = floor((self._clock() - self._start) / FRAME + 1e-6)
        self._frames = max(self._frames, frames - round(LATE / FRAME))
        while self._frames < frames and self._plugged:
            self._frames += 1
            self.arm.step(FRAME)
            report = self.arm.input_report()
            if report is None or not self._open:
                continue
            if len(self._reports) < QUEUE:
                self._reports.append(report)
            else:
                self.dropped += 1


class EmulatedDevice:
    """As hidapi's device: the same calls, results and errors."""

    def __init__(self, hid: EmulatedHid) -> None:
        self._hid = hid
        self._is_open = False
        self._blocking = True
        self._error = ""

    def open_path(self, path: bytes) -> None:
        """Raises OSError where there is no such device, RuntimeError when it is open."""
        if self._is_open:
            raise RuntimeError("already open")
        if path != PATH or not self._hid._plugged:
            raise OSError("open failed")
        self._hid._pass_time()
        self._hid._reports.clear()
        self._is_open = self._hid._open = True

    def open(self, vendor: int = 0, product: int = 0, serial: str | None = None) -> None:
        """Raises OSError where there is no such device."""
        if not self._hid.enumerate(vendor, product):
            raise OSError("open failed")
        self.open_path(PATH)

    def close(self) -> None:
        """Closing twice is fine."""
        if self._is_open:
            self._is_open = self._hid._open = False

    def set_nonblocking(self, on: int) -> int:
        """Whether a read without a timeout waits."""
        self._check()
        self._blocking = not on
        return 0

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        """The oldest report that was not read; [] where none comes in time. Raises OSError once it is unplugged."""
        self._check()
        hid = self._hid
        until = None if self._blocking and not timeout_ms else hid._clock() + timeout_ms / 1000.0
        while True:
            hid._pass_time()
            if not hid._plugged:
                raise OSError("read error")
            if hid._reports:
                return list(hid._reports.popleft()[:max_length])
            now = hid._clock()
            if until is not None and now >= until:
                return []
            due = hid._start + (hid._frames + 1) * FRAME
            hid._wait(max(0.0, (due if until is None else min(due, until)) - now))

    def write(self, data: bytes | Sequence[int]) -> int:
        """How many bytes went, the report's number included; -1 once it is unplugged."""
        self._check()
        self._hid._pass_time()
        if not self._hid._plugged:
            self._error = "No such device"
            return -1
        data = bytes(data)
        if len(data) < 2:
            self._error = "Invalid argument"
            return -1
        self._error = ""
        self._hid.arm.output_report(data[1:])
        return len(data)

    def error(self) -> str:
        """Why the last write failed."""
        self._check()
        return self._error or "Success"

    def get_report_descriptor(self, max_length: int = 4096) -> list[int]:
        """As the firmware's."""
        self._check()
        return list(report_descriptor(self._hid.arm.link)[:max_length])

    def get_product_string(self) -> str:
        """As in enumerate()."""
        self._check()
        return f"{self._hid.arm.profile.name} (emulated)"

    def _check(self) -> None:
        if not self._is_open:
            raise ValueError("not open")
