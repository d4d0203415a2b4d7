"""Directions that the joints hardly move: damped, and said so; exact elsewhere."""

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
    TipVelocity,
)
from needleforce.control.controller import CommandStatus
from needleforce.control.priority_solver import Stack, find_damping, hierarchical
from needleforce.control.tasks import JointTask, ToolState
from urdf import NeedleTool, load_example, load_lwr

DT_s = 1e-3
SPEED_m_s = 5e-3
UR5E = load_example("ur5e", payload=NeedleTool())
UR5E_NEAR_rad = (-1.3731, 2.5762, -5.1345, -4.1269, 0.157, -1.1894)
"""Its wrist is 0.16 rad from being in line."""


def advance(wrist_rad, seconds=2.0):
    """Advance the needle on its line from a pose with such a fifth joint.

    Returns deviations from the line [m], speeds of the tip [m/s], joint velocities
    [rad/s] and statuses, tick by tick.
    """
    controller = Controller(UR5E, Limits(UR5E))
    tool = controller.tool
    q = np.array([0.0, -1.571, 1.571, -1.571, wrist_rad, 0.0])
    tool.update(q)
    start_m = tool.tip_m.copy()
    axis = tool.axis.copy()
    stack = [Fixture.here(tool, 30.0), AxialSpeed(SPEED_m_s), Posture(q.copy())]
    rows = []
    for _ in range(round(seconds / DT_s)):
        sample = SimpleNamespace(q_rad=q, dq_rad_s=None, tau_Nm=None, dt_s=DT_s)
        command = controller.update(sample, stack)
        tip_m_s = tool.jacobian[:3] @ command.dq_rad_s
        q = q + DT_s * command.dq_rad_s
        tool.update(q)
        moved_m = tool.tip_m - start_m
        aside_m = moved_m - axis * (moved_m @ axis)
        rows.append(
            (
                np.linalg.norm(aside_m),
                np.linalg.norm(tip_m_s),
                np.abs(command.dq_rad_s).max(),
                command.status,
            )
        )
    return zip(*rows, strict=True)


@pytest.mark.parametrize("wrist_rad", [-1e-4, -1e-3, -1e-2, -5e-2, -0.2])
def test_a_wrist_near_its_singularity_keeps_the_line_and_the_speed(wrist_rad):
    aside_m, tip_m_s, joint_rad_s, _ = advance(wrist_rad)

    assert max(aside_m) < 0.1e-3
    assert max(tip_m_s) < 2.0 * SPEED_m_s
    assert max(joint_rad_s) < 0.5


@pytest.mark.parametrize(("wrist_rad", "is_near"), [(-1e-2, True), (-0.2, False)])
def test_the_status_says_that_a_direction_is_damped(wrist_rad, is_near):
    _, tip_m_s, _, statuses = advance(wrist_rad, seconds=1.0)

    assert (CommandStatus.NEAR_SINGULAR in statuses) == is_near
    assert CommandStatus.SINGULAR not in statuses
    if not is_near:
        assert tip_m_s[-1] == pytest.approx(SPEED_m_s, rel=1e-4)


def test_a_wrist_in_line_says_within_0_3_s_that_the_needle_cannot_advance():
    _, _, _, statuses = advance(-1e-3, seconds=0.3)

    assert statuses[-1] is CommandStatus.SINGULAR


def test_joints_do_not_spin_against_each_other_where_the_one_between_is_at_its_stop():
    """The tip goes round an entry while a Panda's elbow, nearly straight, comes to its
    stop; the joints before and after it have nearly the same axis."""
    robot = load_example("panda", without=["panda_hand"], payload=NeedleTool())
    controller = Controller(robot, Limits.of_arm(robot, "fr3"))
    tool = controller.tool
    q = np.array([0.0, -0.785, 0.0, -0.15, 0.0, 1.2, 0.785])
    tool.update(q)
    axes = tool.rotation
    entry_m = tool.tip_m - 0.01 * tool.axis
    tip = TipVelocity((0.0, 0.0, 0.0), tool.tip_m, gain_per_s=10.0)
    tasks = [RemoteCentre(entry_m), tip, Posture(q.copy())]
    speeds_rad_s = []
    elbow_rad = []
    for k in range(4500):
        tilt = 0.0873 * min(k / 2000, 1.0) ** 2 * (3.0 - 2.0 * min(k / 2000, 1.0))
        turn = 2.0 * np.pi * k * DT_s / 4.0
        way = (np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt))
        tip.goal_m = entry_m + 0.01 * axes @ way
        command = controller.update(SimpleNamespace(q_rad=q, dt_s=DT_s), tasks)
        q = q + DT_s * command.dq_rad_s
        speeds_rad_s.append(np.abs(command.dq_rad_s).max())
        elbow_rad.append(q[3])

    assert max(elbow_rad) == pytest.approx(-0.0898, abs=1e-4)
    assert max(speeds_rad_s) < 0.5


