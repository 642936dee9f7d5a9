# SPDX-License-Identifier: GPL-3.0-or-later
"""The loop, a period at a time: what comes in, what goes out, and that whatever goes wrong ends with zeros."""

from dataclasses import replace
from itertools import pairwise
from math import dist, hypot, inf, nan

import pytest

from repousse.device import kinematics, loop, reports
from repousse.device.hid_bus import UnpluggedError
from repousse.device.loop import KICK, PERIOD
from repousse.device.profile import builtin_profiles
from repousse.device.protocol import Coupling, ForceModel
from repousse.device.safety import Fault, State

from .rig import PREMIUM, Rig

WOODY = builtin_profiles()["woodenhaptics-2015"]
NOTHING = (0.0, 0.0, 0.0)


@pytest.fixture
def rig():
    rig = Rig()
    yield rig
    rig.close()


@pytest.fixture(params=[link.name for link in WOODY.links])
def woody(request):
    rig = Rig(WOODY, next(link for link in WOODY.links if link.name == request.param))
    yield rig
    rig.close()


def test_until_it_is_armed_nothing_is_written_to_an_arm_that_speaks(rig):
    """Any report switches its amplifiers on."""
    rig.run(50)
    assert rig.wire.written == [] and rig.state.state is State.OPEN
    rig.home()
    assert [output.command for output in rig.wire.written] == [1] and rig.state.state is State.HOMED
    rig.run(50)
    assert len(rig.wire.written) == 1
    rig.arm()
    rig.run(10)
    assert len(rig.wire.written) > 10 and rig.state.state is State.ARMED


def test_an_arm_that_says_nothing_is_spoken_to(rig):
    """Some firmware waits for the first report: zeros, ten milliseconds apart."""
    rig.wire.silent = True
    rig.run(100)
    assert len(rig.wire.written) == pytest.approx(0.1 / KICK, abs=1)
    assert all(output.currents == NOTHING for output in rig.wire.written)


@pytest.mark.parametrize("position", [(0.0, 0.0, 0.0), (0.03, -0.05, 0.02), (-0.06, 0.04, -0.05)])
def test_the_pose_is_that_of_the_encoders(rig, position):
    rig.run(3)
    rig.home()
    rig.wire.put(position)
    rig.run(3)
    assert dist(rig.state.position, position) < 5e-5  # two counts
    assert rig.state.position == pytest.approx(rig.wire.position, abs=1e-12)


def test_velocity_is_that_of_the_last_fifteen_milliseconds(rig):
    rig.run(3)
    rig.home()
    for step in range(60):
        rig.wire.put((0.0, 2e-4 * step, 0.0))
        rig.run(1)
    assert rig.state.velocity == pytest.approx((0.0, 0.2, 0.0), abs=0.005)
    rig.run(20)
    assert hypot(*rig.state.velocity) == 0.0


def test_counters_that_wrap_are_followed():
    """An arm whose counters stand at the edge of their 16 bits when it is homed by the host."""
    rig = Rig(WOODY, next(link for link in WOODY.links if link.layout == "protocol-1"))
    rig.wire.offset = (32760, -32760, 32700)
    rig.run(3)
    rig.home()
    assert rig.state.state is State.HOMED
    home = kinematics.position(WOODY, kinematics.joint_angles(WOODY, WOODY.home_counts))
    for step in range(100):
        rig.wire.put((home[0] - 3e-4 * step, home[1] + 3e-4 * step, home[2] - 3e-4 * step))
        rig.run(1)
        assert rig.state.position == pytest.approx(rig.wire.position, abs=1e-12)
    rig.close()


def test_homing_on_every_link_makes_the_present_pose_the_home_pose(woody):
    """By the firmware's own command, or where it has none by what the host adds."""
    woody.wire.offset = (123, -4567, 890)
    woody.run(30)
    assert woody.state.counts != WOODY.home_counts
    woody.home()
    assert woody.state.state is State.HOMED
    assert woody.state.counts == tuple(map(float, WOODY.home_counts))


