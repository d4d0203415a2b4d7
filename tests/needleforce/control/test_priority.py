"""Tasks, and their strict priority."""

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from needleforce.control import (
    AxialSpeed,
    Controller,
    Fixture,
    Limits,
    Posture,
    RemoteCentre,
    SettingError,
    TipVelocity,
)
from needleforce.control.tasks import JointVelocity, ToolState
from tests.needleforce.control.late_arm import LateArm
from tests.needleforce.control.priority_oracle import cascades, hostile_ticks, leaks
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
Q = np.array([0.1, 0.6, -0.2, -1.2, 0.3, 1.3, 0.2])


def tool_at(q):
    tool = ToolState(ROBOT)
    tool.update(q)
    return tool


def rows_of(task, tool):
    rows = np.zeros((task.size, 7))
    rates = np.zeros(task.size)
    task.write(tool, rows, rates)
    return rows, rates


def tasks_near(tool):
    off = np.array([1e-3, -2e-3, 5e-4])
    turned = pin.exp3(np.array([0.02, -0.01, 0.03])) @ tool.rotation
    return [
        RemoteCentre(tool.tip_m - 0.08 * tool.axis + off, 1.0),
        Fixture(tool.tip_m + off, turned, 1.0),
        TipVelocity(np.zeros(3), tool.tip_m + off, 1.0),
    ]


@pytest.mark.parametrize("index", range(3))
def test_rates_are_errors_at_gain_one(index):
    """v is the error at gain 1, and J its negative derivative over the joints."""
    tool = tool_at(Q)
    step = 1e-6
    task = tasks_near(tool)[index]
    rows, rates = rows_of(task, tool)
    for joint in range(7):
        ahead, behind = (
            tool_at(Q + side * step * np.eye(7)[joint]) for side in (1, -1)
        )
        slope = (rows_of(task, ahead)[1] - rows_of(task, behind)[1]) / (2.0 * step)
        # Second order in the error itself, which turns with the tool.
        assert -slope == pytest.approx(rows[:, joint], abs=0.03)

    assert np.abs(rates).max() > 1e-4


def test_rates_are_those_asked_for():
    tool = tool_at(Q)
    rows, rates = rows_of(AxialSpeed(0.03), tool)
    asked = rows_of(TipVelocity((0.1, 0.2, 0.3)), tool)

    assert rates.tolist() == [0.03]
    assert rows[0] == pytest.approx(tool.axis @ tool.jacobian[:3])
    assert asked[1].tolist() == [0.1, 0.2, 0.3]
    assert asked[0] == pytest.approx(tool.jacobian[:3])
    assert rows_of(Posture(Q + 0.1, 2.0), tool)[1] == pytest.approx(0.2)


def test_a_turn_about_the_needle_moves_no_row_of_its_entry():
    """The hub is on the axis of the last joint, the entry beside the needle."""
    tool = tool_at(Q)
    rows, _ = rows_of(RemoteCentre(tool.tip_m + np.array([0.03, -0.02, 0.05])), tool)

    assert np.abs(rows[:, 6]).max() < 1e-12
    assert np.abs(rows[:, :6]).max() > 0.1


def test_lower_tasks_leave_higher_ones_what_they_get():
    assert max(leaks(ROBOT, np.random.default_rng(7), 20)) < 1e-12


def test_hostile_samples_pass_no_limit_and_get_an_answer():
    over, silent = hostile_ticks(ROBOT, np.random.default_rng(7), 500)

    assert (over <= 0.0).all()
    assert silent == 0


def test_levels_are_those_of_a_cascade_of_qps():
    gains, bounds = cascades(ROBOT, np.random.default_rng(3), 60)

    assert max(gains) < 1e-6
    assert gains[0] < 1e-8
    assert max(bounds) < 1e-7


