# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender and the loop say to each other: one struct in shared memory, documented here and nowhere else.

========  ==========================================================================================================
offset    what
========  ==========================================================================================================
0         header: ``REPOUSSE``, version, size of all of this in bytes (8s I I), then 1 while Blender keeps it open (Q)
24        four records, each a seqlock: sequence (Q), checksum of payload and sequence (I), 4 unused bytes, payload:
          ``model`` (:class:`ForceModel`) and ``request`` (:class:`Request`), written by Blender, by one thread each;
          ``state`` (:class:`ArmState`) and ``figures`` (:class:`Figures`), written by the loop
after     two histograms of 32-bit counters, written by the loop: its periods, and what it computes in one
========  ==========================================================================================================

A payload has its class's fields in native byte order: first the triples, 3d each, then the others, a float as d and an
int, bool or IntEnum as q, both in the order of the class. Nothing is ever unpickled, and a peer of another version or
size is refused.

A record is being written while its sequence is odd. A reader that sees it odd or changed, or whose checksum does not
fit (memory order is no promise of Python's), tries again, at most :data:`TRIES` times; then it goes on with the last
good one, whose age it knows.

The memory has no name where the system allows: a sealed memfd on Linux, an unlinked temporary file on macOS, both
handed to the subprocess as a descriptor. So none can be left behind, whoever is killed, no resource tracker unlinks it
too early, and on Linux nobody can shorten it under a reader. On Windows it is a mapping backed by the pagefile, which
goes with its last handle.
"""

from __future__ import annotations

import mmap
import os
import secrets
import struct
import sys
import tempfile
import zlib
from enum import IntEnum
from itertools import chain
from operator import itemgetter
from typing import Generic, NamedTuple, TypeVar

from .safety import Fault, State

MAGIC = b"REPOUSSE"
VERSION = 3
TRIES = 20
"""How often a reader tries to see a record whole."""
HEADER = struct.Struct("=8sIIQ")
_LOCK = struct.Struct("=QII")

PERIOD_BIN, PERIOD_BINS = 10e-6, 2000
"""Of the histogram of periods: seconds in a bin, and bins; the last one holds all that is longer."""
WORK_BIN, WORK_BINS = 1e-6, 1000
"""Of the histogram of what the loop computes in a period: from the report and the model that it has read to the
currents that it writes."""

Triple = tuple[float, float, float]
_ZERO = (0.0, 0.0, 0.0)


class Coupling(IntEnum):
    """How the loop gets from the models it is sent to a force at each of its periods.

    ``LOCAL``: the tangent at the arm's present position (DESIGN 4). ``INTERPOLATE``: the paper's, from the last stress
    but one to the last.
    """

    LOCAL, INTERPOLATE = range(2)


class ForceModel(NamedTuple):
    """The material around one pose: at x the force is clamp(stress + gradient . (x - position), 0, yield_stress) along
    ``normal``.

    ``time`` (perf_counter, seconds) when the voxels were so. ``position`` is in metres in the device's frame,
    ``stress`` and ``yield_stress`` in N, ``gradient`` in N/m, ``normal`` points out of the material and is at most 1
    long, ``damping`` along it in N s/m. ``scene`` rises when the grid, the tool, the material or the frame was changed
    by anything but the stroke itself; 0: nothing is there to be felt. ``exponent``: where it is under 1, the stress has
    grown as this power up to here, and so by gradient / exponent on average. ``turning_x``, ``turning_y`` and
    ``turning_z`` are the derivatives of the normal, 1/m, by the place of the tip.
    """

    time: float = 0.0
    position: Triple = _ZERO
    stress: float = 0.0
    yield_stress: float = 0.0
    gradient: Triple = _ZERO
    normal: Triple = _ZERO
    scene: int = 0
    damping: float = 0.0
    exponent: float = 1.0
    turning_x: Triple = _ZERO
    turning_y: Triple = _ZERO
    turning_z: Triple = _ZERO


class Request(NamedTuple):
    """What the user wants. ``home``, ``arm`` and ``disarm`` count the orders given so far: a rise is an order.

    ``force_scale`` is from 0 to 1. While ``clutch`` is held the arm moves and the tool does not: no force.
    """

    home: int = 0
    arm: int = 0
    disarm: int = 0
    force_scale: float = 1.0
    coupling: Coupling = Coupling.LOCAL
    clutch: bool = False


class ArmState(NamedTuple):
    """The arm at one period of the loop.

    ``time`` (perf_counter, seconds), ``tick`` (periods so far), ``position`` (m) and ``velocity`` (m/s) of the tip and
    ``force`` (N) on it in the device's frame, ``angles`` (rad) of its joints, ``counts`` of their encoders,
    ``currents`` (A), ``buttons`` (bit 0: the stylus button), ``ramp`` (0 to 1) of an engagement, ``heat`` (0 to 1) of
    the warmest motor, ``waiting`` for the force to be small enough to engage, ``model_age`` and ``report_age`` in
    seconds, ``slope_asked`` by the material and ``slope_granted`` in N/m.
    """

    time: float = 0.0
    tick: int = 0
    state: State = State.CLOSED
    fault: Fault = Fault.NONE
    position: Triple = _ZERO
    velocity: Triple = _ZERO
    force: Triple = _ZERO
    angles: Triple = _ZERO
    counts: Triple = _ZERO
    currents: Triple = _ZERO
    buttons: int = 0
    ramp: float = 0.0
    heat: float = 0.0
    waiting: bool = False
    model_age: float = 0.0
    report_age: float = 0.0
    slope_asked: float = 0.0
    slope_granted: float = 0.0


class Figures(NamedTuple):
    """How the loop fares, told once in a while.

    ``rate`` in Hz over the last second, ``longest`` period in seconds so far, ``lost`` reports by the arm's own count,
    ``superseded`` ones that were read together with a newer, ``torn`` reads of the shared memory that were given up,
    ``realtime``: whether the system lets the loop go first. ``read``, ``pose``, ``force``, ``write``, ``tell``: seconds
    a period spends in each of these, the mean of the last second.
    """

    rate: float = 0.0
    longest: float = 0.0
    ticks: int = 0
    lost: int = 0
    superseded: int = 0
    torn: int = 0
    realtime: bool = False
    read: float = 0.0
    pose: float = 0.0
    force: float = 0.0
    write: float = 0.0
    tell: float = 0.0


class ProtocolError(RuntimeError):
    """The shared memory is not what this version expects; the text is one line."""


T = TypeVar("T", bound=tuple)


class Layout(Generic[T]):
    """How one record class lies in memory. Called each millisecond, so the work is done by tuples' own code."""

    def __init__(self, record: type[T]) -> None:
        kinds = [type(default) for default in record._field_defaults.values()]  # type: ignore[attr-defined]
        triples = [index for index, kind in enumerate(kinds) if kind is tuple]
        scalars = [index for index, kind in enumerate(kinds) if kind is not tuple]
        codes = ("d" if kinds[index] is float else "q" for index in scalars)
        self.struct = struct.Struct("=" + 3 * len(triples) * "d" + "".join(codes))
        self._record, self._split = record, 3 * len(triples)
        self._triples, self._scalars = itemgetter(*triples, triples[0]) if triples else None, itemgetter(*scalars)
        self._order = itemgetter(*_inverse([*triples, *scalars]))
        self._kinds = [(index, kinds[index]) for index in scalars if kinds[index] not in (float, int)]

    def pack(self, values: T) -> bytes:
        """The payload of a record."""
        if self._triples is None:
            return self.struct.pack(*values)
        return self.struct.pack(*chain.from_iterable(self._triples(values)[:-1]), *self._scalars(values))

    def unpack(self, payload: bytes) -> T:
        """The record of a payload. Raises ValueError where a number names no member of an enumeration."""
        flat, split = self.struct.unpack(payload), self._split
        values = self._order((*zip(*[iter(flat[:split])] * 3), *flat[split:]))
        if self._kinds:
            values = list(values)
            for index, kind in self._kinds:
                values[index] = kind(values[index])
        return self._record._make(values)  # type: ignore[attr-defined]


def _inverse(order: list[int]) -> list[int]:
    """Where each index is in ``order``."""
    return sorted(range(len(order)), key=order.__getitem__)


class Record(Generic[T]):
    """One seqlock in the memory. Either :meth:`write` or :meth:`read` is used on it, by one thread of one process."""

    def __init__(self, memory: memoryview, offset: int, layout: Layout[T], initial: T) -> None:
        self._layout = layout
        self._sequence = memory[offset : offset + 8].cast("Q")  # one item is stored and loaded in one piece
        self._checksum = memory[offset + 8 : offset + 12].cast("I")
        start = offset + _LOCK.size
        self._payload = memory[start : start + layout.struct.size]
        self._seen = 0
        self._last = initial
        self.torn = 0

    def write(self, values: T) -> None:
        """Publish ``values``."""
        sequence = self._sequence[0] | 1  # odd: also where a writer was killed before it was done
        payload = self._layout.pack(values)
        self._sequence[0] = sequence
        self._payload[:] = payload
        self._checksum[0] = zlib.crc32(payload, (sequence + 1) & 0xFFFFFFFF)
        self._sequence[0] = sequence + 1

    def read(self) -> T:
        """The newest record that can be seen whole; the last good one where :data:`TRIES` looks were not enough.

        The same object as before as long as nothing new was written.
        """
        for _ in range(TRIES):
            sequence = self._sequence[0]
            if sequence == self._seen:
                return self._last
            if sequence % 2:
                continue
            payload = bytes(self._payload)
            whole = self._checksum[0] == zlib.crc32(payload, sequence & 0xFFFFFFFF)
            if whole and self._sequence[0] == sequence:
                try:
                    self._last = self._layout.unpack(payload)
                except ValueError:  # a number that means nothing
                    break
                self._seen = sequence
                return self._last
        self.torn += 1
        return self._last

    def release(self) -> None:
        """Let go of the memory."""
        for view in (self._sequence, self._checksum, self._payload):
            view.release()


MODEL, REQUEST = Layout(ForceModel), Layout(Request)
STATE, FIGURES = Layout(ArmState), Layout(Figures)


def _aligned(offset: int) -> int:
    return (offset + 7) // 8 * 8


def _offsets() -> list[int]:
    offsets = [HEADER.size]
    for layout in (MODEL, REQUEST, STATE, FIGURES):
        offsets.append(_aligned(offsets[-1] + _LOCK.size + layout.struct.size))
    return [*offsets, offsets[-1] + 4 * PERIOD_BINS]


_MODEL_AT, _REQUEST_AT, _STATE_AT, _FIGURES_AT, _PERIODS_AT, _WORK_AT = _offsets()
SIZE = _WORK_AT + 4 * WORK_BINS


class SharedMemory:
    """The struct as one side has it: made by Blender (:meth:`create`), opened by the loop (:meth:`attach`).

    Attributes
    ----------
    model, request, state, figures
        The records.
    periods, work
        The histograms, views of 32-bit counters.
    address
        What :meth:`attach` needs in the other process; on POSIX ``descriptor`` must be handed down to it as well.
    """

    def __init__(self, mapping: mmap.mmap, address: str, descriptor: int | None) -> None:
        self._mapping, self.address, self.descriptor = mapping, address, descriptor
        self._view = memoryview(mapping)
        self.model = Record(self._view, _MODEL_AT, MODEL, ForceModel())
        self.request = Record(self._view, _REQUEST_AT, REQUEST, Request())
        self.state = Record(self._view, _STATE_AT, STATE, ArmState())
        self.figures = Record(self._view, _FIGURES_AT, FIGURES, Figures())
        self.periods = self._view[_PERIODS_AT:_WORK_AT].cast("I")
        self.work = self._view[_WORK_AT:SIZE].cast("I")
        self._open = self._view[HEADER.size - 8 : HEADER.size].cast("Q")

    @classmethod
    def create(cls) -> SharedMemory:
        """A new one, all zero but the header. Raises OSError where the system gives none."""
        mapping, address, descriptor = _new_mapping()
        HEADER.pack_into(mapping, 0, MAGIC, VERSION, SIZE, 1)
        return cls(mapping, address, descriptor)

    @classmethod
    def attach(cls, address: str) -> SharedMemory:
        """The one that another process made. Raises ProtocolError when it is not of this version and size."""
        try:
            mapping, descriptor = _open_mapping(address)
        except (OSError, ValueError) as error:
            raise ProtocolError(f"shared memory {address}: cannot be opened: {error}") from error
        magic, version, size, is_open = HEADER.unpack_from(mapping, 0)
        if (magic, version, size, is_open) != (MAGIC, VERSION, SIZE, 1):
            mapping.close()
            raise ProtocolError(
                f"shared memory {address}: is version {version} with {size} bytes, not version {VERSION} with {SIZE}: "
                "restart Blender, so that both sides are of the same Repoussé"
            )
        return cls(mapping, address, descriptor)

    @property
    def is_open(self) -> bool:
        """Whether Blender still keeps it."""
        return self._open[0] == 1

    @property
    def torn(self) -> int:
        """Reads that this side has given up."""
        return self.model.torn + self.request.torn + self.state.torn + self.figures.torn

    def close(self, last: bool = False) -> None:
        """Let go of it; ``last``: and tell the other side to do so as well. Closing twice is fine."""
        if self._mapping.closed:
            return
        if last:
            self._open[0] = 0
        for record in (self.model, self.request, self.state, self.figures):
            record.release()
        for view in (self.periods, self.work, self._open, self._view):
            view.release()
        self._mapping.close()
        if self.descriptor is not None:
            os.close(self.descriptor)


def _new_mapping() -> tuple[mmap.mmap, str, int | None]:
    if sys.platform == "win32":
        name = f"repousse-{os.getpid()}-{secrets.token_hex(8)}"
        return mmap.mmap(-1, SIZE, tagname=name), name, None
    descriptor = _anonymous_file()
    return mmap.mmap(descriptor, SIZE), str(descriptor), descriptor


def _anonymous_file() -> int:
    """The descriptor of a file without a name, of the right size."""
    if hasattr(os, "memfd_create"):
        import fcntl

        descriptor = os.memfd_create("repousse", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(descriptor, SIZE)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        return descriptor
    with tempfile.TemporaryFile() as file:
        os.ftruncate(file.fileno(), SIZE)
        return os.dup(file.fileno())


def _open_mapping(address: str) -> tuple[mmap.mmap, int | None]:
    if sys.platform == "win32":
        return mmap.mmap(-1, SIZE, tagname=address), None
    descriptor = int(address)
    if os.fstat(descriptor).st_size != SIZE:
        raise ValueError(f"{os.fstat(descriptor).st_size} bytes where {SIZE} are expected")
    return mmap.mmap(descriptor, SIZE), descriptor