def test_the_button_on_the_arm_homes_it_as_well(rig):
    rig.run(3)
    rig.wire.calibrate = True
    rig.run(5)
    assert rig.state.state is State.HOMED and not rig.wire.calibrate


def test_an_arm_that_does_not_take_its_home_counts_is_not_homed(rig):
    rig.run(3)
    rig.wire.offset = (3000, 0, 0)
    take, rig.wire.write = rig.wire.write, lambda report: True  # it goes, but nothing comes of it
    rig.home()
    rig.run(300)
    assert rig.state.state is not State.HOMED and rig.state.fault is Fault.NOT_HOMED
    rig.wire.write = take
    rig.home()
    assert rig.state.state is State.HOMED


@pytest.mark.parametrize(
    "normal", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.48, 0.6, 0.64), (0.1, 0.2, 0.2)]
)
@pytest.mark.parametrize("position", [(0.0, 0.0, 0.0), (0.02, -0.03, 0.04)])
def test_the_force_follows_the_local_model_to_one_per_cent(rig, normal, position):
    """What the currents that were written do at the tip, against the law, at rest and moved off by a millimetre."""
    rig.engage(position=position, stress=1.0, gradient=tuple(-300.0 * n for n in normal), normal=normal)
    assert rig.state.state is State.RUN
    slope = 300.0 * hypot(*normal)
    for deeper in (0.0, 0.0005, 0.001, -0.001):
        rig.wire.put(tuple(p - deeper * n for p, n in zip(position, normal)))
        (*_, force) = rig.run(40)
        moved = sum((w - p) * -300.0 * n for w, p, n in zip(rig.wire.position, position, normal))
        expected = tuple((1.0 + moved) * n for n in normal)
        assert dist(force, expected) <= 0.01 * hypot(*expected) + 0.002
        assert rig.state.force == pytest.approx(expected, rel=0.01, abs=0.002)
        assert rig.state.slope_asked == pytest.approx(slope, rel=1e-6)


def test_a_force_over_the_yield_stress_is_not_given(rig):
    rig.engage(stress=3.0, yield_stress=1.2)
    (force,) = rig.run(1)
    assert hypot(*force) == pytest.approx(1.2, rel=0.01)


def test_what_the_motors_cannot_do_keeps_its_direction(rig):
    rig.engage(stress=30.0, normal=(0.6, 0.0, 0.8))
    (force,) = rig.run(1)
    size = hypot(*force)
    assert 1.0 < size < PREMIUM.max_force * 1.01
    assert tuple(f / size for f in force) == pytest.approx((0.6, 0.0, 0.8), abs=0.02)
    assert max(map(abs, rig.wire.written[-1].currents)) <= 0.95 * rig.link.firmware_current_limit + 1e-3


def test_heat_takes_the_current_down_to_what_lasts():
    """With windings that warm four times as quickly, for a test need not take a minute."""
    rig = Rig(replace(PREMIUM, winding_time=PREMIUM.winding_time / 4.0))
    rig.engage(stress=30.0)
    rig.run(15000)
    assert max(map(abs, rig.wire.written[-1].currents)) == pytest.approx(PREMIUM.continuous_current, rel=0.02)
    assert rig.state.heat == pytest.approx(1.0, abs=0.02)
    rig.close()


def test_force_scale_scales(rig):
    rig.engage(stress=1.0)
    rig.order(force_scale=0.4)
    (*_, force) = rig.run(10)
    assert hypot(*force) == pytest.approx(0.4, rel=0.01)


def test_a_slow_firmware_gets_a_quarter_of_the_force():
    slow = next(link for link in WOODY.links if link.firmware_watchdog_ms > 100)
    rig = Rig(WOODY, slow)
    rig.engage(stress=30.0)
    (force,) = rig.run(1)
    assert hypot(*force) <= WOODY.max_force / 4 * 1.01
    rig.close()


