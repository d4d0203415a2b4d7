"""The loop that moves an arm: it rests in the end, and knows what was refused."""

from types import SimpleNamespace

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
from tests.needleforce.control.managed_session import new_manager
from urdf import NeedleTool, load_lwr

HOME_rad = np.array([0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0])
DOWN = [TipVelocity((0.0, 0.0, -0.05))]


class PlainArm:
    """An arm that integrates what it is sent, and refuses some cycles."""

    def __init__(self, refused=(), is_real=False):
        self.is_real = is_real
        self.robot = load_lwr(payload=NeedleTool())
        self.q_rad = HOME_rad.copy()
        self.refused = refused
        self.sent = []

    def __iter__(self):
        for _ in range(1000):
            yield SimpleNamespace(
                q_rad=self.q_rad.copy(),
                dq_rad_s=np.zeros(7),
                tau_Nm=np.zeros(7),
                dt_s=1e-3,
                is_real=self.is_real,
            )

    def send(self, dq_rad_s):
        is_taken = len(self.sent) not in self.refused
        self.sent.append(np.array(dq_rad_s))
        self.q_rad = self.q_rad + 1e-3 * is_taken * dq_rad_s
        return is_taken


def controller_of(arm):
    return Controller(arm.robot, Limits.of_arm(arm.robot, "lwr"))


def test_an_arm_rests_when_its_loop_breaks_off():
    arm = PlainArm()
    controller = controller_of(arm)
    for number, tick in enumerate(run(arm, controller)):
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
    for tick in run(arm, controller_of(arm)):
        tick.tasks = DOWN
        ticks.append(tick)

    assert ticks[200].was_taken
    assert not ticks[201].was_taken
    assert ticks[251].was_taken
    assert np.abs(arm.sent[201:251]).max() <= 4.9e-3 + 1e-9  # one step from rest
    assert np.abs(arm.sent[400]).max() > 0.01


def test_a_real_arm_without_a_force_limit_does_not_move():
    arm = PlainArm(is_real=True)
    ticks = run(arm, controller_of(arm))

    with pytest.raises(SettingError, match="without a manager, which limits") as info:
        next(ticks)
    assert "without_force_limit=True" in info.value.advice
    assert not arm.sent

    allowed = run(arm, controller_of(arm), without_force_limit=True)
    assert next(allowed).situation is None


def test_an_arm_rests_in_states_that_do_not_move_and_at_the_force_limit():
    arm = PlainArm(is_real=True)
    manager, sensor = new_manager(SafetyLimits(axial_N=2.0))
    sensor.tared = True
    states = []
    for number, tick in enumerate(run(arm, controller_of(arm), manager)):
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
    assert "axial force 2.50 N" in manager.events[-1].data["reason"]


def test_what_a_haptic_device_sends_reaches_the_manager():
    arm = PlainArm()
    manager, sensor = new_manager(SafetyLimits(axial_N=2.0))
    sensor.tared = True
    refused = []
    for number, tick in enumerate(run(arm, controller_of(arm), manager)):
        if number > 100:
            tick.handle = MasterReading(1e-3 * number, np.zeros(3), np.zeros(3), True)
        if number in (100, 200):
            refused.append(manager.request("teleoperate"))

    assert "no haptic device answers" in refused[0]
    assert refused[1] == ""


@pytest.mark.parametrize("error", [TypeError, AttributeError, NameError, KeyError])
def test_faults_of_a_program_pass_through(error):
    class Faulty(TipVelocity):
        def write(self, *_):
            raise error("a bug")

    arm = PlainArm()
    with pytest.raises(error):
        controller_of(arm).update(next(iter(arm)), [Faulty((0.0, 0.0, 0.0))])


def test_a_bad_sample_is_skipped_still():
    arm = PlainArm()
    for bad in ({"q_rad": "x"}, {"dt_s": None}, {"q_rad": np.full(7, np.nan)}):
        sample = SimpleNamespace(**{**vars(next(iter(arm))), **bad})

        assert controller_of(arm).update(sample, DOWN).status == "skipped"
