# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole haptic stroke but for Blender's window: an arm in software, its loop, an engine, and all that went between.

The arm is a PHANToM Premium 1.5 in the grip of a hand that does what a script says, again and again. What is here does
as operators/arm_session.py does: it homes and arms, lets the arm feel, and while the stylus is pressed, push.
"""

import copy
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any, NamedTuple

import numpy as np

from repousse.core import DensityGrid, Regime, Stroke
from repousse.core.engine import Engine
from repousse.core.engine import Health as EngineHealth
from repousse.core.local_model import LocalModel
from repousse.device import HapticLoop, kinematics
from repousse.device.haptic_loop import LoopHealth
from repousse.device.hid_bus import EMULATED
from repousse.device.profile import builtin_profiles
from repousse.device.protocol import ArmState, Triple
from repousse.device.safety import State, fault_text
from repousse.operators.arm_hand import STYLUS, ArmHand, Line, StrokeHand
from repousse.operators.arm_mapping import ArmMapping, Workspace

from .shim.log import Entry, Kind, moment
from .shim.log import Moment as ArmMoment

ARM = builtin_profiles()["phantom-premium-1.5"]
UP = np.array((0.0, 0.0, 1.0))
"""In the arm's frame, and in that of the grids here."""
ATTEMPTS = 8
"""A machine that does much else stalls a process now and then; safety then takes the force away in the middle of a
stroke, and what is left of it shows no law."""
OUT = 2.0
"""Voxels over the material."""
PATIENCE = 60.0
"""Seconds for what takes ten on a machine at rest."""


class StrokeFailedError(RuntimeError):
    """No stroke came through as a whole; one line."""


@dataclass(frozen=True)
class Keys:
    """What the hand wants: rows of (s, metres from the middle of the workspace (3,), whether the stylus is pressed)."""

    rows: tuple[tuple[float, tuple[float, float, float], bool], ...]

    def save(self, path: Path) -> None:
        """As a script of an intention, that begins anew at its end."""
        lines = [{"intention": 1, "interpolation": "linear", "loop": True}]
        lines += [{"time": when, "position": place, "button": pressed} for when, place, pressed in self.rows]
        path.write_text("".join(json.dumps(line) + "\n" for line in lines))


@dataclass(frozen=True)
class Task:
    """What is to be done: a hand, a grid, and the tool and material of a ``stroke`` without samples.

    The tool's centre is at ``place`` (voxels) when the tip is ``touching`` (m, from the middle of the workspace), and a
    metre of the arm is ``scale`` voxels long. There the tool touches the material, and goes into it downwards.
    """

    name: str
    keys: Keys
    grid: DensityGrid
    stroke: Stroke
    place: np.ndarray
    touching: np.ndarray
    scale: float

    @property
    def mapping(self) -> ArmMapping:
        """From the arm to the grid."""
        x, y, z = np.eye(3).tolist()
        centre = tuple((self.place - self.scale * self.touching).tolist())
        return ArmMapping(Workspace(centre, (x, y, z), self.scale).from_device(ARM.workspace_centre))

    def depth(self, positions: np.ndarray) -> np.ndarray:
        """Voxels that the tool is in the material, for places of the arm (n, 3) in m."""
        tips = np.array([self.mapping.position(tuple(position)) for position in positions])
        return self.place[2] - tips[:, 2]


class Moment(NamedTuple):
    """What was known when the collision thread had felt: the arm, the material there, and what the push last met."""

    state: ArmState
    model: LocalModel
    regime: Regime


class Feeling(ArmHand):
    """An ArmHand that keeps what went through it."""

    def __init__(self, *settings) -> None:
        super().__init__(*settings)
        self.moments: list[Moment] = []

    def feel(self, model: LocalModel) -> None:
        super().feel(model)
        assert self._state is not None
        self.moments.append(Moment(self._state, model, Regime.NONE))


