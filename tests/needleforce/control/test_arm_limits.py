"""Commands within the limits of real arms: noise, delay, lost cycles, faults, stops."""

import math

import numpy as np
import pytest

from needleforce.control import (
    ARM_LIMITS,
    Controller,
    Limits,
    Posture,
    RemoteCentre,
    SettingError,
    TipVelocity,
)
from tests.needleforce.control.late_arm import LateArm, follow
from urdf import NeedleTool, load_example, load_lwr

LWR = load_lwr(payload=NeedleTool())
PANDA = load_example("panda", without=["panda_hand"], payload=NeedleTool())
LWR_HOME_rad = [0.0, 0.6, 0.0, -1.4, 0.0, 1.1, 0.0]
PANDA_HOME_rad = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
ARMS = {
    "lwr": (LWR, LWR_HOME_rad),
    "iiwa14": (LWR, LWR_HOME_rad),  # its limits, other links
    "fr3": (PANDA, PANDA_HOME_rad),
    "fer": (PANDA, PANDA_HOME_rad),
    "ur5e": (
        load_example("ur5e", payload=NeedleTool()),
        [0.0, -1.571, 1.571, -1.571, -1.571, 0.0],
    ),
}


def assert_within(commands_rad_s, name):
    """No tick above the limits that the arm enforces, not the controller's own."""
    limits = ARM_LIMITS[name]
    acceleration = np.diff(commands_rad_s, axis=0) / limits.cycle_s
    jerk = np.diff(acceleration, axis=0) / limits.cycle_s

    assert (np.abs(commands_rad_s) <= limits.speed_rad_s).all()
    assert (np.abs(acceleration) <= limits.acceleration_rad_s2).all()
    assert (np.abs(jerk) <= limits.jerk_rad_s3).all()


@pytest.mark.parametrize("delay_s", [0.0, 0.01])
@pytest.mark.parametrize("name", ARMS)
def test_no_tick_is_above_the_limits_of_the_arm(name, delay_s):
    """The needle turns by 20 degrees about an entry 10 mm behind its tip; samples are
    noisy and lost, ten hold no position, and the end has no task."""
    robot, home_rad = ARMS[name]
    cycle_s = ARM_LIMITS[name].cycle_s
    ticks = round(1.5 / cycle_s)
    faults = {"lost": 0.01, "noise_rad": 1e-5, "ends_at": ticks}
    arm = LateArm(robot, home_rad, round(delay_s / cycle_s), cycle_s, **faults)
    control = Controller(robot, Limits.of_arm(robot, name))
    axes = arm.tool.rotation
    entry_m = arm.tool.tip_m - 0.01 * arm.tool.axis
    tip = TipVelocity((0.0, 0.0, 0.0), arm.tool.tip_m, gain_per_s=10.0)
    tasks = [RemoteCentre(entry_m), tip, Posture(home_rad)]
    errors_m = []
    for k, sample in enumerate(arm):
        angle = math.radians(20.0) * 0.5 * (1.0 - math.cos(math.pi * k / ticks))
        tip.goal_m = entry_m + 0.01 * axes @ (0.0, math.sin(angle), math.cos(angle))
        if 0.5 * ticks < k < 0.5 * ticks + 10:
            sample.q_rad[2] = np.nan
        command = control.update(sample, tasks if k < 0.9 * ticks else [])
        arm.send(command.dq_rad_s)
        lever_m = entry_m - arm.tool.tip_m
        errors_m.append(np.linalg.norm(np.cross(arm.tool.axis, lever_m)))
    moved_rad_s = np.diff(arm.positions_rad, axis=0, prepend=[home_rad] * 2) / cycle_s

    assert_within(moved_rad_s, name)
    assert not arm.sent[-1].any()  # at rest at the end
    assert max(errors_m[: round(0.45 * ticks)]) <= 25e-6


@pytest.mark.parametrize("name", ARMS)
def test_a_missed_second_does_not_step_the_command(name):
    """Samples come late by up to 20 cycles while the tip is asked to turn round."""
    robot, home_rad = ARMS[name]
    control = Controller(robot, Limits.of_arm(robot, name))
    rng = np.random.default_rng(2)
    arm = LateArm(robot, home_rad, dt_s=ARM_LIMITS[name].cycle_s)
    commands_rad_s = [np.zeros(robot.nv)] * 2
    for _ in range(600):
        cycles = int(rng.integers(1, 20))
        sample = arm.sample(cycles * ARM_LIMITS[name].cycle_s)
        command = control.update(sample, [TipVelocity(rng.uniform(-0.3, 0.3, 3))])
        commands_rad_s.append(command.dq_rad_s)
        for _ in range(cycles):
            arm.move(command.dq_rad_s)

    assert_within(np.array(commands_rad_s), name)


def test_the_tip_keeps_its_limit_of_speed():
    control = Controller(LWR, Limits.of_arm(LWR, "lwr", tip_m_s=0.02))
    arm = LateArm(LWR, LWR_HOME_rad)
    follow(control, arm, [TipVelocity((0.0, 0.2, 0.1))], 400)
    speeds_m_s = np.linalg.norm(np.diff(arm.tips_m, axis=0), axis=1) / 1e-3

    assert speeds_m_s.max() <= 0.02 + 1e-6
    assert speeds_m_s[-1] == pytest.approx(0.02, rel=1e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("has_jerk", [True, False])
def test_a_joint_stops_before_its_end(sign, has_jerk):
    """No position limit is passed, whatever drives towards it."""
    limits = Limits(LWR, jerk_rad_s3=2e4 if has_jerk else None)
    control = Controller(LWR, limits)
    arm = LateArm(LWR, LWR_HOME_rad)
    ends_rad = LWR.position_upper_rad if sign > 0.0 else LWR.position_lower_rad
    goal = Posture(np.full(7, 9.0 * sign), gain_per_s=50.0)
    follow(control, arm, [goal], 4000)

    assert (sign * (np.array(arm.positions_rad) - ends_rad)).max() + 0.02 <= 1e-6
    assert arm.q_rad == pytest.approx(ends_rad - 0.02 * sign, abs=1e-3)


@pytest.mark.parametrize(
    "wrong",
    [
        {"jerk_rad_s3": -1.0},
        {"jerk_rad_s3": [1.0, 2.0]},
        {"tip_m_s": 0.0},
        {"cycle_s": math.nan},
        {"velocity_rad_s": 100.0},
        {"velocity_rad_s": math.inf},
        {"velocity_rad_s": [1.0, 2.0]},
        {"acceleration_rad_s2": 0.0},
        {"acceleration_rad_s2": math.nan},
        {"margin_rad": 9.0},
        {"margin_rad": -1.0},
        {"margin_rad": None},
        {"name": "abb"},
        {"name": "ur5e"},
    ],
)
def test_impossible_limits_are_refused(wrong):
    make = Limits.of_arm if "name" in wrong else Limits
    with pytest.raises(SettingError):
        make(LWR, **wrong)


def test_limits_of_another_robot_are_refused():
    with pytest.raises(SettingError, match="6 joints"):
        Controller(LWR, Limits.of_arm(ARMS["ur5e"][0], "ur5e"))