def test_an_entry_holds_near_a_singular_pose_though_commands_act_late():
    """The tip goes round 80 mm past its entry, for which a wrist turns far."""
    controller = Controller(UR5E, Limits.of_arm(UR5E, "ur5e"))
    truth = ToolState(UR5E)
    q = np.array(UR5E_NEAR_rad)
    truth.update(q)
    axes = truth.rotation
    entry_m = truth.tip_m - 0.08 * truth.axis
    tip = TipVelocity((0.0, 0.0, 0.0), truth.tip_m, gain_per_s=10.0)
    tasks = [RemoteCentre(entry_m), tip, Posture(q.copy())]
    late = [np.zeros(6)] * 26
    errors_m = []
    for k in range(2500):
        tilt = 0.1396 * min(k / 1000, 1.0) ** 2 * (3.0 - 2.0 * min(k / 1000, 1.0))
        turn = 2.0 * np.pi * k * DT_s / 4.0
        way = (np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt))
        tip.goal_m = entry_m + 0.08 * axes @ way
        late.append(controller.update(SimpleNamespace(q_rad=q, dt_s=DT_s), tasks)[0])
        q = q + DT_s * late.pop(0)
        truth.update(q)
        errors_m.append(np.linalg.norm(np.cross(truth.axis, entry_m - truth.tip_m)))

    assert max(errors_m) < 0.15e-3


def test_strong_directions_are_not_damped():
    for motion in (1.0, 0.3, 0.1):
        assert find_damping(motion, 0.03) == 0.0


@pytest.mark.parametrize("motion", [1e-9, 1e-4, 5e-3, 0.01])
def test_a_weak_direction_is_slowed_as_far_as_its_joints_would_be_too_fast(motion):
    for error in (1e-5, 1e-3, 0.1, 10.0):
        damping = find_damping(motion, error)

        assert error * motion / (motion**2 + damping**2) <= 0.4 * (1.0 + 1e-9)


def test_a_joint_that_hardly_moves_a_task_does_not_stand_in_for_others():
    """Six joints are at their bounds; the last could go on at up to 2 rad/s."""
    rng = np.random.default_rng(4)
    task = SimpleNamespace(size=2, write=None)
    for effect in (0.0, 1e-6, 1e-3, 0.01):
        stack = Stack([task], 7)
        stack.rows[:] = rng.standard_normal((2, 7))
        stack.rows[:, 6] = effect * np.linalg.norm(stack.rows[:, :6], axis=1)
        stack.rates[:] = 0.1
        stack.bounds[:] = np.outer((-1.0, 1.0), (*[1e-3] * 6, 2.0))
        velocity, is_limited = hierarchical(stack)

        assert is_limited
        assert abs(velocity[6]) < 0.02 + 20.0 * effect


def test_joint_velocities_may_be_a_column_of_a_table():
    """Of levels solved one by one, too: the first row depends on the second."""

    class FromTable(JointTask):
        size = 3

        def velocity_at(self, q_rad):
            return np.full((3, 2), 0.1)[:, 0]

    def write(tool, rows, rates):
        rows[:] = ((1.0, 0.0, 0.0), (1.0, 0.01, 0.0))
        rates[:] = 0.0

    tasks = [SimpleNamespace(size=2, write=write), FromTable()]
    stack = Stack(tasks, 3)
    stack.bounds[:] = np.outer((-1.0, 1.0), np.ones(3))
    stack.fill(tasks, SimpleNamespace(q_rad=np.zeros(3)))
    velocity, _ = hierarchical(stack)

    assert velocity[2] == pytest.approx(0.1)


def test_without_other_joints_a_weak_one_moves():
    """It is slow, and not left out."""
    stack = Stack([SimpleNamespace(size=1, write=None)], 2)
    stack.rows[:] = (1.0, 0.05)
    stack.rates[:] = 0.1
    stack.bounds[:] = np.outer((-1.0, 1.0), (1e-3, 2.0))

    assert 0.1 < hierarchical(stack)[0][1] < 2.0


def test_a_turn_about_the_needle_moves_no_row_of_its_entry():
    """The hub is on the axis of the last joint, the entry beside the needle."""
    robot = load_lwr(payload=NeedleTool())
    tool = ToolState(robot)
    tool.update(np.array([0.1, 0.6, -0.2, -1.2, 0.3, 1.3, 0.2]))
    rows = np.zeros((2, 7))
    entry = RemoteCentre(tool.tip_m + np.array([0.03, -0.02, 0.05]))
    entry.write(tool, rows, np.zeros(2))

    assert np.abs(rows[:, 6]).max() < 1e-12
    assert np.abs(rows[:, :6]).max() > 0.1


