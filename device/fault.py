# SPDX-License-Identifier: GPL-3.0-or-later
"""How far the arm is on its way to giving force, why it gives none, and both in words for the user."""

from __future__ import annotations

from enum import IntEnum


class State(IntEnum):
    """CLOSED -> OPEN -> HOMED -> ARMED -> RUN, and from any of them, on a fault, SAFE. Only RUN gives force."""

    CLOSED, OPEN, HOMED, ARMED, RUN, SAFE = range(6)


class Fault(IntEnum):
    """Why no force is given. The values go through shared memory: they are only ever added to.

    Most end in SAFE, where the user has to home and arm again. Those in :data:`NOTICES` do not: an order was refused,
    or the force waits at the small-force gate.
    """

    NONE = 0
    UNPLUGGED = 1
    SILENT = 2
    WRONG_REPORT = 3
    ENCODER_JUMP = 4
    JOINT_LIMIT = 5
    VELOCITY = 6
    NOT_FINITE = 7
    WRITE_FAILED = 8
    MEMORY_GONE = 9
    MODEL_NOT_FINITE = 10
    OVERRUN = 11
    CLOCK = 12
    NOT_HOMED = 14
    MODEL_STALE = 15
    STALL = 16
    HOME_IMPLAUSIBLE = 17
    HOME_MOVING = 18
    HOME_SILENT = 19


NOTICES = frozenset(
    {Fault.MODEL_STALE, Fault.STALL, Fault.HOME_IMPLAUSIBLE, Fault.HOME_MOVING, Fault.HOME_SILENT, Fault.NONE}
)
"""Reasons that are told without SAFE."""

_STATES = {
    State.CLOSED: "Not connected",
    State.OPEN: "Connected: put the arm in its home pose and press Home",
    State.HOMED: "Ready: press Arm to let it give force",
    State.ARMED: "Armed: force comes once the tool is out of the material",
    State.RUN: "Giving force",
    State.SAFE: "Stopped: home and arm again",
}

_FAULTS = {
    Fault.NONE: "",
    Fault.UNPLUGGED: "The arm was unplugged: plug it in, connect, home and arm again",
    Fault.SILENT: "The arm has stopped reporting: check its cable and power, then home and arm again",
    Fault.WRONG_REPORT: "The arm sends reports that its profile does not describe: choose the profile that fits, then "
    "connect again",
    Fault.ENCODER_JUMP: "An encoder jumped farther than a hand can move: check its cable, then home and arm again",
    Fault.JOINT_LIMIT: "A joint reads beyond what this arm can reach: put the arm in its home pose, then home and arm "
    "again; if that does not help, choose the profile that fits",
    Fault.VELOCITY: "The arm moved too fast while it gave force: let it come to rest, then home and arm again",
    Fault.NOT_FINITE: "The arm's pose came out as no number: home and arm again; if that does not help, check the "
    "profile's lengths and encoder counts",
    Fault.WRITE_FAILED: "The arm takes no more reports: check its cable and power, then connect, home and arm again",
    Fault.MEMORY_GONE: "The memory shared with Blender is gone: connect, home and arm again",
    Fault.MODEL_NOT_FINITE: "The material's force came out as no number: undo the last stroke, then home and arm again",
    Fault.OVERRUN: "This computer left the arm's loop waiting too long: end what keeps it busy, home and arm again",
    Fault.CLOCK: "This computer's clock ran backwards: home and arm again",
    Fault.NOT_HOMED: "The arm does not know where it is: put it in its home pose and press Home",
    Fault.MODEL_STALE: "Blender was too busy to say what is felt: lift the tool out of the material to feel it again",
    Fault.STALL: "This computer left the arm's loop waiting: lift the tool out of the material to feel it again",
    Fault.HOME_IMPLAUSIBLE: "The arm's joints do not reach the home pose of its profile: choose the profile that fits",
    Fault.HOME_MOVING: "The arm was moving: hold it still in its home pose and press Home again",
    Fault.HOME_SILENT: "The arm does not report yet: check its cable and power, then press Home again",
}


def state_text(state: int) -> str:
    """What the arm does and what to do next, one line."""
    try:
        return _STATES[State(state)]
    except ValueError:
        return f"Unknown state {state}: restart Blender, so that both sides are of the same Repoussé"


def fault_text(fault: int) -> str:
    """Why there is no force and what to do about it, one line; "" for no fault."""
    try:
        return _FAULTS[Fault(fault)]
    except ValueError:
        return f"Unknown fault {fault}: restart Blender, so that both sides are of the same Repoussé"
