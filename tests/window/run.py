# SPDX-License-Identifier: GPL-3.0-or-later
"""Play the scenarios in a Blender with a window: `python -m tests.window.run BLENDER [NAME ...]`, names as in a shell.

The extension is built and installed as a user gets it. One Blender plays all scenarios that can share it; each that is
to be alone has one of its own. After a crash or a hang, a new Blender plays the rest.
"""

from __future__ import annotations

import fnmatch
import json
import os
import queue
import re
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.blender.run import ROOT, StepError, installed

MARK = "@window "
"""Begins each line by which drive.py tells what happens; the rest of the line is JSON."""
GRACE = 60.0
"""Seconds that a Blender may say nothing, beyond what a scenario may take: its start, its end, its watchdog."""
WRONG = re.compile(
    r"Traceback \(most recent call last\)|^Exception ignored|property not found|unknown operator|shader.*(error|fail)",
    re.IGNORECASE,
)
"""What nothing may leave on the console: no panel, handler, thread or shader."""
WINDOW = ("--window-geometry", "0", "0", "900", "600")
"""Small, for a machine without a graphics card draws it too."""
TAIL = 40
"""Lines of a console that are shown."""


@dataclass
class Outcome:
    """What became of a scenario; ``error`` is None when all was well."""

    name: str
    seconds: float = 0.0
    error: str | None = None
    figures: dict[str, float] = field(default_factory=dict)


@dataclass
class Seen:
    """What one Blender did: how many scenarios it began, the outcomes, all scenarios there are, what else it said."""

    begun: int = 0
    outcomes: list[Outcome] = field(default_factory=list)
    plan: list[dict] = field(default_factory=list)
    console: list[str] = field(default_factory=list)


class Session:
    """A Blender with the extension, started as often as it is needed, in one user folder."""

    def __init__(self, blender: str, folder: Path, environment: dict[str, str]):
        self.blender = blender
        self.folder = folder
        (folder / "temporary").mkdir(exist_ok=True)
        self.environment = environment | {"TMPDIR": str(folder / "temporary")}

    def plan(self) -> list[dict]:
        """All scenarios there are, as drive.py tells them. Raises StepError."""
        seen = self._run([self.blender, "--background"], [])
        if not seen.plan:
            raise StepError("\n".join(["the scenarios cannot be loaded", *seen.console[-TAIL:]]))
        return seen.plan

    def play(self, names: list[str], backend: str = "") -> Iterator[Outcome]:
        """Play scenarios in one Blender with a window, or in a new one from where one did not come through."""
        command = [self.blender, *WINDOW, "--enable-event-simulate", *(["--gpu-backend", backend] if backend else [])]
        while names:
            seen = self._run(command, names, backend)
            if not seen.outcomes:
                raise StepError("\n".join(["Blender did not come as far as a scenario", *seen.console[-TAIL:]]))
            names = names[seen.begun :]
            yield from seen.outcomes

    def _run(self, command: list[str], names: list[str], backend: str = "") -> Seen:
        told = {"names": names, "folder": str(self.folder), "backend": backend}
        drive = str(Path(__file__).with_name("drive.py"))
        process = subprocess.Popen(
            [*command, "--python-exit-code", "1", "--python", drive, "--", json.dumps(told)],
            cwd=ROOT,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,  # a wrapper's display ends with it
        )
        lines: queue.Queue[str | None] = queue.Queue()
        reader = threading.Thread(target=_read, args=(process, lines))
        reader.start()
        try:
            return _watch(process, lines)
        finally:
            _end(process)
            reader.join()


def _read(process: subprocess.Popen, lines: queue.Queue) -> None:
    for line in process.stdout:
        lines.put(line.rstrip("\n"))
    lines.put(None)


def _end(process: subprocess.Popen) -> int:
    """The exit code, as a shell has it, of a Blender that has closed its output; one that has not is ended."""
    try:
        code = process.wait(timeout=5.0)
    except subprocess.TimeoutExpired:
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        code = process.wait()
    return code if code >= 0 else 128 - code


def _watch(process: subprocess.Popen, lines: queue.Queue) -> Seen:
    """Follow what a Blender tells until it ends, or says nothing for too long."""
    seen = Seen()
    playing: Outcome | None = None
    leaves, allowed, began = 0, GRACE, time.monotonic()
    said = seen.console
    while True:
        try:
            line = lines.get(timeout=max(0.0, began + allowed - time.monotonic()))
        except queue.Empty:
            said.append(f"(Blender did nothing for {allowed:.0f} s and was ended)")
            break
        if line is None:
            break
        if not line.startswith(MARK):
            said.append(line)
            continue
        told = json.loads(line.removeprefix(MARK))
        match told["what"]:
            case "plan":
                seen.plan = told["plan"]
            case "begins":
                playing = Outcome(told["name"])
                seen.outcomes.append(playing)
                seen.begun += 1
                said, leaves = [], told["leaves"]
                began, allowed = time.monotonic(), told["limit"] + GRACE
            case "figures":
                seen.outcomes[-1].figures |= told["figures"]
            case "ended":
                playing.seconds = time.monotonic() - began
                playing.error = _joined(told["error"], wrong_in(said))
                playing, said, leaves = None, seen.console, 0
                began, allowed = time.monotonic(), GRACE
    code = _end(process)
    if playing is None and code and seen.outcomes:
        playing = Outcome("leaving Blender")
        seen.outcomes.append(playing)
    if playing is not None:
        playing.seconds = time.monotonic() - began
        ended = None if code == leaves else "\n".join([f"Blender ended with exit code {code}", *said[-TAIL:]])
        playing.error = _joined(ended, wrong_in(said))
    return seen


def wrong_in(console: list[str]) -> str | None:
    """What must not have been said, with what came after it; None when all was well."""
    for number, line in enumerate(console):
        if WRONG.search(line):
            return "\n".join(["on the console:", *console[number : number + TAIL]])
    return None


def _joined(*errors: str | None) -> str | None:
    return "\n".join(error for error in errors if error) or None


def play_all(session: Session, wanted: list[str], kind: str = "test") -> Iterator[Outcome]:
    """Play the scenarios of a kind whose names match: those that share a Blender, some on Vulkan too, the lone ones."""
    plan = [
        entry
        for entry in session.plan()
        if entry["kind"] == kind and any(fnmatch.fnmatch(entry["name"], pattern) for pattern in wanted)
    ]
    if not plan:
        raise StepError(f"there is no scenario {' or '.join(wanted)}")
    yield from session.play([entry["name"] for entry in plan if not entry["alone"]])
    for outcome in session.play([entry["name"] for entry in plan if entry["vulkan"]], "vulkan"):
        outcome.name += " (Vulkan)"
        yield outcome
    for entry in plan:
        if entry["alone"]:
            yield from session.play([entry["name"]])


def main() -> int:
    """0 when every scenario passed; 1 with one line on stderr when it does not come to playing."""
    blender, wanted = sys.argv[1], sys.argv[2:] or ["*"]
    failed = passed = 0
    try:
        with installed(blender) as (folder, environment):
            for outcome in play_all(Session(blender, folder, environment), wanted):
                word = "FAILED" if outcome.error else "ok"
                print(f"{word:6}  {outcome.seconds:5.1f} s  {outcome.name}", flush=True)
                if outcome.error:
                    print(textwrap.indent(outcome.error.rstrip(), "        "), flush=True)
                failed, passed = failed + bool(outcome.error), passed + (not outcome.error)
    except StepError as error:
        print(f"run.py: {error}", file=sys.stderr)
        return 1
    print(f"{passed} passed, {failed} failed; pictures are in out/window")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
