# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that is an arm: its USB side is a socket in a folder, where fakehid.c finds it. ServedArm (served_arm.py)
starts it, gives it orders and ends it.

The first line of stdin is its configuration, each other line an order, as JSON; each is answered by a line of JSON on
stdout. The end of stdin is the end of the process, so it cannot outlive its owner.
"""

import gc
import json
import os
import shutil
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from log import Kind, Log, Moment
from node import Node

from repousse.device.emulated import EmulatedArm, Hand, load_intention
from repousse.device.profile import from_json

TICK = 1e-3
"""Seconds between two reports: a frame of full-speed USB."""
LATE = 0.05
"""Seconds by which the process may be late and still catch up. Beyond, the arm has stood still meanwhile."""
PRIORITY = 50
"""Of SCHED_FIFO: below the loop's."""


class Server:
    """The arm, its node, and what is wrong with them.

    Orders are its methods whose names begin with ``do_``, values by name; what they return is told with the answer.
    """

    def __init__(self, config: dict[str, Any]) -> None:
        self._folder = Path(config["folder"])
        profile = from_json(config["profile"])
        (link,) = profile.links
        script = config["script"]
        intention = load_intention(Path(script)) if script else None
        hand = getattr(Hand, config["hand"])(intention)
        self.arm = EmulatedArm(profile, link, hand)
        self._log = Log()
        self._node = Node(self._folder, config["number"], profile.name, link, self._log)
        self._log_states = config["log_states"]
        self._silent = False
        self._dropping = 0
        self._instead: list[bytes] = []
        self._stalled_until = 0.0
        self._late = 0
        self._plugged = True
        self.fifo = False

    def run(self) -> None:
        """A report each millisecond, until stdin ends."""
        stdin = sys.stdin.fileno()
        os.set_blocking(stdin, False)
        orders = b""
        due = time.perf_counter()
        while True:
            due += TICK
            wait = due - time.perf_counter()
            if wait > 0.0:
                time.sleep(wait)
            elif wait < -LATE:
                due -= wait
                self._late += 1
            try:
                more = os.read(stdin, 65536)
            except BlockingIOError:
                pass
            else:
                if not more:
                    return
                *lines, orders = (orders + more).split(b"\n")
                for line in lines:
                    self._obey(line)
            self._tick(time.perf_counter())

    def _tick(self, now: float) -> None:
        speaks = self._plugged and now >= self._stalled_until
        if speaks:
            for data in self._node.received(now):
                self.arm.output_report(data[1:])
        arm = self.arm
        arm.step(TICK)
        if self._log_states:
            self._log.add_state(now, Moment(arm.enabled, arm.currents, arm.position, arm.velocity))
        if not speaks or self._silent or (report := arm.input_report()) is None:
            return
        if self._dropping:
            self._dropping -= 1
            self._log.add(Kind.DROPPED, now, report)
            return
        if self._instead:
            report = self._instead.pop(0)
        self._node.send(report, now)

    def _obey(self, line: bytes) -> None:
        try:
            order = json.loads(line)
            name = order.pop("order")
            answer = getattr(self, f"do_{name}")(**order) or {}
        except (ValueError, TypeError, AttributeError, KeyError) as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        now = time.perf_counter()
        self._log.add(Kind.EVENT, now, line.strip())
        tell(answer | {"time": now})

    def do_unplug(self) -> None:
        """The cable is pulled: the controller has no power either."""
        self._plugged = False
        self._node.unplug()
        self.arm.power_up()

    def do_plug(self) -> None:
        """The cable is put in: the arm starts anew where it stands."""
        if not self._plugged:
            self.arm.power_up()
            self._node.plug()
            self._plugged = True

    def do_silence(self, on: bool = True) -> None:
        """No more reports; those that come are obeyed."""
        self._silent = on

    def do_stall(self, seconds: float) -> None:
        """The controller neither reads nor sends for a while."""
        self._stalled_until = time.perf_counter() + seconds

    def do_drop(self, count: int = 1) -> None:
        """Some reports are lost on their way."""
        self._dropping = count

    def do_instead(self, data: str, count: int = 1) -> None:
        """Some reports are replaced by these bytes (hexadecimal): of a wrong length, or with wrong counts."""
        self._instead = [bytes.fromhex(data)] * count

    def do_jump(self, counts: list[int]) -> None:
        """Encoders lose steps."""
        self.arm.jump(counts)

    def do_press(self, down: bool | None = True) -> None:
        """The stylus' button; None: as the hand's script says."""
        self.arm.pressed = down

    def do_calibrate(self) -> None:
        """The calibration button is pressed."""
        self.arm.press_calibration()

    def do_begin(self) -> None:
        """The hand begins to follow its script."""
        self.arm.begin()

    def do_state(self) -> dict[str, Any]:
        """The arm now; reports that programs got, and that found a queue full; how often the process came too late."""
        arm = self.arm
        return {
            "position": arm.position,
            "velocity": arm.velocity,
            "angles": arm.angles,
            "currents": arm.currents,
            "enabled": arm.enabled,
            "late": self._late,
            "sent": self._node.sent,
            "dropped": self._node.dropped,
            "open": self._node.is_open,
            "fifo": self.fifo,
        }

    def do_log(self) -> dict[str, Any]:
        """Write what has been recorded to the folder."""
        path = self._folder / "log"
        self._log.append_to(path)
        return {"log": str(path)}

    def close(self) -> None:
        """Leave nothing behind: an owner that was killed cannot."""
        self._node.unplug()
        shutil.rmtree(self._folder, ignore_errors=True)


def tell(answer: dict[str, Any]) -> None:
    """A line of JSON for the owner; when it has gone, stdin's end says so."""
    with suppress(OSError):
        os.write(1, json.dumps(answer).encode() + b"\n")


def go_first() -> bool:
    """Before ordinary processes, where the system agrees."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        return True
    return False


def main() -> int:
    """Serve until stdin ends; 1 with a line of JSON when it cannot begin."""
    try:
        config = json.loads(first_line())
        server = Server(config)
    except (OSError, ValueError, KeyError, AttributeError) as error:
        tell({"error": f"{type(error).__name__}: {error}"})
        return 1
    try:
        server.fifo = bool(config["fifo"]) and go_first()
        gc.collect()
        gc.freeze()
        gc.disable()
        tell({"fifo": server.fifo, "time": time.perf_counter()})
        server.run()
    finally:
        server.close()
    return 0


def first_line() -> bytes:
    """Of stdin, byte by byte, for what follows is read without waiting."""
    line = b""
    while not line.endswith(b"\n") and (byte := os.read(0, 1)):
        line += byte
    return line


if __name__ == "__main__":
    sys.exit(main())
