"""The loop that moves an arm: it rests in the end, and knows what was refused."""

import numpy as np
import pytest

from needleforce.control import Controller, Limits, SettingError, TipVelocity, run
from needleforce.devices import MasterReading
from tests.needleforce.control.late_arm import LateArm
from tests.needleforce.control.managed_session import new_manager
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
HOME_rad = [0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0]
DOWN = [TipVelocity((0.0, 0.0, -0.05))]
MAX_STEP_rad_s = 4.9e-3 + 1e-9


def make_arm(**how):
    return LateArm(ROBOT, HOME_rad, **{"ends_at": 1000} | how)


def drive(arm, manager=None, **how):
    """Yield cycles in which the arm is to move down, and their numbers."""
    controller = Controller(ROBOT, Limits.of_arm(ROBOT, "lwr"))
    for number, tick in enumerate(run(arm, controller, manager, **how)):
        tick.tasks = DOWN
        yield number, tick


def drive_tared(arm, change=lambda manager, sensor, number, tick: None):
    """Return the ticks of an insertion that begins after 100 cycles, and the manager.

    ``change`` is called in every cycle.
    """
    manager, sensor = new_manager()
    sensor.tared = True
    ticks = []
    for number, tick in drive(arm, manager):
        change(manager, sensor, number, tick)
        ticks.append(tick)
    return ticks, manager


def insert(manager, number):
    if number == 100:
        assert manager.request("insert") == ""


def test_an_arm_rests_when_its_loop_breaks_off():
    arm = make_arm()
    ticks = run(arm, Controller(ROBOT, Limits.of_arm(ROBOT, "lwr")))
    for _ in range(301):
        next(ticks).tasks = DOWN
    ticks.close()

    assert 0.01 < np.abs(arm.sent[300]).max() < 0.5
    assert np.abs(arm.sent[-1]).max() == 0.0
    assert np.abs(np.diff(arm.sent, axis=0)).max() <= MAX_STEP_rad_s
    assert len(arm.sent) < 400


def test_after_a_refusal_commands_begin_from_rest():
    arm = make_arm(refused=range(200, 250))
    ticks = [tick for _, tick in drive(arm)]

    taken = [tick.was_taken for tick in ticks]
    assert taken == [False] + [True] * 200 + [False] * 50 + [True] * 749
    assert ticks[100].last.dq_rad_s.tolist() == arm.sent[100].tolist()
    assert np.abs(arm.sent[202:252]).max() <= MAX_STEP_rad_s  # one step from rest
    assert np.abs(arm.sent[400]).max() > 0.01


def test_a_real_arm_moves_with_limits_of_force_and_jerk_only():
    arm = make_arm(is_real=True)
    with pytest.raises(SettingError, match="force"):
        next(drive(arm))
    assert len(arm.sent) == 1
    assert next(drive(arm, without_force_limit=True))[1].situation is None


def test_an_arm_rests_in_states_that_do_not_move_and_at_the_force_limit():
    def change(manager, sensor, number, tick):
        insert(manager, number)
        if number == 400:
            sensor.reads(in_contact=True, axial=2.5)

    arm = make_arm(is_real=True)
    ticks, manager = drive_tared(arm, change)

    assert np.abs(arm.sent[:101]).max() == 0.0
    assert np.abs(arm.sent[400]).max() > 0.01
    assert ticks[401].situation.state == "stopped"
    assert np.abs(arm.sent[500:]).max() == 0.0
    assert "2.50 N" in manager.events[-1].data["reason"]


@pytest.mark.parametrize(
    ("fault", "reason"),
    [({"refused": range(300, 1000)}, "refused"), ({"held_from": 300}, "command")],
)
def test_an_arm_that_is_held_or_refuses_is_a_fault(fault, reason):
    """It refuses commands for 6 ms, or takes them and stands."""
    ticks, manager = drive_tared(make_arm(**fault), lambda m, s, k, t: insert(m, k))

    assert ticks[300].situation.state == "insertion"
    assert ticks[600].situation.state == "faulted"
    assert reason in manager.events[1].data["reason"]


def test_what_a_haptic_device_sends_reaches_the_manager():
    refused = []
    reports = {}

    def change(manager, sensor, number, tick):
        place_m = np.full(3, 0.1 * (number > 250) + 0.1 * (number >= 400))
        if number > 100 and not 250 <= number <= 300:
            sample = MasterReading(1e-3 * number, place_m, np.zeros(3), True)
            reports[number] = tick.check_handle(sample)
        if number in (100, 200):
            refused.append(manager.request("teleoperate"))

    drive_tared(make_arm(), change)

    assert reports[200].reading is not None
    assert reports[301].doubt == ""  # where it went while nobody asked is no jump
    assert "jumped" in reports[400].doubt
    assert "no haptic device" in refused[0]
    assert refused[1] == ""


def test_faults_of_a_program_pass_through():
    class Faulty(TipVelocity):
        def write(self, *_):
            raise KeyError("a bug")

    ticks = drive(make_arm())
    next(ticks)[1].tasks = [Faulty((0.0, 0.0, 0.0))]
    with pytest.raises(KeyError):
        next(ticks)
