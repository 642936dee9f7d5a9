# SPDX-License-Identifier: GPL-3.0-or-later
"""A loop without a clock or a device: its periods are called by the test, its reports are what the test says."""

from repousse.device import kinematics, reports
from repousse.device.hid_bus import UnpluggedError
from repousse.device.loop import PERIOD, Loop
from repousse.device.profile import builtin_profiles
from repousse.device.protocol import ForceModel, Request, SharedMemory
from repousse.device.safety import State

PREMIUM = builtin_profiles()["phantom-premium-1.5"]


class ScriptedWire:
    """An arm that stands where it is put. `faults` are done once, at the next read."""

    def __init__(self, profile, link):
        self.profile, self.link = profile, link
        self.superseded = 0
        self.number = 0
        self.offset = (0, 0, 0)
        self.put(kinematics.position(profile, kinematics.joint_angles(profile, profile.home_counts)))
        self.button = self.calibrate = self.silent = self.plugged_out = False
        self.replaced = None  # a report to send in place of the next
        self.takes_writes = True
        self.written = []
        self.closed = 0

    def put(self, position):
        angles = kinematics.angles_of(self.profile, position)
        self.counts = tuple(round(count) for count in kinematics.counts_of(self.profile, angles))

    @property
    def position(self):
        """Where the tip is, after the rounding to counts."""
        return kinematics.position(self.profile, kinematics.joint_angles(self.profile, self.counts))

    def newest(self):
        if self.plugged_out:
            raise UnpluggedError("read error")
        if self.silent:
            return None
        if self.replaced is not None:
            replaced, self.replaced = self.replaced, None
            return replaced
        self.number += 1
        counts = tuple(c + o for c, o in zip(self.counts, self.offset))
        return list(reports.encode_input(self.link, counts, self.button, self.calibrate, self.number))

    def write(self, report):
        if self.plugged_out or not self.takes_writes:
            return False
        output = reports.decode_output(self.link, report[1:])
        if output.command == 1:
            self.offset = tuple(h - c for h, c in zip(output.home, self.counts))
            self.calibrate = False
        self.written.append(output)
        return True

    def close(self):
        self.closed += 1

    @property
    def force(self):
        """What the last report's currents do at the tip, in N: the inverse of J^T, by Cramer's rule."""
        if not self.written:
            return (0.0, 0.0, 0.0)
        angles = kinematics.joint_angles(self.profile, self.counts)
        rows = kinematics.jacobian(self.profile, angles)
        torques = kinematics.motor_torques(self.profile, self.written[-1].currents)
        columns = list(zip(*rows))
        return solved(columns, torques)


def solved(matrix, right):
    """x of matrix x = right, 3 by 3."""

    def det(m):
        (a, b, c), (d, e, f), (g, h, i) = m
        return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)

    whole = det(matrix)
    return tuple(
        det([[right[r] if c == column else matrix[r][c] for c in range(3)] for r in range(3)]) / whole
        for column in range(3)
    )


class Rig:
    """A loop at a clock of its own. Orders and models go through the shared memory, as in earnest."""

    def __init__(self, profile=PREMIUM, link=None):
        self.profile, self.link = profile, link or profile.links[0]
        self.memory = SharedMemory.create()
        self.wire = ScriptedWire(profile, self.link)
        self.loop = Loop(profile, self.link, self.wire, self.memory, lambda: False, False)
        self.now = 1000.0
        self.loop.begin(self.now)
        self.request = Request()
        self.model = None
        self.scene = 0

    def close(self):
        self.memory.close(last=True)

    def order(self, **changes):
        self.request = self.request._replace(**changes)
        self.memory.request.write(self.request)

    def feel(self, **model):
        """What is felt from now on, sent anew each period; None for nothing."""
        self.model = model

    def run(self, periods=1, dt=PERIOD, send=True):
        """Let some periods pass; the force at the tip after each."""
        forces = []
        for _ in range(periods):
            self.now += dt
            if self.model is not None and send:
                self.memory.model.write(ForceModel(time=self.now, **self.model))
            self.loop.period(self.now, dt)
            forces.append(self.wire.force)
        return forces

    @property
    def state(self):
        return self.memory.state.read()

    def home(self):
        self.order(home=self.request.home + 1)
        self.run(5)

    def arm(self):
        self.order(arm=self.request.arm + 1)
        self.run(1)

    def move(self, position, periods=200):
        """The arm is moved there along a line."""
        start = self.wire.position
        for step in range(1, periods + 1):
            self.wire.put(tuple(a + (b - a) * step / periods for a, b in zip(start, position)))
            self.run(1)
        self.run(20)

    def engage(self, **model):
        """Homed, moved to where the model is, armed, and the ramp is over: the full force of the model."""
        self.run(20)
        self.home()
        self.move(model.get("position", self.wire.position))
        self.arm()
        wanted = {"position": self.wire.position, "yield_stress": 100.0, "normal": (0.0, 0.0, 1.0), "scene": 1} | model
        self.feel(**wanted | {"stress": 0.0})
        self.run(3)
        assert self.state.state is State.RUN, self.state
        self.feel(**wanted)
        self.run(1600)
        assert self.state.ramp == 1.0
