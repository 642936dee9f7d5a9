# SPDX-License-Identifier: GPL-3.0-or-later
"""The loop: a thousand times a second from the arm's encoders to its motors, in a process of its own (DESIGN 4).

A period is: read the newest report, find the pose, feel the local model there, limit the force, turn it into motor
currents, write them. Whatever goes wrong ends with zeros: a fault makes the state SAFE, and every way out of
:func:`driving` writes zeros before it lets go of the arm.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from . import kinematics, reports, safety
from .child import load_hidapi, read_config
from .force import felt_force, surface_known
from .hid_bus import EMULATED, OpenError, UnpluggedError, Wire
from .lock import InUseError, held
from .measure import Parts, count
from .pace import Pace, first_in_line
from .profile import DeviceProfile, Link, ProfileError, from_json
from .protocol import (
    PERIOD_BIN,
    WORK_BIN,
    ArmState,
    Coupling,
    Figures,
    ForceModel,
    ProtocolError,
    Request,
    SharedMemory,
    Triple,
)
from .safety import Fault, State, fault_text

PERIOD = 1e-3
"""Seconds."""
KICK = 0.01
"""Seconds of silence after which a zero report is sent: some firmware says nothing before it is spoken to."""
VELOCITY_WINDOW = 0.015
"""Seconds over which a velocity is the difference of positions, as CHAI3D does: one encoder step in a single period
would be 25 mm/s."""
HOMING_TIME = 0.2
"""Seconds in which an arm that was told its home counts has to report them."""
HOMING_TOLERANCE = 50.0
"""Counts by which the hand may have moved the arm meanwhile: about a millimetre."""
FAREWELLS = 3
"""How often zeros are written at the end, for one may be lost."""
TELL = 1.0
"""Seconds from one set of figures to the next."""
_PARTS = ("read", "pose", "force", "write", "tell")
_DRIVEN = (State.ARMED, State.RUN, State.SAFE)
_ZERO: Triple = (0.0, 0.0, 0.0)


class Loop:
    """One arm, driven from :meth:`run` until that returns.

    ``stopped`` says when to end; ``realtime`` is only told on.
    """

    def __init__(
        self,
        profile: DeviceProfile,
        link: Link,
        wire: Wire,
        memory: SharedMemory,
        stopped: Callable[[], bool],
        realtime: bool,
    ) -> None:
        self._profile, self._link, self._wire, self._memory = profile, link, wire, memory
        self._stopped, self._realtime = stopped, realtime
        self._clock = time.perf_counter
        self._limits = safety.limits_of(profile, link)
        self._request = memory.request.read()
        self._model = self._former_model = self._surface = memory.model.read()
        self._taken = 0.0  # when the model came
        self._totals: reports.Counts | None = None  # unwrapped
        self._offset: reports.Counts = (0, 0, 0)  # what homing adds to them, where the firmware cannot
        self._counts: Triple = _ZERO
        self._angles = self._position = self._velocity = _ZERO
        self._path: deque[tuple[float, Triple]] = deque()
        self._buttons = 0
        self._given = _ZERO  # the currents that were written last
        self._homing_until = 0.0
        self._number: int | None = None  # of the last report, and how many were passed over until then
        self._passed_over = 0
        self._lost = 0
        self._tick = 0
        self._longest = 0.0
        self._parts = Parts(_PARTS)

    def run(self) -> str:
        """Drive the arm until it is told to stop, or cannot go on; returns why in one line, "" when it was told to."""
        pace, now = Pace(PERIOD), self._clock()
        self.begin(now)
        while not self._stopped():
            if not self._memory.is_open:
                return fault_text(Fault.MEMORY_GONE)
            former, now = now, pace.wait()
            try:
                self.period(now, now - former)
            except UnpluggedError:
                self._fail(Fault.UNPLUGGED)
                return fault_text(Fault.UNPLUGGED)
        return ""

    def begin(self, now: float) -> None:
        """The arm was opened just now."""
        self._status = safety.opened(now)
        self._reported = self._kicked = self._told = now
        self._told_tick = self._tick

    def period(self, now: float, dt: float) -> None:
        """From the newest report to the currents that answer it, ``dt`` seconds after the last time.

        Raises UnpluggedError.
        """
        self._tick += 1
        self._longest = max(self._longest, dt)
        count(self._memory.periods, PERIOD_BIN, dt)
        began = self._clock()
        data = self._wire.newest()
        request, model = self._memory.request.read(), self._memory.model.read()
        read = self._clock()
        self._obey(request, now)
        fresh = data is not None and self._take(data, now)
        self._status = safety.sensed(
            self._status, self._limits, now, self._reported, self._counts, self._angles, self._velocity
        )
        posed = self._clock()
        currents = self._answer(model, now, dt)
        forced = self._clock()
        self._write(currents, now, fresh)
        written = self._clock()
        self._tell(now, currents)
        told = self._clock()
        self._parts.add((began, read, posed, forced, written, told))
        count(self._memory.work, WORK_BIN, forced - read)

    def _obey(self, request: Request, now: float) -> None:
        """Orders are counted: one that was given twice before it was seen is one."""
        former, self._request = self._request, request
        if request is former:
            return
        if request.force_scale != former.force_scale:
            self._limits = safety.limits_of(self._profile, self._link, request.force_scale)
        if request.disarm != former.disarm:
            self._status = safety.disarmed(self._status)
        if request.home != former.home:
            self._home(now)
        if request.arm != former.arm:
            self._status = safety.armed(self._status)

    def _home(self, now: float) -> None:
        """Take the present pose for the home pose."""
        if self._totals is None:
            return
        order = reports.encode_home(self._link, self._profile.home_counts)
        if order is None:  # the firmware keeps its own counts, so ours are shifted
            (a, b, c), (i, j, k) = self._profile.home_counts, self._totals
            self._offset = a - i, b - j, c - k
            self._pose(now, at_rest=True)
            self._status = safety.homed(self._status, self._limits, self._counts, self._angles, now)
            return
        self._status = safety.disarmed(self._status)
        if not self._wire.write(order):
            self._fail(Fault.WRITE_FAILED)
        self._homing_until = now + HOMING_TIME

    def _take(self, data: list[int], now: float) -> bool:
        """A report: where the arm is. False when it is not one of this arm's."""
        try:
            report = reports.decode(self._link, data)
        except ValueError:
            self._fail(Fault.WRONG_REPORT)
            return False
        if report.counter is not None:
            self._count_lost(report.counter)
        self._reported = now
        homing = self._homing_until > 0.0
        if self._totals is None or homing:
            self._totals = report.counts
        else:
            (a, b, c), (i, j, k) = self._totals, report.counts
            self._totals = reports.unwrap(a, i), reports.unwrap(b, j), reports.unwrap(c, k)
        self._buttons = int(report.button)
        self._pose(now, at_rest=homing)
        if homing:
            self._see_home(now)
        elif report.calibrate and self._status.state is State.OPEN:
            self._home(now)  # the button on the arm itself
        return True

    def _see_home(self, now: float) -> None:
        """Whether the arm now reports the counts that it was told are home."""
        if all(abs(c - h) <= HOMING_TOLERANCE for c, h in zip(self._counts, self._profile.home_counts, strict=True)):
            self._homing_until = 0.0
            self._status = safety.homed(self._status, self._limits, self._counts, self._angles, now)
        elif now > self._homing_until:
            self._homing_until = 0.0
            self._fail(Fault.NOT_HOMED)

    def _pose(self, now: float, at_rest: bool = False) -> None:
        """Counts, angles, position and velocity of the tip from the unwrapped counts."""
        assert self._totals is not None
        (a, b, c), (i, j, k) = self._totals, self._offset
        self._counts = a + i, b + j, c + k
        self._angles = kinematics.joint_angles(self._profile, self._counts)
        self._position = position = kinematics.position(self._profile, self._angles)
        path = self._path
        if at_rest:
            path.clear()
        path.append((now, position))
        while len(path) > 2 and path[1][0] <= now - VELOCITY_WINDOW:
            path.popleft()
        then, (x, y, z) = path[0]
        way = now - then
        if way > 0.0:
            self._velocity = ((position[0] - x) / way, (position[1] - y) / way, (position[2] - z) / way)
        else:
            self._velocity = _ZERO

    def _count_lost(self, number: int) -> None:
        """Reports that are missing by the arm's own 16-bit count, and were not merely passed over for a newer one."""
        superseded = self._wire.superseded
        if self._number is not None:
            self._lost += ((number - self._number - 1) & 0xFFFF) - (superseded - self._passed_over)
        self._number, self._passed_over = number, superseded

    def _answer(self, model: ForceModel, now: float, dt: float) -> Triple:
        """The motor currents that render the local model here, within every limit."""
        if model is not self._model:
            self._former_model, self._model, self._taken = self._model, model, now
            self._surface = surface_known(model, self._surface)
        local = self._request.coupling is Coupling.LOCAL
        felt = felt_force(
            None if self._request.clutch else self._surface if local else model,
            self._former_model,
            self._position,
            self._velocity,
            now,
            self._limits,
            self._request.coupling,
            self._taken,
        )
        self._felt = felt
        if felt.fault:
            self._fail(felt.fault)
        scene = 0 if self._request.clutch else model.scene
        self._status = safety.rendered(
            self._status, self._limits, now, dt, model.time, scene, felt.force, felt.magnitude
        )
        currents = kinematics.currents(self._profile, self._angles, self._status.force)
        self._status, currents = safety.limited_currents(self._status, self._limits, currents, dt)
        return currents

    def _write(self, currents: Triple, now: float, fresh: bool) -> None:
        """Send the currents. An arm in lock step is answered report by report, and one that has not been armed is left
        alone, once its motors are at zero: any report switches its amplifiers on."""
        silent = now - max(self._reported, self._kicked) >= KICK
        if silent:
            self._kicked = now
        driven = self._status.state in _DRIVEN or self._given != _ZERO
        if not (silent or (fresh if self._link.lock_step else driven)):
            return
        try:
            report = reports.encode_currents(self._link, currents)
        except ValueError:  # beyond what the firmware takes, which no limit before should have let through
            self._fail(Fault.NOT_FINITE)
            currents = _ZERO
            report = reports.encode_currents(self._link, currents)
        if self._wire.write(report):
            self._given = currents
        else:
            self._fail(Fault.WRITE_FAILED)

    def _fail(self, fault: Fault) -> None:
        self._status = safety.failed(self._status, fault)

    def _tell(self, now: float, currents: Triple) -> None:
        """What Blender sees of this period."""
        status, felt = self._status, self._felt
        self._memory.state.write(
            ArmState(
                now,
                self._tick,
                status.state,
                status.fault,
                self._position,
                self._velocity,
                status.force,
                self._angles,
                self._counts,
                currents,
                self._buttons,
                status.ramp,
                safety.warmth(status, self._limits),
                status.waiting,
                now - self._model.time,
                now - self._reported,
                felt.asked,
                felt.granted,
            )
        )
        if now - self._told >= TELL:
            self._memory.figures.write(self.figures(now))
            self._told, self._told_tick = now, self._tick

    def figures(self, now: float) -> Figures:
        """How the loop fared since the last figures."""
        return Figures(
            rate=(self._tick - self._told_tick) / max(now - self._told, PERIOD),
            longest=self._longest,
            ticks=self._tick,
            lost=self._lost,
            superseded=self._wire.superseded,
            torn=self._memory.torn,
            realtime=self._realtime,
            **self._parts.take(),
        )

    def farewell(self) -> None:
        """Zeros, and the last that Blender sees."""
        for _ in range(FAREWELLS):
            self._wire.write(reports.encode_currents(self._link, _ZERO))
        if self._memory.is_open:
            state, fault = State.CLOSED, self._status.fault
            self._memory.state.write(ArmState(self._clock(), self._tick, state, fault, self._position))


