"""Tasks, limits and strict priority."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.control import priority as control_priority
from benchmarks.jobs import Job
from benchmarks.judging import TARGETS
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
from needleforce.control.tasks import JointVelocity, MAX_STEP_s, ToolState
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
Q = np.array([0.1, 0.6, -0.2, -1.2, 0.3, 1.3, 0.2])


def figures_of(case, seed):
    """Numbers of a case of the benchmark."""
    job = Job(benchmark="control-priority", case=case, plant="clean", seed=seed)
    return control_priority.run(job)


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
    turn = DecoupledMotion(tool, 1.0)
    turn.goal_m = tool.tip_m + off
    turn.rotation = turned
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


@pytest.mark.slow
def test_leaks_and_hostile_ticks_stay_within_targets(monkeypatch):
    """Leaks into higher tasks and hostile ticks stay within their targets."""
    monkeypatch.setattr(control_priority, "STACKS", 60)
    monkeypatch.setattr(control_priority, "TICKS", 2000)
    limits = {target.metric: target.at_most for target in TARGETS}
    for case in ("leak", "hostile"):
        measurements = list(figures_of(case, 7))
        assert len(measurements) >= 4
        for item in measurements:
            assert item.method == "published" or item.value <= limits[item.metric], item


def test_without_tasks_or_samples_it_brakes():
    """Without tasks or with bad samples the arm brakes within its limits."""
    control = Controller(ROBOT, Limits(ROBOT))
    q = Q.copy()
    for _ in range(50):
        q = (
            q
            + 1e-3
            * control.update(ArmSample(1e-3, q, None, q), [AxialSpeed(0.05)]).dq_rad_s
        )

    moving = np.abs(control.last_rad_s).max()
    lost = control.update(ArmSample(1e-3, np.full(7, np.nan), None, q), [])

    assert lost.status == "skipped"
    assert np.isfinite(lost.dq_rad_s).all()

    bad = control.update(
        ArmSample(1e-3, np.full(7, np.nan), None, q), [AxialSpeed(0.05)]
    )

    assert bad.status == "skipped"
    assert moving - np.abs(bad.dq_rad_s).max() > 0.005

    for _ in range(200):
        command = control.update(ArmSample(1e-3, q, None, q), [])

    assert command.status == "braking"
    assert not command.dq_rad_s.any()


def test_decoupled_motion_turns_without_moving_the_tip():
    """A turn that is asked for does not move the tip."""
    control = Controller(ROBOT, Limits(ROBOT))
    q = Q.copy()
    control.tool.update(q)
    start_m = control.tool.tip_m
    motion = DecoupledMotion(control.tool)
    for _ in range(500):
        motion.move(control.tool, np.zeros(3), (0.1, 0.0, 0.0), 1e-3)
        command = control.update(ArmSample(1e-3, q, None, q), [motion, Posture(Q)])
        q = q + 1e-3 * command.dq_rad_s

    tool = tool_at(q)

    assert np.linalg.norm(pin.log3(tool.rotation @ tool_at(Q).rotation.T)) > 0.03
    assert np.linalg.norm(tool.tip_m - start_m) < 1e-4


def test_pauses_move_no_goal_away():
    """Neither a pause nor an invalid time step moves the goal far away."""
    tool = tool_at(Q)
    motion = DecoupledMotion(tool)
    for dt_s, most_m in (
        (np.nan, 0.0),
        (-1.0, 0.0),
        (5.0, 0.03 * MAX_STEP_s),
        (1e-3, 1e-3),
    ):
        before_m = motion.goal_m
        motion.move(tool, (0.0, 0.0, 0.03), np.zeros(3), dt_s)
        assert np.linalg.norm(motion.goal_m - before_m) <= 1.001 * most_m

    assert motion.goal_m[2] > tool.tip_m[2]


def test_tasks_without_equality_are_served_too():
    @dataclass
    class Push:
        wish: np.ndarray
        size: int = 3

        def write(self, tool, rows, rates):
            rows[:] = tool.jacobian[:3]
            rates[:] = self.wish

    control = Controller(ROBOT, Limits(ROBOT))
    sample = ArmSample(1e-3, Q, None, Q)
    for _ in range(3):
        command = control.update(sample, [Push(np.full(3, 1e-3))])
        assert command.status in ("ok", "saturated")


@pytest.mark.parametrize(
    "wrong",
    [{"velocity_rad_s": 100.0}, {"acceleration_rad_s2": 0.0}, {"margin_rad": 9.0}],
)
def test_limits_that_cannot_be_are_refused(wrong):
    with pytest.raises(SettingError, match="joints"):
        Limits(ROBOT, **wrong)


@pytest.mark.parametrize("margin_rad", [-1.0, np.nan, None])
def test_a_margin_that_lets_limits_pass_is_refused(margin_rad):
    with pytest.raises(SettingError, match="margin_rad is"):
        Limits(ROBOT, margin_rad=margin_rad)


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
        lambda tool: Fixture(
            tool.tip_m, tool.rotation * [1.0, 1.0, -1.0]
        ),  # left-handed
        lambda tool: DecoupledMotion(tool).move(tool, [np.nan] * 3, [0.0] * 3, 1e-3),
        lambda tool: Controller(ROBOT, Limits(ROBOT)).reset(np.full(7, np.nan)),
        lambda tool: Controller(ROBOT, Limits(ROBOT)).reset(np.zeros((7, 7))),
    ],
)
def test_an_impossible_task_or_start_is_refused(make):
    """Tasks and start velocities with invalid numbers are refused."""
    with pytest.raises(SettingError, match=r"expected|needs"):
        make(tool_at(Q))


def test_a_start_is_within_the_limits_of_speed():
    control = Controller(ROBOT, Limits(ROBOT))
    control.reset(np.full(7, 100.0))

    assert (control.last_rad_s <= ROBOT.velocity_limit_rad_s).all()


def test_bad_input_is_skipped_and_changes_nothing():
    """Invalid samples and stacks are skipped, and the pose of the tool stays."""
    control = Controller(ROBOT, Limits(ROBOT))
    good = ArmSample(1e-3, Q, None, Q)
    control.update(good, [])
    tip_m = control.tool.tip_m
    bad = (
        ArmSample(1e-3, np.full(7, np.nan), None, Q),
        ArmSample(10**400, Q, None, Q),
    )
    for sample in bad:
        assert control.update(sample, []).status == "skipped"

    for sample, stack in ((object(), []), (good, [None]), (good, 3)):
        with pytest.raises((AttributeError, TypeError)):  # a fault of the program
            control.update(sample, stack)

    short_stack = [JointVelocity([0.1]), AxialSpeed(0.0)]

    assert "1 joints" in control.update(good, short_stack).reason
    assert control.tool.tip_m.tolist() == tip_m.tolist()


def test_levels_are_those_of_a_cascade_of_qps(monkeypatch):
    monkeypatch.setattr(control_priority, "CASCADES", 60)
    values = {item.metric: item.value for item in figures_of("cascade", 3)}
    for posture in control_priority.POSTURES:
        assert values[f"cascade_gain_{posture}_rad_per_s"] < 1e-6
        assert values[f"duality_gain_{posture}_rad_per_s"] < 1e-7

    assert values["cascade_gain_regular_rad_per_s"] < 1e-8


def test_tasks_of_other_robots_are_skipped():
    """Tasks for another number of joints and goals that are no numbers are skipped."""
    control = Controller(ROBOT, Limits(ROBOT))
    sample = ArmSample(1e-3, Q, None, Q)
    short = JointVelocity(np.full(6, 1e-3))
    tasks = (
        (Posture(np.zeros(6)), "6 joints"),
        (short, "6"),
        (AxialSpeed(np.nan), "not finite"),
    )
    for task, said in tasks:
        for _ in range(3):
            command = control.update(sample, [task])
            assert command.status == "skipped"
            assert said in command.reason
