# SPDX-License-Identifier: GPL-3.0-or-later
"""An arm for tests: a loop without a subprocess, whose poses and faults are the test's own, and waiting for threads."""

import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import bpy
import numpy as np

from repousse.core import Material, Push, SphereTool
from repousse.core.engine import Engine
from repousse.device.fault import State
from repousse.device.profile import builtin_profiles
from repousse.device.protocol import ArmState
from repousse.operators import arm_session, session
from repousse.operators.aim import Aim, voxels_to_world

ADDON = "bl_ext.user_default.repousse"
PROFILE = replace(builtin_profiles()["phantom-premium-1.5"], buttons=2)
REACH = PROFILE.workspace_radius
EDGE = 1.2 / 24
"""Of a voxel, in world units: the block of clay is 1.2 wide, and the arm's reach half of that."""
METRE = 0.6 / REACH
"""World units to a metre of the arm."""
TOP = 0.6
"""World z of the clay's top."""


def at(x, y, z):
    """A place of the world, as one of the arm: it sits before the object, and its x comes towards the user, -y."""
    cx, cy, cz = PROFILE.workspace_centre
    return cx - y / METRE, cy + x / METRE, cz + z / METRE


TOUCHING = at(0.0, 0.0, TOP + 1.0 * EDGE)
"""A tool of four voxels is a little in the top of the clay there."""
AIR = at(0.0, 0.0, TOP + 8.0 * EDGE)
"""It is out of the clay there."""


class FakeLoop:
    """What a HapticLoop is to a session: ``state()`` is what the test has put, ``sent`` what it was told to render."""

    def __init__(self, profile):
        self.profile, self.link = profile, profile.links[0]
        self.running, self.failure = False, ""
        self.sent, self.orders = [], []
        self.starts = self.stops = 0
        self._now = ArmState(state=State.OPEN)

    def start(self):
        self.starts, self.running = self.starts + 1, True

    def stop(self):
        self.stops, self.running = self.stops + 1, False

    def state(self):
        return self._now

    def put(self, position=None, **changes):
        """The arm's next period."""
        position = self._now.position if position is None else tuple(float(x) for x in position)
        now = time.perf_counter()
        self._now = self._now._replace(tick=self._now.tick + 1, time=now, position=position, **changes)

    def fail(self, fault):
        """As the real loop does it: no force any more, and the reason is told."""
        self.put(state=State.SAFE, fault=fault)

    def die(self, why):
        """The subprocess has ended."""
        self.running, self.failure = False, why

    def send(self, model):
        assert self.stops == 0, "a loop that was stopped is told something"
        self.sent.append(model)

    @property
    def model(self):
        """What is rendered; None for nothing."""
        return self.sent[-1] if self.sent else None

    def home(self):
        self.orders.append("home")

    def arm(self):
        self.orders.append("arm")

    def disarm(self):
        self.orders.append("disarm")

    def set_force_scale(self, scale):
        self.orders.append(("force_scale", scale))

    def set_clutch(self, held):
        self.orders.append(("clutch", held))


def preferences():
    return bpy.context.preferences.addons[ADDON].preferences


@contextmanager
def preferring(**wanted):
    """The preferences so, and as they were again."""
    former = {name: getattr(preferences(), name) for name in wanted}
    try:
        for name, value in wanted.items():
            setattr(preferences(), name, value)
        yield
    finally:  # they are other ones where the add-on was disabled meanwhile
        for name, value in former.items():
            setattr(preferences(), name, value)


def until(condition, what, limit=10.0):
    """Let the threads work, and the timer look at the arm, until something holds."""
    deadline = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < deadline, f"waited {limit:g} s in vain: {what}"
        arm_session.watch()
        time.sleep(0.002)


def small_tool(voxels=4.0):
    """A radius in pixels under which the arm's tool has about so many voxels."""
    view = arm_session.view_of(bpy.context, session.live())
    aim = Aim.of(view.region, view.eye, np.eye(4))
    bpy.context.scene.repousse.radius = round(voxels * EDGE / aim.length((0.0, 0.0, 0.0), 1.0))


def threads():
    return {thread.name for thread in threading.enumerate() if thread.name.startswith("repousse")} - {"repousse hash"}


def take(arm, obj):
    """What the operator does when the stylus is pressed."""
    live = session.live()
    held = arm.take_up(live, voxels_to_world(obj, live))
    push = Push(live.grid, SphereTool(held.radius), Material())
    engine = Engine(push, hand=held.hand)
    held.attach(engine)
    live.feeling = None
    engine.start()
    live.engine = engine
    return held, engine


def commit(obj, engine):
    """What the operator does when all is solved."""
    live = session.live()
    samples = engine.finish()
    live.commit(obj, [session.in_array(box, engine.push.origin) for box in engine.touched], engine.mass_out)
    live.engine = None
    bpy.ops.ed.undo_push(message="Sculpt")
    return samples
