# SPDX-License-Identifier: GPL-3.0-or-later
"""An arm for tests: a loop without a subprocess, whose poses and faults are the test's own, and waiting for threads."""

import time
from contextlib import contextmanager

import bpy

from repousse.device.fault import Fault, State
from repousse.device.protocol import ArmState
from repousse.operators import arm_session

ADDON = "bl_ext.user_default.repousse"


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


__all__ = ["ADDON", "FakeLoop", "Fault", "State", "preferences", "preferring", "until"]
