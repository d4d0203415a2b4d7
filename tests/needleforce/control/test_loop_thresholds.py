"""What the watch of a loop decides just below and just above each of its thresholds.

A posture is the only task, and only the first joint moves: 1 mrad is a count.
"""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from needleforce.control import AxialSpeed, Fixture, Limits, Posture
from needleforce.control.loop_watch import LoopWatch, follow_swings
from needleforce.control.priority_solver import Stack
from needleforce.control.tasks import ToolState
from urdf import NeedleTool, load_example, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
LIMITS = Limits(ROBOT).joints
DT_s = 1e-3


def watch(
    *,
    error_rad,
    second_error_rad=lambda _: 0.0,
    moved_rad=lambda _: 0.0,
    commanded_rad_s=lambda _: 0.0,
    gain_per_s=10.0,
    start_rad=None,
    direction=(1.0, 0.0),
    seconds=0.25,
    delay_s=None,
    is_limited=False,
):
    """Return how a loop fails whose errors, motions and commands are given in time.

    The error lies in a direction of the first two joints, motions are of the first one.
    """
    loop = LoopWatch(ROBOT, LIMITS, delay_s)
    start_rad = np.zeros(7) if start_rad is None else start_rad
    task = Posture(start_rad, gain_per_s)
    stack = Stack([task], 7)
    first = np.eye(7)[0]
    way = np.array([*direction, *[0.0] * 5])
    for k in range(round(seconds / DT_s)):
        q_rad = start_rad + moved_rad(k * DT_s) * first
        task.goal_rad = q_rad + error_rad(k * DT_s) * way
        task.goal_rad[1] += second_error_rad(k * DT_s)
        stack.fill([task], SimpleNamespace(q_rad=q_rad))
        failure = loop.update(
            [task],
            stack,
            q_rad,
            commanded_rad_s(k * DT_s) * first,
            DT_s,
            ahead_rad=np.zeros(7),
            is_limited=is_limited,
        )
        if failure is not None:
            return str(failure.kind)
    return ""


def shaken(ratio, omega, **changes):
    """Return what is made of an arm that swings by 20 mrad under a gain.

    Its commands would make it swing by this ratio as far, a quarter of a period later.
    """
    return watch(
        error_rad=lambda t: -0.01 * math.sin(omega * t),
        moved_rad=lambda t: 0.01 * math.sin(omega * t),
        gain_per_s=ratio * omega,
        seconds=0.6,
        **changes,
    )


@pytest.mark.parametrize(
    ("ratio", "kind"),
    [(0.75, ""), (0.80, "oscillates"), (1.40, "oscillates"), (1.47, "")],
)
def test_swings_that_commands_explain_but_for_a_seventh_are_the_loops_own(ratio, kind):
    assert shaken(ratio, 60.0) == kind


@pytest.mark.parametrize(("omega", "kind"), [(36.0, "oscillates"), (30.0, "")])
def test_an_unknown_delay_is_45_ms_at_most(omega, kind):
    """A loop that swings at omega has a delay of a quarter of its period."""
    assert shaken(1.0, omega) == kind


@pytest.mark.parametrize(("delay_s", "kind"), [(0.02, "oscillates"), (0.01, "")])
def test_a_known_delay_may_be_off_by_a_half_and_5_ms(delay_s, kind):
    """Here it is 31 ms: 1.5 times 20 and 5 ms are enough, 1.5 times 10 and 5 not."""
    assert shaken(1.0, 50.0, delay_s=delay_s) == kind


@pytest.mark.parametrize(("slope_rad_s", "kind"), [(0.16, "oscillates"), (0.21, "")])
def test_swings_beside_an_error_that_changes_by_more_than_1_4_of_them(
    slope_rad_s, kind
):
    """As in an approach at the limits; they have 20 mrad, and take some 0.15 s."""
    seen = shaken(
        1.0,
        60.0,
        second_error_rad=lambda t: slope_rad_s * t,
        commanded_rad_s=lambda t: -0.6 * math.sin(60.0 * (t - DT_s)),
        is_limited=True,
    )

    assert seen == kind


def swing(extents, swing_s=0.05, rest_s=0.0):
    """Return whether an error that swings so far, each in a time, is seen to swing."""
    extremes = np.zeros((4, 2))
    error = 0.0
    time_s = 0.0
    is_swinging = False
    for i, extent in enumerate(extents):
        for k in range(1, 11):
            sample = error + (-1) ** i * extent * k / 10
            is_swinging = follow_swings(extremes, sample, time_s + 0.1 * k * swing_s)
        error += (-1) ** i * extent
        time_s += swing_s
    if rest_s:
        is_swinging = follow_swings(extremes, error, time_s + rest_s)
    return is_swinging


def test_three_swings_are_needed():
    assert not swing((10.0, 10.0))
    assert swing((10.0, 10.0, 10.0))


@pytest.mark.parametrize("which", [1, 2])
def test_a_swing_of_less_than_0_85_of_the_one_before_decays(which):
    extents = np.full(3, 10.0)
    extents[which:] = 8.4

    assert not swing(extents)

    extents[which:] = 8.6

    assert swing(extents)