@pytest.mark.parametrize("has_jerk", [False, True])
def test_without_tasks_or_samples_it_brakes(has_jerk):
    """Without tasks or with bad samples the arm brakes to rest."""
    limits = Limits(ROBOT, jerk_rad_s3=2e3 if has_jerk else None)
    for sample_of, status in (
        (lambda arm: SimpleNamespace(q_rad=np.full(7, np.nan), dt_s=1e-3), "skipped"),
        (lambda arm: arm.sample(), "braking"),
    ):
        control = Controller(ROBOT, limits)
        arm = LateArm(ROBOT, Q)
        for _ in range(50):
            arm.move(control.update(arm.sample(), [AxialSpeed(0.05)]).dq_rad_s)
        fastest_rad_s = [np.abs(control.last_rad_s).max()]
        for _ in range(200):
            command = control.update(sample_of(arm), [])
            fastest_rad_s.append(np.abs(command.dq_rad_s).max())

        assert command.status == status
        assert fastest_rad_s[0] > 0.02
        assert np.diff(fastest_rad_s).min() >= -0.011
        assert fastest_rad_s[-1] == 0.0


def test_tasks_without_equality_are_served_too():
    class Push:
        size = 3

        def __eq__(self, other):
            raise AssertionError("compared")

        def write(self, tool, rows, rates):
            rows[:] = tool.jacobian[:3]
            rates[:] = 1e-3

    control = Controller(ROBOT, Limits(ROBOT))
    for _ in range(3):
        command = control.update(LateArm(ROBOT, Q).sample(), [Push()])
        assert command.status in ("ok", "saturated")


def test_a_status_says_whether_a_limit_is_in_the_way():
    control = Controller(ROBOT, Limits(ROBOT))
    sample = LateArm(ROBOT, Q).sample()

    assert control.update(sample, [AxialSpeed(1e-4)]).status == "ok"

    command = control.update(sample, [AxialSpeed(1.0)])

    assert command.status == "saturated"
    assert command.is_limited


@pytest.mark.parametrize(
    "make",
    [
        lambda tool: RemoteCentre([np.nan] * 3),
        lambda tool: RemoteCentre([None, 0.0, 0.0]),
        lambda tool: RemoteCentre(tool.tip_m, -30.0),
        lambda tool: TipVelocity([np.nan] * 3),
        lambda tool: TipVelocity([0.0] * 3, tool.tip_m),  # a goal without a gain
        lambda tool: Posture([np.nan] * 7),
        lambda tool: Posture(Q, np.nan),
        lambda tool: Fixture([np.nan, 0.0, 0.0], tool.rotation),
        lambda tool: Fixture(tool.tip_m, tool.rotation * [1.0, 1.0, -1.0]),  # of a left
        lambda tool: Fixture(tool.tip_m, 1.01 * tool.rotation),
    ],
)
def test_an_impossible_task_or_start_is_refused(make):
    """Tasks and start velocities with invalid numbers are refused."""
    with pytest.raises(SettingError):
        make(tool_at(Q))


@pytest.mark.parametrize(
    "bad",
    [
        {"q_rad": "x"},
        {"q_rad": np.full(7, np.nan)},
        {"q_rad": Q[:6]},
        {"dt_s": None},
        {"dt_s": 10**400},
        {"dt_s": -1e-3},
    ],
)
def test_a_bad_sample_is_skipped_and_changes_nothing(bad):
    control = Controller(ROBOT, Limits(ROBOT))
    sample = LateArm(ROBOT, Q).sample()
    control.update(sample, [])
    tip_m = control.tool.tip_m
    command = control.update(SimpleNamespace(**{**vars(sample), **bad}), [])

    assert command.status == "skipped"
    assert command.reason
    assert control.tool.tip_m.tolist() == tip_m.tolist()


@pytest.mark.parametrize(
    "tasks",
    [
        [Posture(np.zeros(6))],
        [AxialSpeed(0.0), Posture(np.zeros(6))],
        [JointVelocity(np.zeros(6)), AxialSpeed(0.0)],
        [AxialSpeed(np.nan)],
        [AxialSpeed(0.0), TipVelocity((0.0, 0.0, 0.0), [1e300] * 3, 1e300)],
    ],
)
def test_tasks_of_other_robots_are_skipped(tasks):
    """Tasks for another number of joints and goals that are no numbers are skipped."""
    control = Controller(ROBOT, Limits(ROBOT))
    for _ in range(3):
        command = control.update(LateArm(ROBOT, Q).sample(), tasks)
        assert command.status == "skipped"
        assert not command.dq_rad_s.any()


@pytest.mark.parametrize("stack", [[None], 3])
def test_faults_of_a_program_pass_through(stack):
    with pytest.raises((AttributeError, TypeError)):
        Controller(ROBOT, Limits(ROBOT)).update(LateArm(ROBOT, Q).sample(), stack)
