"""Commands within the limits of real arms: noise, delay, lost cycles, faults, stops."""

import math
from types import SimpleNamespace

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
from needleforce.control.joint_limits import SLACK_rad_s
from needleforce.control.tasks import ToolState
from urdf import NeedleTool, load_example, load_lwr

UR_NEEDLE = NeedleTool(
    sensor_height_m=0.0, needle_mass_kg=0.04, needle_length_m=0.15, hub_length_m=0.03
)
LWR = load_lwr(payload=NeedleTool())
ARMS = {
    "lwr": (LWR, [0.0, 0.6, 0.0, -1.4, 0.0, 1.1, 0.0]),
    "fr3": (LWR, [0.0, 0.6, 0.0, -1.4, 0.0, 1.1, 0.0]),  # its limits, other links
    "ur5e": (
        load_example("ur5e", payload=UR_NEEDLE),
        [0.0, -1.571, 1.571, -1.571, -1.571, 0.0],
    ),
}


def sample(q_rad, dt_s):
    return SimpleNamespace(q_rad=q_rad, dq_rad_s=None, tau_Nm=None, dt_s=dt_s)


def assert_within(commands_rad_s, name):
    """No tick above the limits that the arm enforces, not the controller's own."""
    limits = ARM_LIMITS[name]
    acceleration = np.diff(commands_rad_s, axis=0) / limits.cycle_s
    jerk = np.diff(acceleration, axis=0) / limits.cycle_s

    assert (np.abs(commands_rad_s) <= limits.speed_rad_s).all()
    assert (np.abs(acceleration) <= limits.acceleration_rad_s2).all()
    assert (np.abs(jerk) <= limits.jerk_rad_s3).all()


def cone(name, delay_s, rng, *, noise_rad=1e-5, lost=0.01, seconds=1.5):
    """Turn the needle by 20 degrees about an entry 10 mm behind its tip; a fault in
    the middle, and rest at the end. Return the commands of every cycle and the error
    of the axis."""
    robot, home_rad = ARMS[name]
    cycle_s = ARM_LIMITS[name].cycle_s
    control = Controller(robot, Limits.of_arm(robot, name))
    q_rad = np.array(home_rad)
    control.tool.update(q_rad)
    tool = ToolState(robot)
    tool.update(q_rad)
    axes = tool.rotation
    entry_m = tool.tip_m - 0.01 * tool.axis
    tip = TipVelocity((0.0, 0.0, 0.0), tool.tip_m, gain_per_s=10.0)
    tasks = [RemoteCentre(entry_m), tip, Posture(q_rad.copy())]
    command_rad_s = np.zeros(robot.nv)
    line = [command_rad_s] * round(delay_s / cycle_s)
    commands = [command_rad_s] * 2
    errors_m = []
    since_s = 0.0
    ticks = round(seconds / cycle_s)
    for k in range(ticks):
        angle = math.radians(20.0) * 0.5 * (1.0 - math.cos(math.pi * k / ticks))
        tip.goal_m = entry_m + 0.01 * axes @ (0.0, math.sin(angle), math.cos(angle))
        since_s += cycle_s
        if rng.random() >= lost:
            measured_rad = q_rad + noise_rad * rng.standard_normal(robot.nv)
            if 0.5 * ticks < k < 0.5 * ticks + 10:
                measured_rad[2] = np.nan
            stack = tasks if k < 0.9 * ticks else []
            command = control.update(sample(measured_rad, since_s), stack)
            command_rad_s = command.dq_rad_s
            since_s = 0.0
        commands.append(command_rad_s)
        line.append(command_rad_s)
        q_rad = q_rad + cycle_s * line.pop(0)
        tool.update(q_rad)
        lever_m = entry_m - tool.tip_m
        errors_m.append(np.linalg.norm(np.cross(tool.axis, lever_m)))
    return np.array(commands), np.array(errors_m)


@pytest.mark.parametrize("delay_s", [0.0, 0.01])
@pytest.mark.parametrize("name", ARMS)
def test_no_tick_is_above_the_limits_of_the_arm(name, delay_s):
    rng = np.random.default_rng([1, len(name)])
    commands, errors_m = cone(name, delay_s, rng)

    assert_within(commands, name)
    assert not commands[-1].any()  # at rest at the end
    assert errors_m[: round(0.45 * len(errors_m))].max() <= 25e-6


