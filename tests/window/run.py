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
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from tests.blender.run import ROOT, StepError, installed

MARK = "@window "
"""Begins each line by which drive.py tells what happens; the rest of the line is JSON."""
GRACE = 60.0
"""Seconds that a Blender may say nothing, beyond what a scenario may take: its start, its end, its watchdog."""
WRONG = re.compile(
    r"Traceback \(most recent call last\)|^Exception ignored|property not found|unknown operator|shader.*(error|fail)"
    r"|live view is off",
    re.IGNORECASE,
)
"""What nothing may leave on the console: no panel, handler, thread or shader."""
WINDOW = ("--window-geometry", "0", "0", "900", "600")
"""Small, for a machine without a graphics card draws it too."""
LEAVING = "leaving Blender"
"""Stands for a scenario where Blender fails between two, or at its end."""
TAIL = 40
"""Lines of a console that are shown."""


@dataclass
class Outcome:
    """What became of a scenario on a graphics ``backend``; ``error`` is None when all was well."""

    name: str
    backend: str = ""
    seconds: float = 0.0
    error: str | None = None
    figures: dict[str, float] = field(default_factory=dict)


class Session:
    """A Blender with the extension, started as often as it is needed, in one user folder."""

    def __init__(self, blender: str, folder: Path, environment: dict[str, str]):
        self.blender = blender
        self.folder = folder
        (folder / "temporary").mkdir(exist_ok=True)
        self.environment = environment | {"TMPDIR": str(folder / "temporary")}

    def plan(self) -> list[dict]:
        """All scenarios there are, as drive.py tells them. Raises StepError."""
        with self._started([self.blender, "--background"], []) as watch:
            for _ in watch.outcomes():
                pass
        if not watch.plan:
            raise StepError("\n".join(["the scenarios cannot be loaded", *watch.console[-TAIL:]]))
        return watch.plan

    def play(self, names: list[str], backend: str = "") -> Iterator[Outcome]:
        """Play scenarios in one Blender with a window, or in a new one from where one did not come through."""
        command = [self.blender, *WINDOW, "--enable-event-simulate", *(["--gpu-backend", backend] if backend else [])]
        while names:
            with self._started(command, names, backend) as watch:
                for outcome in watch.outcomes():
                    outcome.backend = backend
                    yield outcome
            if not watch.begun:
                raise StepError("\n".join(["Blender did not come as far as a scenario", *watch.console[-TAIL:]]))
            names = names[watch.begun :]

    @contextmanager
    def _started(self, command: list[str], names: list[str], backend: str = "") -> Iterator[Watch]:
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
            start_new_session=True,  # with a wrapper comes a display, which must end with it
        )
        watch = Watch(process, self.folder / "temporary")
        try:
            yield watch
        finally:
            watch.end()


class Watch:
    """Follows what one Blender tells.

    ``begun``: how many scenarios it has begun; ``plan``: all that there are; ``console``: what it said between them.
    """

    def __init__(self, process: subprocess.Popen, temporary: Path):
        self.begun = 0
        self.plan: list[dict] = []
        self.console: list[str] = []
        self._process = process
        self._temporary = temporary
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def outcomes(self) -> Iterator[Outcome]:
        """The outcome of each scenario when it ends, until Blender does, or says nothing for too long."""
        playing: Outcome | None = None
        leaves, allowed, began = 0, GRACE, time.monotonic()
        said = self.console
        while True:
            try:
                line = self._lines.get(timeout=max(0.0, began + allowed - time.monotonic()))
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
                    self.plan = told["plan"]
                case "begins":
                    playing, said, leaves = Outcome(told["name"]), [], told["leaves"]
                    self.begun += 1
                    began, allowed = time.monotonic(), told["limit"] + GRACE
                case "figures":
                    playing.figures |= told["figures"]
                case "ended":
                    playing.seconds = time.monotonic() - began
                    playing.error = _joined(told["error"], wrong_in(said))
                    yield playing
                    playing, said, leaves = None, self.console, 0
                    began, allowed = time.monotonic(), GRACE
        code = self.end()
        if playing is None and (self.begun == 0 or code == 0):
            return
        playing = playing or Outcome(LEAVING)
        playing.seconds = time.monotonic() - began
        ended = [f"Blender ended with exit code {code}", *said[-TAIL:], *self._last_words()]
        playing.error = _joined(None if code == leaves else "\n".join(ended), wrong_in(said))
        yield playing

    def end(self) -> int:
        """The exit code, as a shell has it, of a Blender that has closed its output; one that has not is ended."""
        try:
            code = self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            if hasattr(os, "killpg"):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.kill()
            code = self._process.wait()
        self._reader.join()
        self._process.stdout.close()
        return code if code >= 0 else 128 - code

    def _last_words(self) -> list[str]:
        """What Blender writes when it crashes: its own stack and Python's."""
        lines = []
        for path in self._temporary.glob("*.crash.txt"):
            lines += path.read_text(encoding="utf-8", errors="replace").splitlines()
            path.unlink()
        return lines

    def _read(self) -> None:
        for line in self._process.stdout:
            self._lines.put(line.rstrip("\n"))
        self._lines.put(None)


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
    with ThreadPoolExecutor(1) as beside:  # the lone ones mostly wait
        lone = beside.submit(lambda: [*chain.from_iterable(session.play([e["name"]]) for e in plan if e["alone"])])
        yield from session.play([entry["name"] for entry in plan if not entry["alone"]])
        yield from session.play([entry["name"] for entry in plan if entry["vulkan"]], "vulkan")
        yield from lone.result()


def played_twice(session: Session, outcomes: Iterator[Outcome]) -> Iterator[Outcome]:
    """The outcomes; then each scenario that failed once more, in a Blender of its own."""
    failed = []
    for outcome in outcomes:
        if outcome.error:
            failed.append(outcome)
        yield outcome
    for outcome in failed:
        if outcome.name != LEAVING:
            yield from session.play([outcome.name], outcome.backend)


def main() -> int:
    """0 when every scenario passed; 1 with one line on stderr when it does not come to playing."""
    blender, wanted = sys.argv[1], sys.argv[2:] or ["*"]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that Blender is ended as well
    last: dict[tuple[str, str], bool] = {}  # whether each has passed, when it was last played
    try:
        with installed(blender) as (folder, environment):
            session = Session(blender, folder, environment)
            for outcome in played_twice(session, play_all(session, wanted)):
                scenario = outcome.name, outcome.backend
                word, again = "FAILED" if outcome.error else "ok", " (again)" if scenario in last else ""
                backend = f" ({outcome.backend.capitalize()})" if outcome.backend else ""
                print(f"{word:6}  {outcome.seconds:5.1f} s  {outcome.name}{backend}{again}", flush=True)
                if outcome.error:
                    print(textwrap.indent(outcome.error.rstrip(), "        "), flush=True)
                last[scenario] = outcome.error is None
    except StepError as error:
        print(f"run.py: {error}", file=sys.stderr)
        return 1
    passed = sum(last.values())
    print(f"{passed} passed, {len(last) - passed} failed; pictures are in out/window")
    return int(passed < len(last))


if __name__ == "__main__":
    sys.exit(main())
