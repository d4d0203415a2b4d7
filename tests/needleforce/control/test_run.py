"""The loop that moves an arm: it rests in the end, and knows what was refused."""

import numpy as np
import pytest

from needleforce.control import (
    Controller,
    Limits,
    SafetyLimits,
    SettingError,
    TipVelocity,
    run,
)
from needleforce.devices import MasterReading
from tests.needleforce.control.late_arm import LateArm
from tests.needleforce.control.managed_session import new_manager
from urdf import NeedleTool, load_lwr

HOME_rad = [0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0]
DOWN = [TipVelocity((0.0, 0.0, -0.05))]


class PlainArm(LateArm):
    """An arm that refuses some cycles."""

    def __init__(self, refused=(), is_real=False):
        self.robot = load_lwr(payload=NeedleTool())
        super().__init__(self.robot, HOME_rad)
        self.is_real = is_real
        self.refused = refused
        self.sent = []

    def __iter__(self):
        for _ in range(1000):
            sample = self.sample()
            sample.dq_rad_s = sample.tau_Nm = np.zeros(7)
            sample.is_real = self.is_real
            yield sample

    def send(self, dq_rad_s):
        is_taken = len(self.sent) not in self.refused
        self.sent.append(np.array(dq_rad_s))
        self.move(is_taken * self.sent[-1])
        return is_taken

    def run(self, manager=None, **how):
        limits = Limits.of_arm(self.robot, "lwr")
        return run(self, Controller(self.robot, limits), manager, **how)


def test_an_arm_rests_when_its_loop_breaks_off():
    arm = PlainArm()
    for number, tick in enumerate(arm.run()):
        tick.tasks = DOWN
        if number == 300:
            break

    assert 0.01 < np.abs(arm.sent[299]).max() < 0.5
    assert np.abs(arm.sent[-1]).max() == 0.0
    assert np.abs(np.diff(arm.sent, axis=0)).max() <= 4.9e-3 + 1e-9
    assert len(arm.sent) < 400


def test_after_a_refusal_commands_begin_from_rest():
    arm = PlainArm(refused=range(200, 250))
    ticks = []
    for tick in arm.run():
        tick.tasks = DOWN
        ticks.append(tick)

    assert ticks[200].was_taken
    assert not ticks[201].was_taken
    assert ticks[251].was_taken
    assert ticks[100].last.dq_rad_s.tolist() == arm.sent[99].tolist()
    assert np.abs(arm.sent[201:251]).max() <= 4.9e-3 + 1e-9  # one step from rest
    assert np.abs(arm.sent[400]).max() > 0.01


def test_a_real_arm_without_a_force_limit_does_not_move():
    arm = PlainArm(is_real=True)
    with pytest.raises(SettingError, match="force"):
        next(arm.run())
    assert not arm.sent

    assert next(arm.run(without_force_limit=True)).situation is None


def test_a_real_arm_without_a_limit_of_the_jerk_does_not_move():
    arm = PlainArm(is_real=True)
    sample = next(iter(arm))
    limits = Limits(arm.robot)
    with pytest.raises(SettingError, match="jerk"):
        Controller(arm.robot, limits).update(sample, DOWN)


def test_an_arm_rests_in_states_that_do_not_move_and_at_the_force_limit():
    arm = PlainArm(is_real=True)
    manager, sensor = new_manager(SafetyLimits(axial_N=2.0))
    sensor.tared = True
    states = []
    for number, tick in enumerate(arm.run(manager)):
        tick.tasks = DOWN
        if number == 100:
            assert manager.request("insert") == ""
        if number == 400:
            sensor.reads(in_contact=True, axial=2.5)
        states.append(tick.situation.state)

    assert np.abs(arm.sent[:100]).max() == 0.0
    assert np.abs(arm.sent[399]).max() > 0.01
    assert states[401] == "stopped"
    assert np.abs(arm.sent[500:]).max() == 0.0
    assert "2.50 N" in manager.events[-1].data["reason"]


@pytest.mark.parametrize("refused", [range(300, 400), ()])
def test_an_arm_that_is_held_or_refuses_is_a_fault(refused):
    """It refuses commands for 6 ms, or takes them and stands."""
    arm = PlainArm(refused)
    manager, sensor = new_manager()
    sensor.tared = True
    stood_rad = []
    for number, tick in enumerate(arm.run(manager)):
        tick.tasks = DOWN
        if number == 100:
            assert manager.request("insert") == ""
        if number >= 300 and not refused:
            stood_rad.append(arm.q_rad)
            tick.sample.q_rad = arm.q_rad = stood_rad[0]
        if tick.situation.state == "faulted":
            break

    assert 300 < number < 600
    assert ("refused" if refused else "not commanded") in tick.situation.reason or (
        "follow" in tick.situation.reason
    )


def test_what_a_haptic_device_sends_reaches_the_manager():
    arm = PlainArm()
    manager, sensor = new_manager(SafetyLimits(axial_N=2.0))
    sensor.tared = True
    refused = []
    reports = {}
    for number, tick in enumerate(arm.run(manager)):
        if number > 100:
            place_m = np.full(3, 0.1 * (number > 250) + 0.1 * (number >= 400))
            sample = MasterReading(1e-3 * number, place_m, np.zeros(3), True)
            if not 250 <= number <= 300:
                reports[number] = tick.check_handle(sample)
        if number in (100, 200):
            refused.append(manager.request("teleoperate"))

    assert reports[200].reading is not None
    assert reports[301].doubt == ""  # where it went while nobody asked is no jump
    assert "jumped" in reports[400].doubt
    assert "no haptic device" in refused[0]
    assert refused[1] == ""


def test_faults_of_a_program_pass_through():
    class Faulty(TipVelocity):
        def write(self, *_):
            raise KeyError("a bug")

    ticks = PlainArm().run()
    next(ticks).tasks = [Faulty((0.0, 0.0, 0.0))]
    with pytest.raises(KeyError):
        next(ticks)
