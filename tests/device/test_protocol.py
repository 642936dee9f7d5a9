# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender and the loop say to each other arrives whole or not at all."""

import os
import struct
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.device import child, protocol
from repousse.device.protocol import (
    TRIES,
    ArmState,
    Coupling,
    Figures,
    ForceModel,
    ProtocolError,
    Request,
    SharedMemory,
)
from repousse.device.safety import Fault, State

RECORDS = (ForceModel, Request, ArmState, Figures)
KINDS = {
    float: st.floats(allow_nan=False),
    int: st.integers(-(2**63), 2**63 - 1),
    bool: st.booleans(),
    tuple: st.tuples(*[st.floats(allow_nan=False)] * 3),
    State: st.sampled_from(State),
    Fault: st.sampled_from(Fault),
    Coupling: st.sampled_from(Coupling),
}


def any_record(record):
    return st.builds(record, **{name: KINDS[type(default)] for name, default in record._field_defaults.items()})


@pytest.fixture
def memory():
    memory = SharedMemory.create()
    yield memory
    memory.close(last=True)


def other_side(memory):
    """The same memory, as another process has it."""
    if memory.descriptor is None:
        return SharedMemory.attach(memory.address)
    return SharedMemory.attach(str(os.dup(memory.descriptor)))


@pytest.fixture
def loop(memory):
    loop = other_side(memory)
    yield loop
    loop.close()


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.__name__)
@given(data=st.data())
def test_every_value_arrives(record, data):
    values = data.draw(any_record(record))
    layout = protocol.Layout(record)
    arrived = layout.unpack(layout.pack(values))
    assert arrived == values and list(map(type, arrived)) == list(map(type, values))


def test_each_side_reads_what_the_other_writes(memory, loop):
    model = ForceModel(time=1.5, position=(0.1, 0.2, 0.3), stress=2.0, yield_stress=3.0, scene=7)
    memory.model.write(model)
    assert loop.model.read() == model
    state = ArmState(time=2.0, state=State.RUN, fault=Fault.NONE, force=(1.0, 2.0, 3.0), waiting=True)
    loop.state.write(state)
    assert memory.state.read() == state
    memory.request.write(Request(home=3, coupling=Coupling.INTERPOLATE))
    assert loop.request.read() == Request(home=3, coupling=Coupling.INTERPOLATE)
    loop.periods[5] += 2
    loop.work[-1] += 1
    assert memory.periods[5] == 2 and memory.work[len(memory.work) - 1] == 1


def test_records_do_not_touch_each_other(memory, loop):
    """Each written full of ones: the neighbours are what they were."""
    memory.model.write(ForceModel(1.0, (1.0,) * 3, 1.0, 1.0, (1.0,) * 3, (1.0,) * 3, -1, 1.0))
    memory.request.write(Request(-1, -1, -1, 1.0, Coupling.INTERPOLATE, True))
    loop.figures.write(Figures(1.0, 1.0, -1, -1, -1, -1, True, 1.0, 1.0, 1.0, 1.0, 1.0))
    assert memory.state.read() == ArmState()
    loop.state.write(ArmState(time=9.0, slope_granted=4.0))
    assert loop.model.read().damping == 1.0 and loop.request.read().clutch
    assert memory.figures.read().tell == 1.0
    assert not any(memory.periods) and not any(memory.work)


def test_a_record_is_built_only_when_it_is_new(memory, loop):
    memory.model.write(ForceModel(stress=1.0))
    first = loop.model.read()
    assert loop.model.read() is first
    memory.model.write(ForceModel(stress=1.0))
    assert loop.model.read() is not first


def bytes_of(record, memory):
    """The memory of a record, from its sequence to its payload's end."""
    offset = {"model": protocol._MODEL_AT, "state": protocol._STATE_AT}[record]
    return memory._view[offset : offset + 16 + getattr(protocol, record.upper()).struct.size]


def test_a_record_that_is_being_written_is_not_seen(memory, loop):
    """Its writer was stopped, or killed, half way: the last good one holds, and after TRIES looks nobody waits."""
    good = ForceModel(stress=1.0)
    memory.model.write(good)
    assert loop.model.read() == good
    raw = bytes_of("model", memory)
    sequence = raw[:8].cast("Q")
    sequence[0] += 1
    raw[16:40] = bytes(24)
    looks = []
    loop.model._sequence = Watched(loop.model._sequence, looks.append)
    assert loop.model.read() == good
    assert len(looks) == TRIES and loop.torn == 1
    loop.model._sequence = loop.model._sequence.view
    memory.model.write(ForceModel(stress=2.0))  # a writer that starts anew on what a killed one has left
    assert loop.model.read().stress == 2.0
    for view in (sequence, raw):
        view.release()


class Watched:
    """A view of one number that tells of each look at it."""

    def __init__(self, view, look):
        self.view, self.look = view, look

    def __getitem__(self, index):
        self.look(index)
        return self.view[index]


@pytest.mark.parametrize("byte", [16, 24, 60])
def test_a_torn_payload_is_not_seen(memory, loop, byte):
    """The sequence is even, but some of the payload is of another write: what no memory order of Python's excludes."""
    memory.model.write(ForceModel(stress=1.0))
    good = loop.model.read()
    memory.model.write(ForceModel(stress=2.0, position=(1.0, 1.0, 1.0)))
    raw = bytes_of("model", memory)
    raw[byte] ^= 0x40
    assert loop.model.read() is good and loop.torn == 1
    raw[byte] ^= 0x40
    assert loop.model.read().stress == 2.0
    raw.release()