def test_a_turn_by_less_than_a_count_is_noise():
    assert not swing((0.95, 0.95, 0.95))
    assert swing((1.15, 1.15, 1.15))


def test_slower_swings_than_0_4_s_are_a_hand_or_a_goal():
    assert swing((10.0, 10.0, 10.0), swing_s=0.39)
    assert not swing((10.0, 10.0, 10.0), swing_s=0.41)


def test_an_error_that_rests_longer_than_a_swing_has_settled():
    assert swing((10.0, 10.0, 10.0), rest_s=0.045)
    assert not swing((10.0, 10.0, 10.0), rest_s=0.055)


@pytest.mark.parametrize(
    ("error_rad", "kind"), [(0.95e-3, ""), (1.1e-3, "no progress")]
)
def test_a_task_asks_for_motion_from_two_counts_on(error_rad, kind):
    """In 0.2 s at a gain of 10 / s."""
    asked_rad_s = 10.0 * error_rad

    assert (
        watch(error_rad=lambda _: error_rad, commanded_rad_s=lambda _: asked_rad_s)
        == kind
    )


@pytest.mark.parametrize(("part", "kind"), [(0.08, "no progress"), (0.12, "")])
def test_an_arm_that_moves_a_tenth_of_what_is_asked_makes_progress(part, kind):
    """10 counts are asked for in 0.2 s."""
    seen = watch(
        error_rad=lambda _: 5e-3,
        moved_rad=lambda t: part * 0.05 * t,
        commanded_rad_s=lambda _: 0.05,
    )

    assert seen == kind


@pytest.mark.parametrize(("part", "kind"), [(0.17, ""), (0.25, "no progress")])
def test_what_is_asked_for_in_the_second_half_alone_is_new(part, kind):
    seen = watch(
        error_rad=lambda t: 0.01 * (part if t < 0.1 else 1.0 - part),
        commanded_rad_s=lambda _: 0.05,
        seconds=0.205,
    )

    assert seen == kind


def at_stop(distance_rad, **changes):
    """Return what is made of a first joint so far before its stop."""
    start_rad = np.zeros(7)
    start_rad[0] = LIMITS.position_upper_rad[0] - distance_rad
    return watch(error_rad=lambda _: 5e-3, start_rad=start_rad, **changes)


def test_a_joint_within_a_milliradian_of_its_stop_is_at_it():
    assert at_stop(0.9e-3) == "at limit"
    assert at_stop(1.1e-3) == ""


def test_a_stop_counts_if_a_tenth_of_the_motion_presses_against_it():
    assert at_stop(0.0, direction=(0.11, 0.99)) == "at limit"
    assert at_stop(0.0, direction=(0.09, 0.99)) == ""


@pytest.mark.parametrize(("part", "kind"), [(0.4, "at limit"), (0.6, "")])
def test_a_task_is_served_if_half_of_what_it_asks_for_is_commanded(part, kind):
    """The arm moves by less than a tenth of what is asked, but follows its commands."""
    seen = at_stop(
        0.5e-3,
        moved_rad=lambda t: 0.08 * 0.05 * t,
        commanded_rad_s=lambda _: part * 0.05,
    )

    assert seen == kind


def free_motion_of_wrist(wrist_rad, served=0.0):
    """Return the part of an advance that a fixture leaves to the joints of a UR5e, and
    what is made of it while nothing moves and so much of it is commanded."""
    robot = load_example("ur5e", payload=NeedleTool())
    loop = LoopWatch(robot, Limits(robot).joints)
    tool = ToolState(robot)
    q_rad = np.array([0.0, -1.571, 1.571, -1.571, wrist_rad, 0.0])
    tool.update(q_rad)
    tasks = [Fixture.here(tool), AxialSpeed(5e-3), Posture(q_rad)]
    stack = Stack(tasks, 6)
    stack.fill(tasks, tool)
    failure = None
    advance = stack.rows[5]
    commanded_rad_s = served * 5e-3 * advance / (advance @ advance)
    for _ in range(250):
        failure = failure or loop.update(
            tasks,
            stack,
            q_rad,
            commanded_rad_s,
            DT_s,
            ahead_rad=np.zeros(6),
            is_limited=False,
        )
    rows = stack.rows / np.linalg.norm(stack.rows, axis=1)[:, None]
    others = rows[:5].T
    left = rows[5] - others @ np.linalg.lstsq(others, rows[5], rcond=1e-9)[0]
    return np.linalg.norm(left), failure


def test_a_pose_is_singular_where_joints_move_a_task_by_less_than_0_02():
    motion, failure = free_motion_of_wrist(-0.02)

    assert 0.01 < motion < 0.02
    assert failure.kind == "singular"
    assert "wrist_2_joint" in failure.reason

    motion, failure = free_motion_of_wrist(-0.05)

    assert 0.02 < motion < 0.05
    assert failure is None


@pytest.mark.parametrize(("served", "is_stuck"), [(0.02, True), (0.04, False)])
def test_near_a_singular_pose_a_task_stands_that_gets_less_than_0_03(served, is_stuck):
    _, failure = free_motion_of_wrist(-0.01, served)

    assert (failure is not None) == is_stuck
