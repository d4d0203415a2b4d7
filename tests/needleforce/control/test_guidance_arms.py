"""Guidance of arms of any size: damping from their masses and limits."""

from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.control.limits import ARMS
from needleforce.control import Controller, Guidance, Limits, SettingError
from needleforce.control.guidance import LWR_DAMPING_Nms, find_damping_of_arm
from needleforce.control.tasks import ToolState
from urdf import NeedleTool, load_example, load_lwr

DT_s = 1e-3
LATE_TICKS = 10
MAX_TIP_m_s = 0.25
FRICTION_Nm = 0.05
POSTURES = {
    "ur5e": np.array([0.0, -1.2, 1.6, -1.9, -1.57, 0.0]),
    "panda": np.array([0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.8]),
    "fr3": np.array([0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.8]),
    "iiwa14": np.array([0.0, 0.6, 0.0, -1.4, 0.0, 1.1, 0.0]),
}
PRESETS = ("fr3", "iiwa14")  # with limits of the jerk


def load_arm(name):
    """Return an arm, its limits, and guidance of it."""
    if name in PRESETS:
        robot = ARMS[name].load()
        limits = Limits.of_arm(robot, name, tip_m_s=MAX_TIP_m_s)
    else:
        robot = load_example(name, payload=NeedleTool())
        limits = Limits(robot, tip_m_s=MAX_TIP_m_s)
    return robot, limits, Guidance(robot, find_damping_of_arm(robot))


def lead(name, force_at, seconds=1.5):
    """Lead an arm whose torques come 10 ms late, with friction of its joints.

    ``force_at`` returns the hand's force [N] from the tip's displacement and velocity.
    Returns displacements [m], velocities [m/s] and forces [N] of the tip.
    """
    robot, limits, guidance = load_arm(name)
    controller = Controller(robot, limits)
    tool = ToolState(robot)
    q_rad = POSTURES[name].copy()
    tool.update(q_rad)
    start_m = tool.tip_m
    late = deque([np.zeros(robot.nv)] * LATE_TICKS)
    tip_m_s = np.zeros(3)
    rows = []
    for tick in range(round(seconds / DT_s)):
        force_N = force_at(tick * DT_s, tool.tip_m - start_m, tip_m_s)
        late.append(tool.jacobian[:3].T @ force_N)
        torque_Nm = late.popleft()
        torque_Nm -= np.clip(torque_Nm, -FRICTION_Nm, FRICTION_Nm)
        task = guidance.update(torque_Nm, np.full(robot.nv, 0.01), DT_s)
        sample = SimpleNamespace(q_rad=q_rad, dq_rad_s=None, tau_Nm=None, dt_s=DT_s)
        speed_rad_s = controller.update(sample, [task]).dq_rad_s
        tip_m_s = tool.jacobian[:3] @ speed_rad_s
        q_rad = q_rad + DT_s * speed_rad_s
        tool.update(q_rad)
        rows.append((tool.tip_m - start_m, tip_m_s, force_N))
    return (np.array(values) for values in zip(*rows, strict=True))


def test_the_formula_gives_an_lwr_about_what_was_found_for_it():
    damping = find_damping_of_arm(load_lwr(payload=NeedleTool()))

    ratio = damping / np.array(LWR_DAMPING_Nms)
    assert ratio.min() > 0.5
    assert ratio.max() < 2.0


@pytest.mark.parametrize("name", POSTURES)
@pytest.mark.parametrize("push_N", [5.0, 10.0, 20.0])
def test_a_hand_moves_the_needle_at_a_bounded_speed(name, push_N):
    pushed_N = np.array([0.0, push_N, 0.0])
    _, speed_m_s, _ = lead(name, lambda t, x, v: pushed_N, seconds=0.3)

    assert 0.05 < np.linalg.norm(speed_m_s, axis=1).max() < 1.05 * MAX_TIP_m_s
    assert (speed_m_s @ pushed_N).min() >= 0.0  # it never pushes back


@pytest.mark.parametrize("name", POSTURES)
def test_a_hand_of_500_N_per_m_leads_and_does_not_swing(name):
    goal_m = np.array([0.0, 0.05, 0.0])

    def pull(time_s, moved_m, speed_m_s):
        return 500.0 * (goal_m * min(time_s, 1.0) - moved_m) - 5.0 * speed_m_s

    moved_m, speed_m_s, force_N = lead(name, pull, seconds=3.0)
    assert np.linalg.norm(moved_m[-1] - goal_m) < 0.01
    assert np.abs(speed_m_s[-300:]).max() < 5e-3
    energy_J = DT_s * np.cumsum((force_N * speed_m_s).sum(axis=1))
    assert energy_J.min() > -1e-3


@pytest.mark.parametrize("name", ["ur5e", "panda"])
def test_one_number_makes_an_arm_heavier(name):
    robot = load_example(name, payload=NeedleTool())
    speeds_rad_s = []
    for scale in (1.0, 4.0):
        guidance = Guidance(robot, scale=scale)
        for _ in range(1000):
            torque_Nm = np.full(robot.nv, 3.0)
            task = guidance.update(torque_Nm, np.full(robot.nv, 0.01), DT_s)
        speeds_rad_s.append(task.velocity_rad_s)

    assert speeds_rad_s[0] == pytest.approx(4.0 * speeds_rad_s[1], rel=0.05)
    assert (speeds_rad_s[1] > 0.0).all()


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan])
def test_a_scale_that_is_not_positive_is_refused(scale):
    with pytest.raises(SettingError, match="scale"):
        Guidance(load_lwr(payload=NeedleTool()), scale=scale)
