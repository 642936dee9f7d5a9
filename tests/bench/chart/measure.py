# SPDX-License-Identifier: GPL-3.0-or-later
"""One method in one scene, alone in a process of its own: what it left, what it felt, how long it took, what it held.

`measure` is the side of the chart; run as a module this is the side of the process, which takes a request as JSON, a
scene as an .npz, and leaves another. So neither a compiler's warmth, nor memory, nor a crash of one method reaches
another's figures.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path

import numpy as np

from .method import Method, Scene

ROOT = Path(__file__).resolve().parents[3]
REPEATED = 0.6
"""Seconds for which a press is done again and again from the start: a fast method gets enough steps for a p99."""
START_UP = 120.0
"""Seconds beyond its budget after which a process is ended: start-up, compilers, writing."""
ALONE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Request:
    """Method ``name`` in ``setting``, of ``module`` (of the folder methods).

    ``budget`` is in seconds of stepping, ``repeated`` in seconds of doing the press again.
    """

    module: str
    name: str
    setting: str
    budget: float = 30.0
    repeated: float = REPEATED


@dataclass(frozen=True)
class Outcome:
    """What came of a request.

    ``failure`` is empty, or says in a line why there is no result: then the arrays hold what there is. ``force`` (n,)
    after each step of the first press, ``density`` (nx, ny, nz) after its last; ``ms`` (m,) milliseconds of every step
    of all presses; ``start_up`` milliseconds until the first step could begin, with its own imports; ``mb`` the most
    memory that the process held, in MB over what it held with the scene loaded, without the method.
    """

    failure: str = ""
    force: np.ndarray = field(default_factory=lambda: np.zeros(0))
    density: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 0), np.float32))
    ms: np.ndarray = field(default_factory=lambda: np.zeros(0))
    start_up: float = np.nan
    mb: float = np.nan

    @property
    def p50(self) -> float:
        return float(np.percentile(self.ms, 50)) if len(self.ms) else np.nan

    @property
    def press(self) -> float:
        """Milliseconds of all steps of a press, the quickest of those that were made: they do the same work."""
        return float(self.ms.reshape(-1, len(self.force)).sum(axis=1).min()) if len(self.force) else np.nan

    @property
    def p99(self) -> float:
        return float(np.percentile(self.ms, 99)) if len(self.ms) else np.nan


def measure(request: Request, scene: Scene) -> Outcome:
    """Run a request in a scene to its end, or to the end of its time."""
    with tempfile.TemporaryDirectory(prefix="repousse-chart-") as folder:
        result = Path(folder) / "outcome.npz"
        np.savez(
            Path(folder) / "scene.npz", **{name: value for name, value in vars(scene).items() if value is not None}
        )
        command = [sys.executable, "-m", __spec__.name, json.dumps(asdict(request)), folder]
        try:
            done = subprocess.run(
                command,
                cwd=ROOT,
                env={**os.environ, **ALONE},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                timeout=request.budget + START_UP,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return Outcome(failure=f"ended after {request.budget + START_UP:g} s")
        if not result.is_file():
            said = done.stderr.decode(errors="replace").strip().splitlines()
            return Outcome(failure=f"died ({done.returncode}): {said[-1] if said else 'without a word'}")
        with np.load(result) as kept:
            values = {name: kept[name] for name in kept.files}
        return Outcome(
            str(values["failure"]),
            values["force"],
            values["density"],
            values["ms"],
            float(values["start_up"]),
            float(values["mb"]),
        )


def find(module: str, name: str, setting: str) -> Method:
    """A method by its name."""
    offered = import_module(f"{__package__}.methods.{module}").METHODS
    return next(method for method in offered if (method.name, method.setting) == (name, setting))


def press(method: Method, scene: Scene, budget: float) -> tuple[float, list[float], list[float], np.ndarray, str]:
    """One press: seconds of start-up, milliseconds and force of each step, the density after it, and why it ended."""
    began = time.perf_counter()
    solver = method.start(scene)
    start_up = time.perf_counter() - began
    ms: list[float] = []
    forces: list[float] = []
    failure, spent = "", 0.0
    for position in scene.path:
        if spent > budget:
            failure = f"stopped after {budget:g} s, at step {len(ms)} of {len(scene.path)}"
            break
        at = (float(position[0]), float(position[1]), float(position[2]))
        began = time.perf_counter()
        try:
            felt = solver.move_to(at)
        except (ValueError, RuntimeError, ArithmeticError, MemoryError) as error:
            failure = f"step {len(ms) + 1}: {error}"
            break
        taken = time.perf_counter() - began
        spent += taken
        ms.append(1000.0 * taken)
        forces.append(float(felt))
    if hasattr(solver, "milliseconds_a_step"):  # not each of its steps is a solve
        ms = [solver.milliseconds_a_step] * len(ms)
    return start_up, ms, forces, np.array(solver.density, np.float32), failure


def _memory() -> tuple[float, float]:
    """MB that this process holds now, and the most it held since `_forget_peak`."""
    status = Path("/proc/self/status")
    if not status.is_file():
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)
        return peak, peak
    lines = dict(line.split(":", 1) for line in status.read_text(encoding="ascii").splitlines() if ":" in line)
    now, most = (float(lines[name].split()[0]) / 1024.0 for name in ("VmRSS", "VmHWM"))
    return now, most


def _forget_peak() -> None:
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:  # not Linux, or not allowed: the peak then includes the making of the scene
        return


def _pin() -> None:
    """To one processor, the last: what else the machine does is mostly on the others."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def _read_scene(path: Path) -> Scene:
    with np.load(path) as kept:
        x, y, z = kept["direction"].tolist()
        band = float(kept["band"]) if "band" in kept.files else None
        radius, kappa = float(kept["radius"]), float(kept["yield_ratio"])
        return Scene(kept["density"], radius, kept["path"], (x, y, z), kappa, band)


def _answer(request: Request, folder: Path) -> None:
    scene = _read_scene(folder / "scene.npz")
    _pin()
    _forget_peak()
    held, _ = _memory()
    began = time.perf_counter()
    method = find(request.module, request.name, request.setting)
    imported = time.perf_counter() - began
    start_up, ms, force, density, failure = press(method, scene, request.budget)
    _, most = _memory()
    ending = time.perf_counter() + request.repeated
    while not failure and time.perf_counter() < ending:
        ms += press(method, scene, request.budget)[1]
    np.savez(
        folder / "unfinished.npz",
        failure=failure,
        force=np.array(force),
        density=density,
        ms=np.array(ms),
        start_up=1000.0 * (imported + start_up),
        mb=most - held,
    )
    os.replace(folder / "unfinished.npz", folder / "outcome.npz")


if __name__ == "__main__":
    _answer(Request(**json.loads(sys.argv[1])), Path(sys.argv[2]))
