# SPDX-License-Identifier: GPL-3.0-or-later
"""ServedArm: an emulated arm in a process of its own, which an unmodified hidapi sees as /dev/hidraw<N>."""

import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from repousse.device.profile import DeviceProfile, Link, to_json

from .build import library
from .log import Entry, read_log

SERVER = Path(__file__).with_name("arm_server.py")
PATIENCE = 20.0
"""Seconds that the process may take to answer; a machine that does much else is slow to start Python."""


class ServedArmError(RuntimeError):
    """The arm's process cannot do what it was told; one line."""


class ServedArm:
    """An arm from ``with ServedArm(...)`` to its end, or from :meth:`start` to :meth:`stop`.

    `profile` is of an arm that can be emulated and `link` its controller, by default the profile's first; `hand` "soft"
    or "firm", `script` the path of an intention or None for the built-in one. ``log_states`` records the arm each
    millisecond. With ``fifo`` its process goes before ordinary ones, where the system agrees.
    """

    def __init__(
        self,
        profile: DeviceProfile,
        link: Link | None = None,
        hand: str = "soft",
        script: Path | None = None,
        number: int = 0,
        fifo: bool = True,
        log_states: bool = True,
    ) -> None:
        link = link or profile.links[0]
        self._config = {
            "profile": to_json(replace(profile, links=(link,))),
            "hand": hand,
            "script": None if script is None else str(script),
            "number": number,
            "fifo": fifo,
            "log_states": log_states,
        }
        self.path = f"/dev/hidraw{number}"
        """Of the device, for programs that run in :attr:`environment`."""
        self._folder: Path | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._said = b""

    @property
    def folder(self) -> Path:
        """Where the arm's node is; gone once it is stopped."""
        assert self._folder is not None
        return self._folder

    @property
    def environment(self) -> dict[str, str]:
        """The environment in which a program sees the arm: ours, the preloaded library and the folder."""
        return os.environ | {"LD_PRELOAD": str(library()), "REPOUSSE_FAKEHID": str(self.folder)}

    def start(self) -> None:
        """Start the process and wait until the arm is there. Raises ServedArmError."""
        self._folder = Path(tempfile.mkdtemp(prefix="repousse-arm-"))
        try:
            self._process = subprocess.Popen(
                [sys.executable, str(SERVER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
            )
            self._say(self._config | {"folder": str(self.folder)})
            self._answer()
        except BaseException:
            self.stop()
            raise

    def __enter__(self) -> "ServedArm":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End the process, however it is, and remove its folder. Stopping twice is fine."""
        process, self._process = self._process, None
        if process is not None:
            assert process.stdin is not None and process.stdout is not None
            with suppress(OSError):
                process.stdin.close()
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdout.close()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def kill(self) -> None:
        """End the process at once: a computer that loses its USB controller."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    @property
    def process_id(self) -> int:
        """Of the arm's process."""
        assert self._process is not None
        return self._process.pid

    def order(self, name: str, **values: Any) -> dict[str, Any]:
        """Give an order of arm_server.Server (``do_<name>``) and wait for its answer, which has the ``time`` of it.
        Raises ServedArmError."""
        self._say({"order": name} | values)
        return self._answer()

    def log(self) -> list[Entry]:
        """All that was recorded since the arm started."""
        return list(read_log(Path(self.order("log")["log"])))

    def _say(self, line: dict[str, Any]) -> None:
        assert self._process is not None and self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(line).encode() + b"\n")
            self._process.stdin.flush()
        except OSError as error:
            raise ServedArmError(f"the arm's process has gone: {error}") from error

    def _answer(self) -> dict[str, Any]:
        assert self._process is not None and self._process.stdout is not None
        output, until = self._process.stdout.fileno(), time.monotonic() + PATIENCE
        while b"\n" not in self._said:
            ready, _, _ = select.select([output], [], [], max(0.0, until - time.monotonic()))
            if not ready:
                raise ServedArmError(f"the arm's process said nothing for {PATIENCE:g} s")
            more = os.read(output, 65536)
            if not more:
                raise ServedArmError(f"the arm's process has ended (exit code {self._process.wait()})")
            self._said += more
        line, _, self._said = self._said.partition(b"\n")
        answer = json.loads(line)
        if "error" in answer:
            raise ServedArmError(answer["error"])
        return answer