class Pushing(StrokeHand):
    """A StrokeHand that keeps what went through it."""

    engine: Engine

    def __init__(self, *settings) -> None:
        super().__init__(*settings, by_touch=False)
        self.moments: list[Moment] = []

    def feel(self, model: LocalModel) -> None:
        super().feel(model)
        assert self._state is not None
        self.moments.append(Moment(self._state, model, self.engine.contact.regime))


@dataclass(frozen=True)
class Performance:
    """A stroke that was made, and all that was seen of it.

    ``before`` is the grid as it was; ``moments`` are those of the stroke, ``approach`` those since the arm was armed.
    ``log`` is the arm's own; ``attempts`` tells how each went.
    """

    task: Task
    before: DensityGrid
    stroke: Stroke
    approach: list[Moment]
    moments: list[Moment]
    log: list[Entry]
    mass_out: float
    loop: LoopHealth
    engine: EngineHealth
    through_hidapi: bool
    attempts: tuple[str, ...] = ()

    @property
    def broken(self) -> str:
        """Why the force of this stroke was not that of the material all along; empty where it was."""
        if self.moments[0].model.stress > 0.0:
            return "it began within the material"
        for seen in self.moments:
            if not is_engaged(seen.state):
                return f"the force was taken away in the middle: {fault_text(seen.state.fault)}"
        return ""

    @property
    def sculpted(self) -> np.ndarray:
        """The density afterwards, where the grid was before: poses are in that frame."""
        (i, j, k), (a, b, c) = self.task.grid.grown, self.before.shape
        return self.task.grid.density[i : i + a, j : j + b, k : k + c]

    def told(self) -> "Trace":
        """What the loop says, as often as the collision thread looked."""
        states = [seen.state for seen in self.moments]
        return Trace.of((state.time, state.position, state.force, state.currents) for state in states)

    def given(self) -> "Trace":
        """What the arm's own motors gave, each millisecond, by the log of their currents and the arm's kinematics.

        Empty where the arm is within the loop's process, for there it keeps no log.
        """
        first, last = self.moments[0].state.time, self.moments[-1].state.time
        seen = [
            (entry.time, moment(entry))
            for entry in self.log
            if entry.kind is Kind.STATE and first <= entry.time <= last
        ]
        return Trace.of((when, arm.position, _tip_force(arm), arm.currents) for when, arm in seen)


def is_engaged(state: ArmState) -> bool:
    """Whether the whole force is on."""
    return state.state is State.RUN and state.ramp == 1.0


class Trace(NamedTuple):
    """An arm over time: ``time`` (n,) s, ``place`` (n, 3) m and ``force`` (n, 3) N of its tip, ``currents`` (n, 3)
    A."""

    time: np.ndarray
    place: np.ndarray
    force: np.ndarray
    currents: np.ndarray

    @classmethod
    def of(cls, rows: Iterable[tuple[float, Triple, Triple, Triple]]) -> "Trace":
        """From a row for each time."""
        values = np.array([(when, *place, *force, *currents) for when, place, force, currents in rows]).reshape(-1, 10)
        return cls(values[:, 0], values[:, 1:4], values[:, 4:7], values[:, 7:])


def _tip_force(arm: ArmMoment) -> np.ndarray:
    """The force (3,) that the motors give at the tip: J^T f is their torques."""
    jacobian = kinematics.jacobian(ARM, kinematics.angles_of(ARM, arm.position))
    return np.linalg.solve(np.array(jacobian).T, kinematics.motor_torques(ARM, arm.currents))


def perform(task: Task, folder: Path, watch: Callable[[str, ArmState], None] = lambda *_: None) -> Performance:
    """Make the stroke, on a grid of its own. ``watch`` is called a hundred times a second with what goes on.

    Raises StrokeFailedError with one line where none came through as a whole.
    """
    told: list[str] = []
    while len(told) < ATTEMPTS:
        try:
            performance = _attempt(task, folder, watch)
        except StrokeFailedError as error:
            told.append(str(error))
            continue
        if not performance.broken:
            return replace(performance, attempts=(*told, "came through"))
        told.append(performance.broken)
    raise StrokeFailedError(f"{task.name}: {ATTEMPTS} strokes and none came through: {'; '.join(told)}")


