"""A loop that oscillates or that limits hold back is seen, and stopped."""

import math
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from needleforce.control import (
    AxialSpeed,
    Controller,
    DecoupledMotion,
    Fixture,
    Limits,
    Posture,
    RemoteCentre,
    SettingError,
)
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
HOME_rad = np.array([0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0])
DT_s = 1e-3
FAILED = ("oscillates", "at limit", "singular", "no progress", "skipped")


class Run(NamedTuple):
    """What a simulated loop has done.

    Attributes:
        status: Of the last command.
        reason: Of the last command.
        time_s: When it ended.
        tip_m: Positions of the tip.
        commands_rad_s: Of all cycles.
    """

    status: str
    reason: str
    time_s: float
    tip_m: np.ndarray
    commands_rad_s: np.ndarray


def tasks_of(kind, tool, gain_per_s, step_m):
    """Return a stack whose goal lies aside by a step."""
    tip_m = tool.tip_m
    aside_m = step_m * tool.rotation[:, 0]
    if kind == "centre":
        centre = RemoteCentre(tip_m - 0.08 * tool.axis + aside_m, gain_per_s)
        return [centre, AxialSpeed(0.0), Posture(HOME_rad)]
    if kind == "fixture":
        fixture = Fixture(tip_m + aside_m, tool.rotation, gain_per_s)
        return [fixture, AxialSpeed(5e-3), Posture(HOME_rad)]
    if kind == "posture":
        return [Posture(HOME_rad + step_m, gain_per_s)]
    motion = DecoupledMotion(tool, gain_per_s)
    motion.goal_m = tip_m + aside_m
    return [motion, Posture(HOME_rad)]


class Loop(NamedTuple):
    """A loop about an arm that answers late.

    Attributes:
        kind: See `tasks_of`.
        gain_per_s: Of the first task.
        late_cycles: Cycles from a command to the position that shows it.
        step_m: How far aside the goal lies at first.
        seconds: After so long it ends.
        limits: None for the usual ones.
        hand: Returns how far [rad] it holds the joints from where they are commanded.
        prepare: Changes the tasks before every cycle.
        resolution_rad: Of the encoders; zero for a fine one.
        follows: Part of a command that the arm carries out.
        delay_s: That the controller knows of.
        stops: Whether the controller stops when its loop fails.
        overwrites: Whether positions come in one array that is overwritten.
    """

    kind: str = "fixture"
    gain_per_s: float = 30.0
    late_cycles: int = 10
    step_m: float = 1e-3
    seconds: float = 0.7
    limits: Limits | None = None
    hand: Callable[[float], np.ndarray] = lambda _: np.zeros(7)
    prepare: Callable[[list, float], None] = lambda *_: None
    resolution_rad: float = 0.0
    follows: float = 1.0
    delay_s: float | None = None
    stops: bool = True
    overwrites: bool = False


def close_loop(**changes):
    """Run a loop, the usual one with changes, until it fails or its time is over."""
    loop = Loop(**changes)
    rng = np.random.default_rng(1000)
    controller = Controller(
        ROBOT,
        loop.limits or Limits(ROBOT),
        delay_s=loop.delay_s,
        stops_failed_loop=loop.stops,
    )
    tool = controller.tool
    tool.update(HOME_rad)
    tasks = tasks_of(loop.kind, tool, loop.gain_per_s, loop.step_m)
    commanded_rad = HOME_rad.copy()
    line = deque([commanded_rad] * (loop.late_cycles + 1), loop.late_cycles + 1)
    tip_m = []
    commands_rad_s = []
    array_rad = HOME_rad.copy()
    for tick in range(round(loop.seconds / DT_s)):
        line.append(commanded_rad)
        q_rad = line[0] + 1e-5 * rng.standard_normal(7) + loop.hand(tick * DT_s)
        if loop.resolution_rad:
            q_rad = loop.resolution_rad * np.round(q_rad / loop.resolution_rad)
        if loop.overwrites:
            array_rad[:] = q_rad
            q_rad = array_rad
        loop.prepare(tasks, tick * DT_s)
        sample = SimpleNamespace(q_rad=q_rad, dq_rad_s=None, tau_Nm=None, dt_s=DT_s)
        command = controller.update(sample, tasks)
        commands_rad_s.append(command.dq_rad_s)
        tip_m.append(tool.tip_m)
        if command.status in FAILED:
            break
        commanded_rad = commanded_rad + loop.follows * DT_s * command.dq_rad_s
    return Run(
        str(command.status),
        command.reason,
        tick * DT_s,
        np.array(tip_m),
        np.array(commands_rad_s),
    )


def unstable_gain(late_cycles, factor=1.5):
    """Return a gain beyond that at which a loop with held commands diverges."""
    return factor * 0.5 * math.pi / ((late_cycles + 0.5) * DT_s)


