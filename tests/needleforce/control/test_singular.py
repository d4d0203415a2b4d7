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
from needleforce.control.priority_solver import Stack, find_damping, hierarchical
from tests.needleforce.control.late_arm import LateArm, follow, smooth, turn_about_entry
from urdf import NeedleTool, load_example

DT_s = 1e-3
SPEED_m_s = 5e-3
UR5E = load_example("ur5e", payload=NeedleTool())
UR5E_HOME_rad = np.array([0.0, -1.571, 1.571, -1.571, -0.2, 0.0])
PANDA = load_example("panda", without=["panda_hand"], payload=NeedleTool())


@pytest.mark.parametrize("wrist_rad", [-1e-4, -1e-3, -1e-2, -5e-2, -0.2])
def test_a_wrist_near_its_singularity_keeps_the_line_and_the_speed(wrist_rad):
    controller = Controller(UR5E, Limits(UR5E))
    home_rad = UR5E_HOME_rad.copy()
    home_rad[4] = wrist_rad
    arm = LateArm(UR5E, home_rad)
    line = Fixture.here(arm.tool, 30.0)
    tasks = [line, AxialSpeed(SPEED_m_s), Posture(home_rad)]
    commands = follow(controller, arm, tasks, 2000)
    is_damped = any(command.is_damped for command in commands)
    joint_rad_s = np.array([command.dq_rad_s for command in commands])
    moved_m = (np.array(arm.tips_m) - line.goal_m) @ line.rotation
    tip_m_s = np.linalg.norm(np.diff(arm.tips_m, axis=0), axis=1) / DT_s

    assert np.hypot(*moved_m[:, :2].T).max() < 0.1e-3
    assert tip_m_s.max() < 2.0 * SPEED_m_s
    assert np.abs(joint_rad_s).max() < 0.5
    assert is_damped == (abs(wrist_rad) < 0.1)
    assert is_damped or tip_m_s[-1] == pytest.approx(SPEED_m_s, rel=1e-4)


def test_joints_do_not_spin_against_each_other_where_the_one_between_is_at_its_stop():
    """The tip goes round an entry while a Panda's elbow, nearly straight, comes to its
    stop; the joints before and after it have nearly the same axis."""
    arm = LateArm(PANDA, [0.0, -0.785, 0.0, -0.15, 0.0, 1.2, 0.785])
    turned = turn_about_entry(
        Controller(PANDA, Limits.of_arm(PANDA, "fr3")),
        arm,
        lambda k: (0.0873 * smooth(k / 2000), 0.5 * np.pi * k * DT_s),
        cycles=4500,
        depth_m=0.01,
    )

    assert np.max(arm.positions_rad, axis=0)[3] == pytest.approx(-0.0898, abs=1e-4)
    assert np.abs(turned.dq_rad_s).max() < 0.5


def test_an_entry_holds_near_a_singular_pose_though_commands_act_late():
    """The tip goes round 80 mm past its entry, for which a wrist turns far: it is 0.16
    rad from being in line, and the arm 26 ms late."""
    turned = turn_about_entry(
        Controller(UR5E, Limits.of_arm(UR5E, "ur5e")),
        LateArm(UR5E, (-1.3731, 2.5762, -5.1345, -4.1269, 0.157, -1.1894), 26),
        lambda k: (0.1396 * smooth(k / 1000), 0.5 * np.pi * k * DT_s),
        cycles=2500,
        depth_m=0.08,
    )

    assert turned.errors_m.max() < 0.15e-3
    assert np.abs(turned.dq_rad_s).max() < 0.5


class ServoArm(LateArm):
    """A Franka that is a mass driven by errors of velocity, so that its joints are late
    by some milliseconds, each by others and by what the rest does."""

    servo_Nms = np.array([450.0, 450.0, 350.0, 350.0, 200.0, 200.0, 200.0])
    dq_rad_s = np.zeros(7)

    def move(self, dq_rad_s):
        mass = pin.crba(PANDA.model, PANDA.create_data(), self.q_rad)
        mass = np.triu(mass) + np.triu(mass, 1).T
        torque_Nm = self.servo_Nms * (dq_rad_s - self.dq_rad_s)
        inertia = mass / DT_s + np.diag(self.servo_Nms)
        self.dq_rad_s = self.dq_rad_s + np.linalg.solve(inertia, torque_Nm)
        super().move(self.dq_rad_s)


def test_a_shallow_entry_does_not_swing_on_a_servo_that_lags():
    turned = turn_about_entry(
        Controller(PANDA, Limits.of_arm(PANDA, "fer")),
        ServoArm(PANDA, [0.0, 0.0, 0.0, -1.57, 0.0, 1.57, 0.785]),
        lambda k: (0.35 * smooth(k / 1000), 0.5 * np.pi * k * DT_s),
        cycles=2000,
        depth_m=0.01,
    )

    assert turned.errors_m.max() < 0.2e-3
    assert np.abs(turned.dq_rad_s[:, 6]).max() < 0.2
    assert np.mean(turned.is_limited) < 0.01


def test_a_joint_at_a_limit_and_a_damped_direction_are_both_reported():
    controller = Controller(UR5E, Limits(UR5E))
    q_rad = UR5E_HOME_rad.copy()
    q_rad[4] = -1e-3
    arm = LateArm(UR5E, q_rad)
    far = TipVelocity((0.0, 0.0, 0.0), arm.tool.tip_m + 0.1, gain_per_s=10.0)
    entry = RemoteCentre(arm.tool.tip_m - 0.01 * arm.tool.axis)
    command = controller.update(arm.sample(), [entry, far])
    braking = controller.update(arm.sample(), [])

    assert (command.is_damped, command.is_limited) == (True, True)
    assert (braking.is_damped, braking.is_limited) == (False, False)


@pytest.mark.parametrize("error", [1e-5, 1e-3, 0.1, 10.0])
def test_only_a_weak_direction_is_slowed_as_far_as_its_joints_would_be_too_fast(error):
    for motion in (1e-9, 1e-4, 5e-3, 0.01, 0.05, 0.1):
        damping = find_damping(motion, error)

        assert error * motion / (motion**2 + damping**2) <= max(0.4, 120.0 * motion**2)
    for motion in (0.1, 0.3, 1.0):
        assert find_damping(motion, 0.03) == 0.0


def stack_of(rows, rates, highest_rad_s):
    """Return a stack of a single level."""
    rows = np.atleast_2d(rows)
    stack = Stack([SimpleNamespace(size=len(rows), write=None)], rows.shape[1])
    stack.rows[:] = rows
    stack.rates[:] = rates
    stack.bounds[:] = np.outer((-1.0, 1.0), highest_rad_s)
    return stack


@pytest.mark.parametrize("effect", [0.0, 1e-6, 1e-3, 0.01])
def test_a_joint_that_hardly_moves_a_task_does_not_stand_in_for_others(effect):
    """Six joints are at their bounds; the last could go on at up to 2 rad/s."""
    rows = np.random.default_rng(4).standard_normal((2, 7))
    rows[:, 6] = effect * np.linalg.norm(rows[:, :6], axis=1)
    velocity, is_limited = hierarchical(stack_of(rows, 0.1, (*[1e-3] * 6, 2.0)))

    assert is_limited
    assert abs(velocity[6]) < 0.02 + 20.0 * effect


def test_without_other_joints_a_weak_one_moves():
    """It is slow, and not left out."""
    velocity, _ = hierarchical(stack_of((1.0, 0.05), 0.1, (1e-3, 2.0)))

    assert 0.1 < velocity[1] < 2.0


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