def test_the_clutch_lets_go_and_the_gate_is_gone_through_again(rig):
    rig.engage(stress=1.0)
    rig.order(clutch=True)
    (force, *_) = rig.run(5)
    assert force == NOTHING and rig.state.state is State.ARMED
    rig.order(clutch=False)
    forces = rig.run(50)
    assert all(force == NOTHING for force in forces) and rig.state.waiting
    rig.feel(position=rig.wire.position, yield_stress=100.0, normal=(0.0, 0.0, 1.0), scene=1, stress=0.1)
    forces = rig.run(100)
    assert 0.0 < forces[-1][2] < 0.02 and rig.state.ramp == pytest.approx(0.1 / 1.5, rel=0.1)


def test_another_scene_goes_through_the_gate(rig):
    rig.engage(stress=1.0)
    rig.model["scene"] = 2
    (force,) = rig.run(1)
    assert force == NOTHING and rig.state.state is State.ARMED


def test_disarmed_means_no_force_and_armed_again_a_ramp(rig):
    rig.engage(stress=0.15)
    rig.order(disarm=1)
    (force,) = rig.run(1)
    assert force == NOTHING and rig.state.state is State.HOMED
    rig.arm()
    forces = rig.run(20)
    assert 0.0 < forces[-1][2] < 0.005


def test_the_papers_coupling_lags_a_period(rig):
    rig.engage(stress=1.0)
    rig.order(coupling=Coupling.INTERPOLATE)
    rig.run(5)
    rig.model["stress"] = 2.0
    first, *_ = rig.run(1)
    assert first[2] == pytest.approx(1.0, rel=0.02)
    rig.order(coupling=Coupling.LOCAL)
    *_, last = rig.run(20)
    assert last[2] == pytest.approx(2.0, rel=0.01)


# What goes wrong: done at a full force of 1 N, and within how many periods the force has to be zero.
def unplug(rig):
    rig.wire.plugged_out = True


def silence(rig):
    rig.wire.silent = True


def cut_short(rig):
    rig.wire.replaced = [0] * (rig.link.report_length - 1)


def jump(rig):
    rig.wire.offset = tuple(o + 400 for o in rig.wire.offset)


def beyond_a_joint(rig):
    """The base is turned on and on, no faster than a hand does."""
    while kinematics.joint_angles(rig.profile, rig.wire.counts)[0] < rig.profile.joint_limits[0][1] + 0.1:
        a, b, c = rig.wire.counts
        rig.wire.counts = (a + 30, b, c)
        rig.run(1)


def model_is_not_a_number(rig):
    rig.model["stress"] = nan


def model_is_endless(rig):
    rig.model["gradient"] = (inf, 0.0, 0.0)


def no_write(rig):
    rig.wire.takes_writes = False


FAULTS = [
    (silence, Fault.SILENT, 21),
    (cut_short, Fault.WRONG_REPORT, 1),
    (jump, Fault.ENCODER_JUMP, 1),
    (beyond_a_joint, Fault.JOINT_LIMIT, 1),
    (model_is_not_a_number, Fault.MODEL_NOT_FINITE, 1),
    (model_is_endless, Fault.MODEL_NOT_FINITE, 1),
]


@pytest.mark.parametrize("fault, told, periods", FAULTS, ids=[fault.__name__ for fault, _, _ in FAULTS])
def test_a_fault_ends_with_zeros_and_stays_until_the_user_homes_and_arms(rig, fault, told, periods):
    rig.engage(stress=1.0)
    assert rig.wire.force[2] == pytest.approx(1.0, rel=0.01)
    former = dict(rig.model)
    fault(rig)
    forces = rig.run(periods)
    assert forces[-1] == NOTHING
    assert rig.state.state is State.SAFE and rig.state.fault is told
    assert rig.state.force == NOTHING and rig.state.currents == NOTHING
    rig.wire.silent = False
    rig.feel(**former | {"stress": 0.1})
    rig.arm()
    assert all(force == NOTHING for force in rig.run(100)) and rig.state.state is State.SAFE
    rig.wire.put((0.0, 0.0, 0.0))
    rig.run(30)
    rig.home()
    assert all(force == NOTHING for force in rig.run(50)) and rig.state.state is State.HOMED
    rig.arm()
    rig.run(10)
    assert rig.state.state is State.RUN


