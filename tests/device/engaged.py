# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that has an arm in hand, as Blender has: homes it, arms it, and renders a force of 1 N upwards.

Run as a script it does so until its stdin ends, and says "engaged" once the force is at its full; imported, it is
:class:`Engaged`, which does the same within a test.
"""

import json
import sys
import threading
import time
from math import hypot

from repousse.device import HapticLoop
from repousse.device.profile import from_json
from repousse.device.protocol import ForceModel
from repousse.device.safety import State

FORCE = 1.0
"""Newtons."""
PATIENCE = 20.0
"""Seconds for what takes two on a machine at rest."""


class Engaged:
    """A HapticLoop that renders :data:`FORCE` along z, from ``with Engaged(...)`` to its end.

    A thread sends a model each millisecond, as the engine's collision does; ``model`` may be changed meanwhile.
    """

    def __init__(self, profile, path, environment, script=None):
        self.loop = HapticLoop(profile, path=path, environment=environment, script=script)
        self.model = ForceModel(yield_stress=10.0, normal=(0.0, 0.0, 1.0), scene=1)
        self._over = threading.Event()
        self._sender = threading.Thread(target=self._send, daemon=True)

    def _send(self):
        while not self._over.wait(0.001):
            self.loop.send(self.model._replace(time=time.perf_counter()))

    def __enter__(self):
        self.loop.start()
        self._sender.start()
        try:
            self.engage()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        self._over.set()
        self._sender.join()
        self.loop.stop()

    def until(self, condition, patience=PATIENCE):
        """Wait until the arm's state meets a condition; AssertionError with the state when it does not."""
        end = time.monotonic() + patience
        while not condition(self.loop.state()):
            assert time.monotonic() < end and (self.loop.running or self.loop.state().state is State.CLOSED), (
                self.loop.failure,
                self.loop.state(),
            )
            time.sleep(0.0005)
        return self.loop.state()

    def engage(self):
        """Home, arm, and wait until the whole force is on."""
        self.until(lambda state: state.tick > 20)
        self.loop.home()
        self.until(lambda state: state.state is State.HOMED)
        self.loop.arm()
        self.until(self._is_full)

    def _is_full(self, state):
        """Whether the whole force is on. A busy machine may have stalled the loop or us meanwhile: then it waits for a
        small force again."""
        self.model = self.model._replace(stress=FORCE if state.state is State.RUN else 0.0)
        return state.ramp == 1.0 and hypot(*state.force) > 0.99 * FORCE


def main():
    """Configuration as JSON in the first line of stdin: profile, path, environment, script."""
    config = json.loads(sys.stdin.readline())
    with Engaged(from_json(config["profile"]), config["path"], config["environment"], config["script"]) as engaged:
        print(f"engaged {engaged.loop.process_id}", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main()