@pytest.mark.parametrize(
    ("late_cycles", "latest_s"), [(0, 0.2), (5, 0.2), (15, 0.2), (40, 0.25)]
)
@pytest.mark.parametrize("kind", ["centre", "fixture", "motion"])
def test_a_gain_too_high_for_the_delay_is_an_oscillation(kind, late_cycles, latest_s):
    gain_per_s = unstable_gain(late_cycles)
    run = close_loop(kind=kind, gain_per_s=gain_per_s, late_cycles=late_cycles)

    assert run.status == "oscillates"
    assert "gain_per_s" in run.reason
    assert run.time_s < latest_s + 2.0 * DT_s * late_cycles  # the first quarter swing


@pytest.mark.parametrize("late_cycles", [15, 40])
@pytest.mark.parametrize("kind", ["centre", "fixture", "motion"])
def test_an_oscillation_of_filtered_positions_is_seen(kind, late_cycles):
    """With a limited jerk tasks act on low-passed positions, late or early by 8 ms."""
    run = close_loop(
        kind=kind,
        gain_per_s=unstable_gain(late_cycles),
        late_cycles=late_cycles,
        step_m=3e-3,
        # At a needle's speeds some of these loops settle.
        limits=Limits.of_arm(ROBOT, "lwr", speed_rad_s=10.0, tip_m_s=None),
        seconds=1.5,
    )

    assert run.status == "oscillates"
    assert run.time_s < 0.32


def test_an_oscillation_of_joints_is_seen():
    run = close_loop(kind="posture", gain_per_s=unstable_gain(10), step_m=0.02)

    assert run.status == "oscillates"


def test_positions_may_come_in_an_array_that_is_overwritten():
    run = close_loop(gain_per_s=unstable_gain(10), overwrites=True)

    assert run.status == "oscillates"


def test_tasks_may_be_made_anew_in_every_cycle():
    def prepare(tasks, _):
        goal = tasks[0]
        tasks[0] = Fixture(goal.goal_m, goal.rotation, goal.gain_per_s)

    kept = close_loop(gain_per_s=unstable_gain(10))
    remade = close_loop(gain_per_s=unstable_gain(10), prepare=prepare)

    assert remade.status == "oscillates"
    assert remade.time_s == kept.time_s


def test_swings_that_end_with_their_gain_are_no_oscillation():
    def prepare(tasks, time_s):
        if time_s > 0.08:
            tasks[0].gain_per_s = 0.0

    run = close_loop(gain_per_s=unstable_gain(10), prepare=prepare)

    assert run.status not in FAILED


@pytest.mark.parametrize("kind", ["centre", "fixture", "motion"])
@pytest.mark.parametrize("step_m", [0.01, 0.03])
@pytest.mark.parametrize("arm", ["lwr", None])
def test_an_approach_at_the_limits_is_honest(kind, step_m, arm):
    limits = Limits.of_arm(ROBOT, arm) if arm else Limits(ROBOT)
    run = close_loop(kind=kind, step_m=step_m, limits=limits)

    assert run.status not in FAILED


def shake(frequency_Hz, size_rad, rise_s):
    """Return the motion of a hand that shakes two joints, more and more."""

    def hand(time_s):
        joints_rad = np.zeros(7)
        swing = math.sin(2.0 * math.pi * frequency_Hz * time_s)
        joints_rad[[0, 3]] = size_rad * min(time_s / rise_s, 1.0) * swing
        return joints_rad

    return hand


@pytest.mark.parametrize("frequency_Hz", [4.0, 8.0, 12.0])
@pytest.mark.parametrize("rise_s", [0.01, 0.4])
def test_a_hand_that_shakes_the_arm_is_no_oscillation(frequency_Hz, rise_s):
    run = close_loop(hand=shake(frequency_Hz, 2e-3, rise_s), step_m=0.0)

    assert np.ptp(run.tip_m, axis=0).max() > 1e-3
    assert run.status not in FAILED


def test_a_known_delay_tells_a_hand_at_the_frequency_of_the_gain():
    """More and more at omega = K it looks like a loop with a longer delay."""
    hand = shake(9.5, 3e-3, 0.4)
    unknown = close_loop(hand=hand, step_m=0.0, gain_per_s=60.0)
    known = close_loop(hand=hand, step_m=0.0, gain_per_s=60.0, delay_s=0.01)

    assert unknown.status == "oscillates"
    assert known.status not in FAILED


@pytest.mark.parametrize("kind", ["centre", "fixture", "motion"])
def test_a_known_delay_bears_a_gain_that_oscillates_otherwise(kind):
    known = close_loop(kind=kind, gain_per_s=unstable_gain(10), delay_s=0.01)

    assert known.status not in FAILED


@pytest.mark.parametrize("kind", ["centre", "fixture", "motion"])
def test_an_oscillation_of_positions_predicted_too_far_is_seen(kind):
    """The controller counts on twice the delay that the arm has."""
    run = close_loop(kind=kind, gain_per_s=unstable_gain(10, 2.0), delay_s=0.02)

    assert run.status == "oscillates"
    assert run.time_s < 0.2