def test_a_write_that_fails_is_a_fault(rig):
    rig.engage(stress=1.0)
    no_write(rig)
    rig.run(1)
    assert rig.state.state is State.SAFE and rig.state.fault is Fault.WRITE_FAILED
    rig.wire.takes_writes = True
    assert rig.run(1) == [NOTHING]


def test_unplugging_is_told_within_the_period(rig):
    rig.engage(stress=1.0)
    unplug(rig)
    with pytest.raises(UnpluggedError):
        rig.run(1)


def test_a_model_that_grows_old_fades_and_is_gone_after_a_tenth_of_a_second(rig):
    """Blender is stalled for two seconds: zero at 100 ms, and afterwards the gate, not a fault."""
    rig.engage(stress=1.0)
    forces = [force[2] for force in rig.run(2000, send=False)]
    assert min(forces[:89]) == pytest.approx(1.0, rel=0.01)
    assert all(later <= earlier + 1e-9 for earlier, later in pairwise(forces))
    assert forces[95] == pytest.approx(0.5, abs=0.15)
    assert max(forces[100:]) == 0.0
    assert rig.state.state is State.ARMED and rig.state.fault is Fault.MODEL_STALE
    assert rig.state.waiting is False
    forces = rig.run(20)
    assert all(force == NOTHING for force in forces) and rig.state.waiting
    rig.model["stress"] = 0.0
    rig.run(5)
    assert rig.state.state is State.RUN


@pytest.mark.parametrize("moved", [0.0, 0.002, -0.002])
def test_twenty_milliseconds_of_stalled_blender_never_raise_a_force(rig, moved):
    """At a held pose, whatever way it is off the model's."""
    rig.engage(stress=1.0, gradient=(0.0, 0.0, -400.0))
    rig.wire.put((0.0, 0.0, -moved))
    *_, before = rig.run(20)
    forces = [hypot(*force) for force in rig.run(20, send=False)]
    assert max(forces) <= hypot(*before) + 1.1e-3  # a milliampere's rounding


def test_a_loop_that_stood_still_for_twenty_milliseconds_goes_on_where_it_was(rig):
    """Meanwhile the hand went on into the material: the force may rise by the slew of one period alone."""
    rig.engage(stress=0.5, gradient=(0.0, 0.0, -400.0))
    *_, before = rig.run(1)
    rig.wire.put((0.0, 0.0, -0.004))
    rig.model["stress"] = 2.0
    (after,) = rig.run(1, dt=0.02)
    assert hypot(*after) <= hypot(*before) + PREMIUM.max_slew * 1.01 + 1.1e-3


def test_torn_writes_leave_the_last_good_model(rig):
    rig.engage(stress=1.0)
    sequence = rig.memory.model._sequence
    sequence[0] += 1  # as if its writer were stopped half way
    forces = rig.run(40, send=False)
    assert all(force[2] == pytest.approx(1.0, rel=0.01) for force in forces)
    assert rig.memory.torn >= 40


def test_a_scene_that_is_nothing_gives_nothing(rig):
    rig.engage(stress=1.0)
    rig.model["scene"] = 0
    (force,) = rig.run(1)
    assert force == NOTHING


def test_an_arm_in_lock_step_is_answered_report_by_report():
    """Two reports where it waits for one would be one too many for ever."""
    link = next(link for link in WOODY.links if link.lock_step)
    rig = Rig(WOODY, link)
    rig.run(10)
    assert len(rig.wire.written) == 10
    rig.wire.silent = True
    rig.run(5)
    assert len(rig.wire.written) == 10
    rig.close()


