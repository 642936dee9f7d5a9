# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that is an arm: its USB side is a socket in a folder, where fakehid.c finds it. ServedArm (served_arm.py)
starts it, gives it orders and ends it.

The first line of stdin is its configuration, each other line an order, as JSON; each is answered by a line of JSON on
stdout. The end of stdin is the end of the process, so it cannot outlive its owner.
"""

import errno
import fcntl
import gc
import importlib
import importlib.util
import json
import os
import select
import shutil
import socket
import struct
import sys
import termios
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[3]
TICK = 1e-3
"""Seconds between two reports: a frame of full-speed USB."""
QUEUE = 64
"""Reports that Linux keeps for each program that has a hidraw node open (HIDRAW_BUFFER_SIZE); it then drops the new."""
LARGEST = 16384
LATE = 0.05
"""Seconds by which the process may be late and still catch up. Beyond, the arm has stood still meanwhile."""
PRIORITY = 50


def _package(name: str, folder: Path) -> None:
    spec = importlib.util.spec_from_file_location(
        name, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)


def _module_at(name: str, path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


# The device package alone, under a name of its own, as the loop's subprocess has it: nothing else of the extension.
_package("repousse_device", ROOT / "device")
emulated = importlib.import_module("repousse_device.emulated")
profiles = importlib.import_module("repousse_device.profile")
log = _module_at("shim_log", Path(__file__).with_name("log.py"))
Kind = log.Kind


def queue_size(length: int) -> int:
    """What SO_SNDBUF must be for QUEUE packets of `length` bytes to wait: the kernel counts what it spends on each."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        ours.send(bytes(length))
        (cost,) = struct.unpack("i", fcntl.ioctl(ours, termios.TIOCOUTQ, bytes(4)))
    return cost * QUEUE // 2  # the kernel doubles what it is told


class Node:
    """A hidraw node: any number of programs may have it open, each with a queue of its own."""

    def __init__(self, folder: Path, number: int, name: str, link: Any, journal: Any) -> None:
        self.path = folder / f"hidraw{number}"
        self._name, self._link, self._log = name, link, journal
        self._size = queue_size(link.report_length)
        self._programs: list[socket.socket] = []
        self.sent = self.dropped = 0
        self._listener: socket.socket | None = None
        self._poll = select.poll()
        self.plug()

    @property
    def is_open(self) -> bool:
        """Whether a program has it open."""
        return bool(self._programs)

    def plug(self) -> None:
        """The node appears."""
        link = self._link
        self.path.with_suffix(".descriptor").write_bytes(emulated.report_descriptor(link))
        identity = f"HID_ID=0003:{link.vendor:08X}:{link.product:08X}\nHID_NAME={self._name}\nHID_UNIQ=\n"
        self.path.with_suffix(".uevent").write_text(identity)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self._listener.bind(str(self.path))
        self._listener.listen(8)
        self._poll.register(self._listener, select.POLLIN)

    def unplug(self) -> None:
        """The node is gone, for programs that have it open as well."""
        for program in list(self._programs):
            self._drop(program)
        if self._listener is not None:
            self._poll.unregister(self._listener)
            self._listener.close()
            self._listener = None
        for file in (self.path, self.path.with_suffix(".uevent"), self.path.with_suffix(".descriptor")):
            file.unlink(missing_ok=True)

    def received(self, now: float) -> list[bytes]:
        """The reports that have come, with their numbers; lets in who wants to open the node."""
        reports = []
        for descriptor, _ in self._poll.poll(0):
            if self._listener is not None and descriptor == self._listener.fileno():
                self._let_in(now)
                continue
            program = next(one for one in self._programs if one.fileno() == descriptor)
            with suppress(BlockingIOError):
                while True:
                    try:
                        data = program.recv(LARGEST)
                    except OSError as error:
                        if error.errno == errno.EAGAIN:
                            raise
                        data = b""
                    if not data:
                        self._log.add(Kind.EVENT, now, b"close")
                        self._drop(program)
                        break
                    self._log.add(Kind.RECEIVED, now, data)
                    reports.append(data)
        return reports

    def send(self, report: bytes, now: float) -> None:
        """Give a report to each program, unless its queue is full."""
        for program in list(self._programs):
            try:
                program.send(report, socket.MSG_NOSIGNAL)
                self.sent += 1
                self._log.add(Kind.SENT, now, report)
            except BlockingIOError:
                self.dropped += 1
                self._log.add(Kind.DROPPED, now, report)
            except OSError:
                self._drop(program)

    def _let_in(self, now: float) -> None:
        assert self._listener is not None
        with suppress(BlockingIOError):
            program, _ = self._listener.accept()
            program.setblocking(False)
            program.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._size)
            self._programs.append(program)
            self._poll.register(program, select.POLLIN)
            self._log.add(Kind.EVENT, now, b"open")

    def _drop(self, program: socket.socket) -> None:
        self._poll.unregister(program)
        self._programs.remove(program)
        program.close()


class Server:
    """The arm, its node, and what is wrong with them.

    Orders are its public methods whose names begin with ``do_``; they may raise ValueError or TypeError.
    """

    def __init__(self, config: dict[str, Any]) -> None:
        self._folder = Path(config["folder"])
        profile = profiles.from_json(config["profile"])
        (link,) = profile.links
        script = config.get("script")
        intention = emulated.load_intention(Path(script)) if script else None
        hand = getattr(emulated.Hand, config.get("hand", "soft"))(intention)
        self.arm = emulated.EmulatedArm(profile, link, hand)
        self._log = log.Log()
        self._node = Node(self._folder, int(config.get("number", 0)), profile.name, link, self._log)
        self._log_states = bool(config.get("log_states", True))
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
        if now < self._stalled_until or not self._plugged:
            return
        for data in self._node.received(now):
            self.arm.output_report(data[1:])
        self.arm.step(TICK)
        if self._log_states:
            arm = self.arm
            self._log.add_state(now, (arm.enabled, arm.currents, arm.position, arm.velocity))
        if self._silent:
            return
        report = self.arm.input_report()
        if report is None:
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
        """The cable is pulled: no power either."""
        self._plugged = False
        self._node.unplug()

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
        """The arm's firmware stands still for a while."""
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


def main(wants: Callable[[], bytes]) -> int:
    """Serve until stdin ends; 1 with a line of JSON when it cannot begin."""
    config = json.loads(wants())
    try:
        server = Server(config)
    except (OSError, ValueError, KeyError, AttributeError) as error:
        tell({"error": f"{type(error).__name__}: {error}"})
        return 1
    server.fifo = bool(config.get("fifo", True)) and go_first()
    gc.collect()
    gc.freeze()
    gc.disable()
    tell({"fifo": server.fifo, "time": time.perf_counter()})
    try:
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
    sys.exit(main(first_line))