@pytest.mark.parametrize("name", ARMS)
def test_a_missed_second_does_not_step_the_command(name):
    """Samples come late by up to 20 cycles while the tip is asked to turn round."""
    robot, home_rad = ARMS[name]
    control = Controller(robot, Limits.of_arm(robot, name))
    rng = np.random.default_rng(2)
    cycle_s = ARM_LIMITS[name].cycle_s
    q_rad = np.array(home_rad)
    commands = [np.zeros(robot.nv)] * 2
    for _ in range(600):
        cycles = int(rng.integers(1, 20))
        wish = TipVelocity(rng.uniform(-0.3, 0.3, 3))
        command = control.update(sample(q_rad, cycles * cycle_s), [wish])
        commands.append(command.dq_rad_s)
        q_rad = q_rad + cycles * cycle_s * command.dq_rad_s

    assert_within(np.array(commands), name)


def test_what_was_sent_counts():
    """The next command starts from the velocity that was sent, and its change."""
    robot, home_rad = ARMS["lwr"]
    control = Controller(robot, Limits.of_arm(robot, "lwr"))
    commands = [np.zeros(7)] * 2
    for k in range(300):
        wish = TipVelocity((0.1, 0.0, 0.1))
        command = control.update(sample(np.array(home_rad), 1e-3), [wish])
        sent_rad_s = command.dq_rad_s
        if k % 3 == 0:
            sent_rad_s = commands[-1]  # the arm was given the last one again
            control.note_sent(sent_rad_s)
        commands.append(sent_rad_s)

    assert_within(np.array(commands), "lwr")
    with pytest.raises(SettingError, match="expected 7 finite numbers"):
        control.note_sent(np.zeros(6))


def test_the_tip_keeps_its_limit_of_speed():
    robot, home_rad = ARMS["lwr"]
    control = Controller(robot, Limits.of_arm(robot, "lwr", tip_m_s=0.02))
    q_rad = np.array(home_rad)
    speeds_m_s = []
    for _ in range(400):
        tasks = [TipVelocity((0.0, 0.2, 0.1))]
        velocity = control.update(sample(q_rad, 1e-3), tasks).dq_rad_s
        speeds_m_s.append(np.linalg.norm(control.tool.jacobian[:3] @ velocity))
        q_rad = q_rad + 1e-3 * velocity

    assert max(speeds_m_s) <= 0.02 + 10.0 * SLACK_rad_s
    assert speeds_m_s[-1] == pytest.approx(0.02, rel=1e-3)


@pytest.mark.slow
def test_a_joint_stops_before_its_end():
    """With limited jerk no position limit is passed, whatever drives towards it."""
    robot, home_rad = ARMS["lwr"]
    control = Controller(
        robot, Limits.of_arm(robot, "lwr", speed_rad_s=10.0, tip_m_s=None)
    )
    q_rad = np.array(home_rad)
    for _ in range(4000):
        goal = Posture(np.full(7, 9.0), gain_per_s=50.0)
        q_rad = q_rad + 1e-3 * control.update(sample(q_rad, 1e-3), [goal]).dq_rad_s

        assert (q_rad <= robot.position_upper_rad - 0.02 + 1e-6).all()

    assert q_rad == pytest.approx(robot.position_upper_rad - 0.02, abs=1e-3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"jerk_rad_s3": -1.0}, "jerk_rad_s3 is -1.0, expected positive"),
        ({"jerk_rad_s3": [1.0, 2.0]}, "one number or 7"),
        ({"tip_m_s": 0.0}, "tip_m_s is 0.0"),
        ({"cycle_s": math.nan}, "cycle_s is nan"),
    ],
)
def test_impossible_limits_are_refused(settings, message):
    with pytest.raises(SettingError, match=message):
        Limits(LWR, **settings)


def test_a_preset_needs_its_arm():
    with pytest.raises(SettingError, match="no limits of an arm 'abb', expected one"):
        Limits.of_arm(LWR, "abb")
    with pytest.raises(SettingError, match="limits of 6 joints"):
        Limits.of_arm(LWR, "ur5e")


def test_every_preset_says_where_it_comes_from():
    for limits in ARM_LIMITS.values():
        assert limits.source
        joint_counts = {len(limits.speed_rad_s), len(limits.jerk_rad_s3)}

        assert joint_counts == {len(limits.acceleration_rad_s2)}