def test_reports_that_are_missing_are_counted(rig):
    rig.run(5)
    rig.wire.number += 3
    rig.run(1005)
    rig.wire.number = (1 << 16) - 2
    rig.run(5)
    rig.run(1005)
    assert rig.memory.figures.read().lost == 3 + ((1 << 16) - 2 - (5 + 3 + 1005))


def test_it_measures_itself(rig):
    rig.run(1500)
    rig.run(1, dt=0.007)
    rig.run(1000)
    figures = rig.memory.figures.read()
    assert figures.rate == pytest.approx(1000.0, rel=0.01)
    assert figures.longest == pytest.approx(0.007) and figures.ticks > 1900
    assert sum(rig.memory.periods) == 2501 and rig.memory.periods[100] + rig.memory.periods[99] == 2500
    assert rig.memory.periods[700] + rig.memory.periods[699] == 1
    parts = (figures.read, figures.pose, figures.force, figures.write, figures.tell)
    assert all(0.0 < part < 0.001 for part in parts)
    assert sum(rig.memory.work) == 2501


def test_every_way_out_writes_zeros_and_lets_go(rig):
    rig.engage(stress=1.0)

    def leave():
        with loop.driving(rig.loop, rig.wire):
            raise RuntimeError("whatever it was")

    with pytest.raises(RuntimeError, match="whatever"):
        leave()
    assert [output.currents for output in rig.wire.written[-loop.FAREWELLS :]] == [NOTHING] * loop.FAREWELLS
    assert rig.wire.closed == 1 and rig.state.state is State.CLOSED


def test_currents_that_the_firmware_would_not_take_are_never_sent(rig, monkeypatch):
    """The last door: whatever went wrong before it, the arm gets zeros."""
    rig.engage(stress=1.0)
    monkeypatch.setattr(loop.safety, "limited_currents", lambda status, *_: (status, (9.0, 0.0, 0.0)))
    (force,) = rig.run(1)
    assert force == NOTHING and rig.state.state is State.SAFE


def test_a_period_is_a_millisecond():
    assert PERIOD == 1e-3 and reports.unwrap(0, 5) == 5


def test_a_surface_that_was_left_is_met_again_before_any_model_knows_of_it(rig):
    """The tip is drawn 3 mm out, where a model feels nothing, and comes back to where it was without another model."""
    rig.engage(stress=1.0, gradient=(0.0, 0.0, -400.0))
    place = rig.wire.position
    x, y, z = place
    rig.move((x, y, z + 0.003), periods=20)
    assert rig.wire.force == pytest.approx(NOTHING, abs=1e-9)
    rig.feel(**rig.model | {"position": rig.wire.position, "stress": 0.0, "gradient": NOTHING})
    rig.run(3)
    rig.model = None
    rig.move(place, periods=20)
    assert rig.wire.force[2] == pytest.approx(1.0, abs=0.05)


def test_the_papers_coupling_begins_when_a_model_comes_not_when_it_was_made(rig):
    """Late models make it late, not sudden: from one stress to the next in the time that was between them."""
    rig.engage(stress=0.2)
    rig.order(coupling=Coupling.INTERPOLATE)
    rig.run(30)
    model = ForceModel(**rig.model)
    rig.memory.model.write(model._replace(time=rig.now - 0.04, stress=0.2))
    rig.run(1, send=False)
    rig.memory.model.write(model._replace(time=rig.now - 0.021, stress=1.0))
    forces = [force[2] for force in rig.run(22, send=False)]
    assert forces[0] == pytest.approx(0.2, abs=0.02)
    assert forces[10] == pytest.approx(0.6, abs=0.03)
    assert forces[20] == pytest.approx(1.0, abs=0.02)
