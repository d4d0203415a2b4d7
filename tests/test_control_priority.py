"""Tasks, limits and strict priority."""

import numpy as np
import pinocchio as pin
import pytest

from benchmarks import control_priority, control_speed
from groundtruth.rig_arm import ArmSample
from needleforce.control import (
    AxialSpeed,
    Controller,
    DecoupledMotion,
    Fixture,
    Limits,
    Posture,
    RemoteCentre,
    SettingError,
    Task,
    TipVelocity,
)
from needleforce.control.tasks import JointVelocity, ToolState
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
Q = np.array([0.1, 0.6, -0.2, -1.2, 0.3, 1.3, 0.2])


def tool_at(q):
    tool = ToolState(ROBOT)
    tool.update(q)
    return tool


def rows_of(task, tool):
    rows, rates = np.zeros((task.size, 7)), np.zeros(task.size)
    task.write(tool, rows, rates)
    return rows, rates


def tasks_near(tool):
    off = np.array([1e-3, -2e-3, 5e-4])
    turned = pin.exp3(np.array([0.02, -0.01, 0.03])) @ tool.rotation
    turn = DecoupledMotion(tool, 1.0)
    turn.goal_m, turn.rotation = tool.tip_m + off, turned
    return [
        RemoteCentre(tool.tip_m - 0.08 * tool.axis + off, 1.0),
        Fixture(tool.tip_m + off, turned, 1.0),
        TipVelocity(np.zeros(3), tool.tip_m + off, 1.0),
        turn,
    ]


def test_a_task_without_rows_cannot_be_made():
    with pytest.raises(TypeError, match="abstract method write"):
        type("Unfinished", (Task,), {"size": 1})()


@pytest.mark.parametrize("index", range(4))
def test_a_task_with_gain_one_is_the_rate_at_which_its_error_falls(index):
    """v is the error at gain 1, and J its negative derivative over the joints."""
    tool, step = tool_at(Q), 1e-6
    task = tasks_near(tool)[index]
    rows, rates = rows_of(task, tool)
    for joint in range(7):
        ahead, behind = (tool_at(Q + side * step * np.eye(7)[joint]) for side in (1, -1))
        slope = (rows_of(task, ahead)[1] - rows_of(task, behind)[1]) / (2.0 * step)
        # Second order in the error itself, which turns with the tool.
        assert -slope == pytest.approx(rows[:, joint], abs=0.03)
    assert np.abs(rates).max() > 1e-4


def test_leaks_stay_below_the_target_and_hostile_ticks_within_limits(monkeypatch):
    monkeypatch.setattr(control_priority, "STACKS", 60)
    monkeypatch.setattr(control_priority, "TICKS", 2000)
    for case in ("leak", "hostile"):
        figures = list(control_priority.measure(case, "clean", 7))
        assert len(figures) >= 4
        for figure in figures:
            assert figure.target is None or figure.value <= figure.target, figure


def test_without_tasks_or_with_bad_samples_it_brakes_within_limits():
    control, q = Controller(ROBOT, Limits(ROBOT)), Q.copy()
    for _ in range(50):
        q = q + 1e-3 * control.update(ArmSample(1e-3, q, None, q), [AxialSpeed(0.05)]).dq_rad_s
    moving = np.abs(control.last_rad_s).max()
    lost = control.update(ArmSample(1e-3, np.full(7, np.nan), None, q), [])
    assert (lost.status, np.isfinite(lost.dq_rad_s).all()) == ("skipped", True)
    bad = control.update(ArmSample(1e-3, np.full(7, np.nan), None, q), [AxialSpeed(0.05)])
    assert (bad.status, moving - np.abs(bad.dq_rad_s).max() > 0.005) == ("skipped", True)
    for _ in range(200):
        last = control.update(ArmSample(1e-3, q, None, q), [])
    assert last.status == "braking"
    assert not last.dq_rad_s.any()


def test_the_wish_of_decoupled_motion_turns_without_moving_the_tip():
    control, q = Controller(ROBOT, Limits(ROBOT)), Q.copy()
    control.tool.update(q)
    start_m, motion = control.tool.tip_m, DecoupledMotion(control.tool)
    for _ in range(500):
        motion.move(control.tool, np.zeros(3), (0.1, 0.0, 0.0), 1e-3)
        command = control.update(ArmSample(1e-3, q, None, q), [motion, Posture(Q)])
        q = q + 1e-3 * command.dq_rad_s
    tool = tool_at(q)
    assert np.linalg.norm(pin.log3(tool.rotation @ tool_at(Q).rotation.T)) > 0.03
    assert np.linalg.norm(tool.tip_m - start_m) < 1e-4


@pytest.mark.parametrize(
    "wrong",
    [{"velocity_rad_s": 100.0}, {"acceleration_rad_s2": 0.0}, {"margin_rad": 9.0}],
)
def test_limits_that_cannot_be_are_refused(wrong):
    with pytest.raises(SettingError, match="joints"):
        Limits(ROBOT, **wrong)


def test_cost_of_control_is_measured_beside_its_bare_calls(monkeypatch):
    monkeypatch.setattr(control_speed, "SECONDS", 1.0)
    monkeypatch.setattr(control_speed, "WARM_TICKS", 300)
    (table,), is_met = control_speed.control_speed_report(lambda part: None)
    rows = {line[0]: line for line in table.lines}
    assert float(rows["Jacobian and placement"][3]) == 1.0
    assert 1.0 < float(rows["control"][3]) < float(rows["session and control"][3])
    assert is_met == all("missed" not in line for line in table.lines)


def test_levels_are_those_of_a_cascade_of_qps(monkeypatch):
    monkeypatch.setattr(control_priority, "CASCADES", 60)
    found = {each.what: each for each in control_priority.measure("cascade", "clean", 3)}
    assert found["better in a cascade of QPs, regular"].value < 1e-8


def test_a_stack_of_another_robot_or_goals_that_are_no_numbers_are_skipped():
    control, sample = Controller(ROBOT, Limits(ROBOT)), ArmSample(1e-3, Q, None, Q)
    short = JointVelocity(np.full(6, 1e-3))
    tasks = (Posture(np.zeros(6)), "6 joints"), (short, "6"), (AxialSpeed(np.nan), "not finite")
    for task, said in tasks:
        for _ in range(3):
            command = control.update(sample, [task])
            assert (command.status, said in command.reason) == ("skipped", True)