FRANKA_SERVO_Nms = np.array([450.0, 450.0, 350.0, 350.0, 200.0, 200.0, 200.0])
"""Torque per error of velocity of a simulated Franka's joints."""


def test_a_shallow_entry_does_not_swing_on_a_servo_that_lags():
    """The tip draws a circle 10 mm past its entry; the arm is a mass that is driven by
    errors of velocity, so that its joints are late by some milliseconds, each by others
    and by what the rest does."""
    robot = load_example("panda", without=["panda_hand"], payload=NeedleTool())
    controller = Controller(robot, Limits.of_arm(robot, "fer"))
    truth = ToolState(robot)
    q = np.array([0.0, 0.0, 0.0, -1.57, 0.0, 1.57, 0.785])
    dq = np.zeros(7)
    truth.update(q)
    start_m = truth.tip_m
    axes = truth.rotation
    entry_m = start_m - 0.01 * truth.axis
    tip = TipVelocity((0.0, 0.0, 0.0), start_m, gain_per_s=10.0)
    tasks = [RemoteCentre(entry_m), tip, Posture(q.copy())]
    rows = []
    for k in range(2000):
        angle = 2.0 * np.pi * k * DT_s / 4.0
        circle_m = 3.6e-3 * np.array([1.0 - np.cos(angle), np.sin(angle), 0.0])
        tip.goal_m = start_m + axes @ circle_m
        sample = SimpleNamespace(q_rad=q, dt_s=DT_s)
        command = controller.update(sample, tasks)
        mass = pin.crba(robot.model, robot.model.createData(), q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        torque = FRANKA_SERVO_Nms * (command.dq_rad_s - dq)
        dq = dq + np.linalg.solve(mass / DT_s + np.diag(FRANKA_SERVO_Nms), torque)
        q = q + DT_s * dq
        truth.update(q)
        error_m = np.linalg.norm(np.cross(truth.axis, entry_m - truth.tip_m))
        rows.append((error_m, abs(command.dq_rad_s[6]), command.is_limited))
    errors_m, last_joint_rad_s, is_limited = zip(*rows, strict=True)

    assert max(errors_m) < 0.2e-3
    assert max(last_joint_rad_s) < 0.05
    assert np.mean(is_limited) < 0.01


def test_a_joint_at_a_limit_and_a_damped_direction_are_both_reported():
    controller = Controller(UR5E, Limits(UR5E))
    tool = controller.tool
    q = np.array([0.0, -1.571, 1.571, -1.571, -1e-3, 0.0])
    tool.update(q)
    far = TipVelocity((0.0, 0.0, 0.0), tool.tip_m + 0.1, gain_per_s=10.0)
    sample = SimpleNamespace(q_rad=q, dt_s=DT_s)
    entry = RemoteCentre(tool.tip_m - 0.01 * tool.axis)
    command = controller.update(sample, [entry, far])

    assert command.status is CommandStatus.NEAR_SINGULAR
    assert command.is_damped
    assert command.is_limited

    braking = controller.update(sample, [])

    assert not braking.is_limited
    assert not braking.is_damped


def test_a_level_that_hardly_moves_goes_along_though_each_of_its_rows_is_new():
    """Rows are new by 0.2, 0.16 and 0.16; together they move by 0.09 only."""
    new_parts = np.array([[0.2, 0.0, 0.0], [0.2, 0.16, 0.0], [0.2, 0.16, 0.16]])
    old_parts = np.diag(np.sqrt(1.0 - (new_parts**2).sum(axis=1)))
    stack = Stack([SimpleNamespace(size=3, write=None)] * 2, 7)
    stack.rows[:3, :3] = np.eye(3)
    stack.rows[3:] = np.hstack((old_parts, new_parts, np.zeros((3, 1))))
    stack.rates[:3] = (0.03, -0.03, 0.03)
    stack.bounds[:] = np.outer((-10.0, 10.0), np.ones(7))
    velocity, is_limited = hierarchical(stack)

    parts, motions, directions = np.linalg.svd(new_parts)
    errors = -parts.T @ old_parts @ stack.rates[:3]
    expected = directions.T @ (np.minimum(motions / 0.1, 1.0) ** 2 * errors / motions)
    assert motions.min() == pytest.approx(0.0903, abs=1e-4)
    assert not is_limited
    assert not stack.is_damped
    assert velocity == pytest.approx([0.03, -0.03, 0.03, *expected, 0.0], abs=1e-12)