class _Arm(NamedTuple):
    path: str
    environment: dict[str, str] | None
    log: Callable[[], list[Entry]]


@contextmanager
def _attached(script: Path) -> Iterator[_Arm]:
    """The arm behind the unmodified hidapi where that can be had, else within the loop's process."""
    served = _served(script)
    if served is None:
        yield _Arm(EMULATED, None, list)
        return
    with served:
        yield _Arm(served.path, served.environment, served.log)


def _served(script: Path) -> Any:
    if sys.platform != "linux":
        return None
    from .shim.build import library
    from .shim.served_arm import ServedArm

    try:
        library()
    except (OSError, CalledProcessError):  # no compiler for this machine
        return None
    return ServedArm(ARM, script=script, number=100 + os.getpid() % 900)  # other runs may have arms of their own


def _attempt(task: Task, folder: Path, watch: Callable[[str, ArmState], None]) -> Performance:
    script = folder / f"{task.name}.jsonl"
    task.keys.save(script)
    grid = copy.deepcopy(task.grid)
    with _attached(script) as arm:
        with HapticLoop(ARM, path=arm.path, script=str(script), environment=arm.environment) as loop:
            session = _Session(task, loop, watch)
            session.engage()
            approach = session.feel(grid)
            hand, engine = session.push(grid)
        log = arm.log()
    solved = replace(task.stroke, samples=engine.solved).began_on(task.grid)
    return Performance(
        replace(task, grid=grid),
        task.grid,
        solved,
        approach,
        hand.moments,
        log,
        engine.mass_out,
        loop.health(),
        session.engine_health,
        arm.path != EMULATED,
    )


class _Session:
    """One arm, from home to the end of a stroke."""

    def __init__(self, task: Task, loop: HapticLoop, watch: Callable[[str, ArmState], None]) -> None:
        self._task, self._loop, self._watch = task, loop, watch
        self._line = Line(loop)
        self._mapping = task.mapping
        self._began = time.perf_counter()

    def _until(self, doing: str, condition: Callable[[ArmState], bool]) -> None:
        end, looks = time.monotonic() + PATIENCE, 0
        while not condition(state := self._line.state()):
            if time.monotonic() > end or not self._loop.running or state.state is State.SAFE:
                told = self._loop.failure or fault_text(state.fault) or f"nothing came of it in {PATIENCE:g} s"
                raise StrokeFailedError(f"{doing}: {told}")
            if looks % 10 == 0:
                self._watch(doing, state)
            looks += 1
            time.sleep(0.001)

    def engage(self) -> None:
        """Home, upon which the hand goes to work, and arm once it has lifted the tool out of the material."""
        self._until("connecting", lambda state: state.tick > 20)
        self._loop.home()
        self._until("homing", lambda state: state.state is State.HOMED)
        self._until("lifting", lambda state: self._task.depth(np.array([state.position]))[0] < -OUT)
        self._loop.arm()

    def feel(self, grid: DensityGrid) -> list[Moment]:
        """Let the whole force come on, above the material, and go on until the stylus is pressed."""
        hand = Feeling(self._line, self._mapping, 1, self._began)
        with Engine(self._task.stroke.push(grid), hand=hand, deform=False):
            self._until("arming", lambda state: is_engaged(state) and not state.buttons & STYLUS)
            self._until("approaching", lambda state: bool(state.buttons & STYLUS))
        return hand.moments

    def push(self, grid: DensityGrid) -> tuple[Pushing, Engine]:
        """Push until the stylus is released."""
        hand = Pushing(self._line, self._mapping, 1, self._began)
        engine = Engine(self._task.stroke.push(grid), hand=hand)
        hand.engine, hand.release = engine, engine.release
        with engine:
            self._until(self._task.name, lambda state: hand.over or not is_engaged(state))
            self.engine_health = engine.health
            engine.finish()
        self._line.send_nothing()
        self._line.cut()
        return hand, engine