def test_an_older_payload_under_a_newer_sequence_is_not_seen(memory, loop):
    """The checksum holds the sequence too."""
    memory.model.write(ForceModel(stress=1.0))
    loop.model.read()
    raw = bytes_of("model", memory)
    sequence = raw[:8].cast("Q")
    sequence[0] += 2
    loop.model.read()
    assert loop.torn == 1
    for view in (sequence, raw):
        view.release()


def test_a_number_that_names_no_state_is_not_believed(memory, loop):
    """As a peer gone mad would write it: whole, with the right checksum."""
    loop.state.write(ArmState(tick=1))
    assert memory.state.read().tick == 1
    payload = protocol.STATE.pack(ArmState(tick=2, state=99))
    raw = bytes_of("state", memory)
    sequence, checksum = raw[:8].cast("Q"), raw[8:12].cast("I")
    raw[16:] = payload
    checksum[0] = protocol.zlib.crc32(payload, (sequence[0] + 2) & 0xFFFFFFFF)
    sequence[0] += 2
    assert memory.state.read().tick == 1 and memory.torn == 1
    for view in (sequence, checksum, raw):
        view.release()


WRITER = """
import sys
import threading
from repousse_device.protocol import ForceModel, SharedMemory
def main():
    memory = SharedMemory.attach(sys.stdin.readline().strip())
    told = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), told.set())).start()
    number = 0
    while not told.is_set():
        number += 1
        x = float(number)
        memory.model.write(ForceModel(x, (x, x, x), x, x, (x, x, x), (x, x, x), number, x))
    print(number, flush=True)
    sys.stdin.read()
    memory.close()
"""
ENOUGH, MOST_READS = 100, 2_000_000
"""Records that a reader is to see between its first and its last; how often it looks for them, on a machine where the
writer is mostly in the middle of one."""


@pytest.mark.skipif(sys.platform == "win32", reason="descriptors are handed down on POSIX")
def test_between_two_processes_nothing_is_ever_torn(memory, tmp_path):
    """One writes as fast as it can, the other reads: every record is whole and none is older than the one before."""
    boot = child._BOOT.rpartition("sys.exit")[0] + "exec(module); main()"
    folder = os.path.dirname(child.__file__)
    command = [sys.executable, "-I", "-B", "-c", boot, folder, WRITER]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, pass_fds=(memory.descriptor,)
    )
    try:
        process.stdin.write(f"{memory.descriptor}\n")
        process.stdin.flush()
        last, seen, reads = 0, set(), 0
        while len(seen) <= ENOUGH and reads < MOST_READS:
            model = memory.model.read()
            assert len({*model.position, *model.gradient, *model.normal, model.time, float(model.scene)}) == 1
            assert model.scene >= last
            last, reads = model.scene, reads + 1
            seen.add(last)
        process.stdin.write("\n")
        process.stdin.flush()
        written = int(process.stdout.readline())
        assert memory.model.read().scene == written >= last and len(seen) > ENOUGH
    finally:
        process.stdin.close()
        process.stdout.close()
        assert process.wait() == 0


@pytest.mark.parametrize(
    "header",
    [
        struct.pack("=8sIIQ", b"POUSSERE", protocol.VERSION, protocol.SIZE, 1),
        struct.pack("=8sIIQ", protocol.MAGIC, protocol.VERSION + 1, protocol.SIZE, 1),
        struct.pack("=8sIIQ", protocol.MAGIC, protocol.VERSION, protocol.SIZE + 8, 1),
        struct.pack("=8sIIQ", protocol.MAGIC, protocol.VERSION, protocol.SIZE, 0),
    ],
    ids=["magic", "version", "size", "closed"],
)
def test_another_version_is_refused(memory, header):
    memory._mapping[: len(header)] = header
    with pytest.raises(ProtocolError, match="restart Blender"):
        other_side(memory)


@pytest.mark.skipif(sys.platform == "win32", reason="there it has a name")
@pytest.mark.parametrize("size", [0, 100, protocol.SIZE + 1])
def test_memory_of_another_size_is_refused(tmp_path, size):
    file = tmp_path / "memory"
    file.write_bytes(bytes(size))
    with open(file, "r+b") as opened, pytest.raises(ProtocolError, match="cannot be opened"):
        SharedMemory.attach(str(opened.fileno()))


@pytest.mark.parametrize("address", ["", "nonsense", "-1", "99999"])
@pytest.mark.skipif(sys.platform == "win32", reason="there any name is one")
def test_an_address_that_is_none_is_refused(address):
    with pytest.raises(ProtocolError, match="cannot be opened"):
        SharedMemory.attach(address)


def test_its_end_is_seen(memory, loop):
    assert loop.is_open
    memory.close(last=True)
    assert not loop.is_open
    memory.close(last=True)


@pytest.mark.skipif(sys.platform != "linux", reason="of Linux")
def test_on_linux_it_has_no_name_and_keeps_its_size(memory):
    """So nothing is left in /dev/shm whoever is killed, and no reader can be made to read what is not there."""
    assert "memfd:repousse" in os.readlink(f"/proc/self/fd/{memory.descriptor}")
    assert not [name for name in os.listdir("/dev/shm") if "repousse" in name]
    for size in (0, protocol.SIZE + 1):
        with pytest.raises(PermissionError):
            os.ftruncate(memory.descriptor, size)


def test_closing_gives_the_descriptor_back():
    before = set(os.listdir("/proc/self/fd")) if sys.platform == "linux" else None
    for _ in range(3):
        memory = SharedMemory.create()
        attached = other_side(memory)
        attached.close()
        memory.close(last=True)
    if before is not None:
        assert set(os.listdir("/proc/self/fd")) == before


def test_defaults_are_no_force():
    """What a reader sees before anything was written."""
    assert ForceModel().scene == 0 and ForceModel().stress == 0.0
    assert ArmState().state is State.CLOSED and ArmState().force == (0.0, 0.0, 0.0)