@pytest.mark.parametrize("kind", ["centre", "fixture", "motion"])
def test_an_approach_with_a_known_delay_is_honest(kind):
    limits = Limits.of_arm(ROBOT, "lwr")
    run = close_loop(kind=kind, step_m=0.03, limits=limits, delay_s=0.01)

    assert run.status not in FAILED


@pytest.mark.parametrize("frequency_Hz", [1.0, 5.0, 10.0])
@pytest.mark.parametrize("is_led", [False, True])
def test_a_goal_that_swings_is_no_oscillation(frequency_Hz, is_led):
    start_m = []

    def prepare(tasks, time_s):
        start_m.append(start_m[0] if start_m else tasks[0].goal_m)
        phase = 2.0 * math.pi * frequency_Hz * time_s
        tasks[0].goal_m = start_m[0] + np.array([3e-3 * math.sin(phase), 0.0, 0.0])
        if is_led:
            speed_m_s = 2.0 * math.pi * frequency_Hz * 3e-3 * math.cos(phase)
            tasks[0].rate[0] = speed_m_s

    run = close_loop(kind="motion", step_m=0.0, prepare=prepare)

    assert run.status not in FAILED


@pytest.mark.parametrize("kind", ["centre", "fixture"])
def test_steps_of_an_encoder_are_no_oscillation(kind):
    run = close_loop(kind=kind, gain_per_s=60.0, late_cycles=5, resolution_rad=1.75e-4)

    assert run.status not in FAILED


def test_starts_and_stops_are_no_oscillation():
    def prepare(tasks, time_s):
        tasks[1] = AxialSpeed(0.05 * (time_s % 0.1 < 0.05))

    run = close_loop(prepare=prepare)

    assert run.status not in FAILED


def test_a_joint_at_its_stop_holds_a_task_back():
    """The needle is asked to go on where the elbow has no way left."""
    limits = Limits(ROBOT)
    limits.joints.position_upper_rad.setflags(write=True)
    limits.joints.position_lower_rad.setflags(write=True)
    limits.joints.position_upper_rad[:] = HOME_rad + 5e-3
    limits.joints.position_lower_rad[:] = HOME_rad - 5e-3
    run = close_loop(kind="motion", step_m=0.05, limits=limits, seconds=1.0)

    assert run.status == "at limit"
    assert any(
        f"joint {name} is at its stop" in run.reason for name in ROBOT.joint_names
    )
    assert "goals within reach" in run.reason
    still = np.linalg.norm(run.tip_m - run.tip_m[-1], axis=1) > 3e-4
    stopped_s = DT_s * (np.flatnonzero(still).max() + 1)
    assert run.time_s - stopped_s < 0.25


def test_an_arm_that_does_not_follow_makes_no_progress():
    run = close_loop(kind="motion", step_m=0.1, follows=0.0)

    assert run.status == "no progress"
    assert "does not follow" in run.reason
    assert run.time_s < 0.25


def test_a_failed_loop_brakes_and_rests_until_it_is_reset():
    controller = Controller(ROBOT, Limits(ROBOT))
    controller.tool.update(HOME_rad)
    tasks = tasks_of("fixture", controller.tool, unstable_gain(10), 1e-3)
    line = deque([HOME_rad] * 11, maxlen=11)
    speeds_rad_s = []
    statuses = []
    for _ in range(500):
        sample = SimpleNamespace(q_rad=line[0], dq_rad_s=None, tau_Nm=None, dt_s=DT_s)
        command = controller.update(sample, tasks)
        line.append(line[-1] + DT_s * command.dq_rad_s)
        speeds_rad_s.append(command.dq_rad_s)
        statuses.append(str(command.status))
    changes_rad_s = np.abs(np.diff(speeds_rad_s, axis=0))

    assert statuses[-1] == "oscillates"
    assert not speeds_rad_s[-1].any()
    assert changes_rad_s.max() < 1.001 * 10.0 * DT_s  # braked within the limits

    controller.reset()
    tasks = tasks_of("fixture", controller.tool, 30.0, 1e-3)
    sample = SimpleNamespace(q_rad=line[0], dq_rad_s=None, tau_Nm=None, dt_s=DT_s)
    assert controller.update(sample, tasks).dq_rad_s.any()


def test_a_loop_may_go_on_and_only_say_so():
    run = close_loop(gain_per_s=unstable_gain(10), stops=False)

    assert run.status == "oscillates"
    assert np.abs(run.commands_rad_s[-1]).max() > 0.01


@pytest.mark.parametrize("delay_s", [-1e-3, math.nan, "x"])
def test_a_delay_that_is_none_is_refused(delay_s):
    with pytest.raises(SettingError, match="delay_s"):
        Controller(ROBOT, Limits(ROBOT), delay_s=delay_s)
