"""Directions that the joints hardly move: damped, and said so; exact elsewhere."""

from types import SimpleNamespace

import numpy as np
import pytest

from needleforce.control import (
    AxialSpeed,
    Controller,
    Fixture,
    Limits,
    Posture,
)
from needleforce.control.controller import CommandStatus
from needleforce.control.priority_solver import find_damping
from urdf import NeedleTool, load_example

DT_s = 1e-3
SPEED_m_s = 5e-3
UR5E = load_example("ur5e", payload=NeedleTool())


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


@pytest.mark.parametrize(("wrist_rad", "is_near"), [(-1e-3, True), (-0.2, False)])
def test_the_status_says_that_a_direction_is_damped(wrist_rad, is_near):
    _, tip_m_s, _, statuses = advance(wrist_rad, seconds=1.0)

    assert (statuses[-1] is CommandStatus.NEAR_SINGULAR) == is_near
    if not is_near:
        assert tip_m_s[-1] == pytest.approx(SPEED_m_s, rel=1e-4)


def test_strong_directions_are_not_damped():
    rng = np.random.default_rng(0)
    rows = np.linalg.qr(rng.standard_normal((7, 7)))[0][:3]

    assert find_damping(rows, np.full(3, 0.1), np.eye(7)).size == 0


def test_a_weak_direction_is_slowed_as_far_as_its_joints_would_be_too_fast():
    direction = np.array([1.0, 0.0, 0.0])
    rows = 0.05 * direction[None, :]
    slow = find_damping(rows, np.array([0.01]), np.eye(3))
    fast = find_damping(rows, np.array([0.1]), np.eye(3))

    assert slow.size == 0
    damped = np.vstack((rows, fast))
    velocity = np.linalg.lstsq(damped, np.array([0.1, 0.0]), None)[0]
    assert velocity @ direction == pytest.approx(0.4)
