# SPDX-License-Identifier: GPL-3.0-or-later
"""The USB side of an emulated arm: a hidraw node in a folder, where fakehid.c finds it."""

import fcntl
import select
import socket
import struct
import termios
from contextlib import suppress
from pathlib import Path

from log import Kind, Log

from repousse.device.emulated import QUEUE, report_descriptor
from repousse.device.profile import Link

LARGEST = 16384
"""Bytes of a report, of any device."""


def queue_size(length: int) -> int:
    """What SO_SNDBUF must be for QUEUE packets of `length` bytes to wait: the kernel counts what it spends on each."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        ours.send(bytes(length))
        (cost,) = struct.unpack("i", fcntl.ioctl(ours, termios.TIOCOUTQ, bytes(4)))
    return cost * QUEUE // 2  # the kernel doubles what it is told


class Node:
    """A hidraw node: any number of programs may have it open, each with a queue of its own."""

    def __init__(self, folder: Path, number: int, name: str, link: Link, journal: Log) -> None:
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
        self.path.with_suffix(".descriptor").write_bytes(report_descriptor(link))
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
            while data := _packet(program):
                self._log.add(Kind.RECEIVED, now, data)
                reports.append(data)
            if data is None:
                self._log.add(Kind.EVENT, now, b"close")
                self._drop(program)
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
            except OSError:  # it has closed the node; what it wrote last is read before it is dropped
                continue

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


def _packet(program: socket.socket) -> bytes | None:
    """The next packet, b"" while there is none, None when the other end has closed."""
    try:
        return program.recv(LARGEST) or None
    except ConnectionResetError:  # it closed with reports unread: told once, before what it has written itself
        return _packet(program)
    except BlockingIOError:
        return b""
    except OSError:
        return None