@contextmanager
def driving(loop: Loop, wire: Wire) -> Iterator[None]:
    """However this is left, the motors are at zero and the arm is let go."""
    try:
        yield
    finally:
        try:
            loop.farewell()
        finally:
            wire.close()


def drive(config: dict[str, Any], stopped: Callable[[], bool]) -> str:
    """Drive the arm of a configuration (that of HapticLoop) until it is over; returns why, "" when told to stop.

    Raises ProfileError, ProtocolError, InUseError, OpenError, ImportError or ValueError with one line where it cannot
    begin.
    """
    profile = from_json(config["profile"])
    link = next((link for link in profile.links if link.name == config["link"]), None)
    if link is None or not profile.driven:
        raise ProfileError(f"{profile.name}: has no link {config['link']} that could be driven")
    memory = SharedMemory.attach(config["address"])
    try:
        # An arm in software is within this process: there may be as many as there are sessions.
        alone = nullcontext() if config["path"] == EMULATED else held(config["path"])
        with alone, first_in_line() as realtime:
            wire = Wire.open(_hid(config, profile, link), config["path"], link)
            loop = Loop(profile, link, wire, memory, stopped, realtime)
            with driving(loop, wire):
                return loop.run()
    finally:
        memory.close()


def _hid(config: dict[str, Any], profile: DeviceProfile, link: Link) -> Any:
    """hidapi, or what has its calls and an arm in software behind them."""
    if config["path"] != EMULATED:
        return load_hidapi(*config["hidapi"])
    from .emulated import EmulatedHid, Hand, load_intention

    intention = load_intention(Path(config["script"])) if config.get("script") else None
    return EmulatedHid(profile, link, Hand.soft(intention))


def main() -> int:
    """The subprocess: its configuration comes as the first line of stdin, whose end means that Blender is gone. What it
    has to say goes to stdout as a line of JSON: why it ended."""
    over = threading.Event()
    for name in ("SIGTERM", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda *_: over.set())
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to Blender as well, whose end ends this
    try:
        config = read_config()
        threading.Thread(target=_wait_for_the_end, args=(over,), daemon=True).start()
        ended = drive(config, over.is_set)
    except (ProtocolError, InUseError, OpenError, ImportError, OSError) as error:
        ended = str(error)
    except (ValueError, KeyError, TypeError) as error:  # a ProfileError among them
        ended = f"The arm's loop was not told what to drive: {error}"
    print(json.dumps({"ended": ended}), flush=True)
    return 1 if ended else 0


def _wait_for_the_end(over: threading.Event) -> None:
    while os.read(sys.stdin.fileno(), 4096):
        pass
    over.set()
