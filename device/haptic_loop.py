# SPDX-License-Identifier: GPL-3.0-or-later
"""HapticLoop: the arm as Blender has it. Owns the subprocess that drives it, and the memory that they share."""

from __future__ import annotations

import json
import subprocess
import threading
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from . import child
from .hid_bus import EMULATED
from .measure import percentiles
from .profile import DeviceProfile, Link, to_json
from .protocol import (
    PERIOD_BIN,
    WORK_BIN,
    ArmState,
    Coupling,
    Figures,
    ForceModel,
    Request,
    SharedMemory,
)

PATIENCE = 1.0
"""Seconds that the subprocess has to write its zeros and end, once it was told to."""


@dataclass(frozen=True)
class LoopHealth:
    """How the loop fares: its ``figures``, and percentiles (seconds) of its ``period`` and of what it computes in one
    (``work``): p50, p99 and p99.9 since it began."""

    figures: Figures
    period: tuple[float, float, float]
    work: tuple[float, float, float]


class HapticLoop:
    """One arm, driven by a subprocess from :meth:`start` to :meth:`stop`.

    Parameters
    ----------
    profile, link
        What the arm is, and how it is attached; by default the profile's first link.
    path
        hidapi's path of the device, or ``"emulated"``: the arm in software, within the subprocess.
    script
        Path of the emulated hand's intention; None is the built-in one.
    environment
        Of the subprocess; None is our own.

    Nothing here waits for the arm. :meth:`send` may be called by one thread, the rest by another one; any may read.
    """

    def __init__(
        self,
        profile: DeviceProfile,
        link: Link | None = None,
        path: str = EMULATED,
        script: str | None = None,
        environment: dict[str, str] | None = None,
    ) -> None:
        self.profile, self.link, self.path = profile, link or profile.links[0], path
        self._script, self._environment = script, environment
        self._memory: SharedMemory | None = None
        self._process: subprocess.Popen[str] | None = None
        self._watcher: threading.Thread | None = None
        self._request = Request()
        self._ended: str | None = None
        self._stopping = False
        self._last = ArmState()
        self._last_health = LoopHealth(Figures(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def start(self) -> None:
        """Start the subprocess; what becomes of it is seen by :attr:`running` and :attr:`failure`.

        Raises RuntimeError with one line where it cannot even be started.
        """
        if self._process is not None:
            raise RuntimeError("This arm is driven already")
        hidapi = child.find_hidapi()
        if hidapi is None and self.path != EMULATED:
            raise RuntimeError("The hidapi module is missing: reinstall the extension, its wheels come with it")
        self._ended, self._stopping, self._request = None, False, Request()
        self._memory = SharedMemory.create()
        config = {
            "address": self._memory.address,
            "profile": to_json(self.profile),
            "link": self.link.name,
            "path": self.path,
            "hidapi": hidapi,
            "script": self._script,
        }
        handed = () if self._memory.descriptor is None else (self._memory.descriptor,)
        try:
            self._process = child.start("loop", config, pass_fds=handed, env=self._environment)
        except OSError as error:
            self._memory.close(last=True)
            raise RuntimeError(f"The arm's loop cannot be started: {error}") from error
        self._watcher = threading.Thread(target=self._watch, args=(self._process,), name="repousse arm", daemon=True)
        self._watcher.start()

    def _watch(self, process: subprocess.Popen[str]) -> None:
        """The watcher thread: waits for the subprocess to end, so that it is never left as a zombie."""
        assert process.stdout is not None and process.stderr is not None
        said, complained = process.stdout.read(), process.stderr.read()
        code = process.wait()
        self._ended = _reason(said, complained, code)

    def __enter__(self) -> HapticLoop:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def running(self) -> bool:
        """Whether the subprocess is there."""
        return self._process is not None and self._ended is None

    @property
    def failure(self) -> str:
        """Why the loop ended, in one line; empty while it runs, and when it ended because it was told to."""
        return "" if self._ended is None or self._stopping else self._ended

    @property
    def process_id(self) -> int | None:
        """Of the subprocess."""
        return None if self._process is None else self._process.pid

    def state(self) -> ArmState:
        """The arm at the newest period that can be seen; what was last seen once it is stopped."""
        if self._memory is not None:
            self._last = self._memory.state.read()
        return self._last

    def send(self, model: ForceModel | None) -> None:
        """What the loop is to render from now on; None: nothing is there to be felt."""
        if self._memory is not None:
            self._memory.model.write(model or ForceModel())

    def home(self) -> None:
        """Order: the arm is in its home pose now."""
        self._order(home=self._request.home + 1)

    def arm(self) -> None:
        """Order: render forces, once they are small enough to begin."""
        self._order(arm=self._request.arm + 1)

    def disarm(self) -> None:
        """Order: no force any more; the arm stays homed."""
        self._order(disarm=self._request.disarm + 1)

    def set_force_scale(self, scale: float) -> None:
        """How much of the force is rendered, from 0 to 1. Raises ValueError."""
        if not 0.0 <= scale <= 1.0:
            raise ValueError(f"a force scale is from 0 to 1, not {scale}")
        self._order(force_scale=scale)

    def set_coupling(self, coupling: Coupling) -> None:
        """How models become forces."""
        self._order(coupling=coupling)

    def set_clutch(self, held: bool) -> None:
        """Whether the arm is being repositioned: no force meanwhile."""
        self._order(clutch=held)

    def _order(self, **changes: Any) -> None:
        self._request = self._request._replace(**changes)
        if self._memory is not None:
            self._memory.request.write(self._request)

    def health(self) -> LoopHealth:
        """How the loop fares."""
        memory, shares = self._memory, (0.5, 0.99, 0.999)
        if memory is not None:
            period = percentiles(memory.periods, PERIOD_BIN, shares)
            work = percentiles(memory.work, WORK_BIN, shares)
            self._last_health = LoopHealth(memory.figures.read(), period, work)  # type: ignore[arg-type]
        return self._last_health

    def stop(self) -> None:
        """End the subprocess, which writes zeros first. Stopping twice is fine."""
        process, memory = self._process, self._memory
        if process is None or memory is None:
            return
        self._stopping = self._ended is None
        if process.stdin is not None:
            with suppress(OSError):
                process.stdin.close()
        assert self._watcher is not None
        self._watcher.join(PATIENCE)
        if self._watcher.is_alive():
            process.kill()
            self._watcher.join()
        self.state()
        self.health()
        self._process = self._memory = self._watcher = None
        for pipe in (process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()
        memory.close(last=True)


def _reason(said: str, complained: str, code: int) -> str:
    """Why a subprocess ended, from its last words."""
    for line in reversed(said.splitlines()):
        try:
            return str(json.loads(line)["ended"])
        except (ValueError, KeyError, TypeError):
            continue
    if complained.strip():
        return f"The arm's loop failed: {complained.strip().splitlines()[-1]}"
    return f"The arm's loop was ended from outside (exit code {code}); the arm's own watchdog stops its motors"
