"""Tasks, and their strict priority, for random stacks and hostile samples.

Half of the postures are within 1e-9 to 1e-2 rad of a singular one.
"""

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import nnls

from groundtruth.arm_motion import LWR_POSTURE_rad
from needleforce.control import (
    AxialSpeed,
    Controller,
    Fixture,
    JointVelocity,
    Limits,
    Posture,
    RemoteCentre,
    SettingError,
    TipVelocity,
    ToolState,
)
from needleforce.control.priority_solver import Stack, hierarchical, solve_level
from tests.needleforce.control.late_arm import LateArm, follow
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
    task = tasks_near(tool)[index]
    rows, rates = rows_of(task, tool)
    for joint, step in enumerate(1e-6 * np.eye(7)):
        ahead, behind = (rows_of(task, tool_at(q))[1] for q in (Q + step, Q - step))
        # Second order in the error itself, which turns with the tool.
        assert (behind - ahead) / 2e-6 == pytest.approx(rows[:, joint], abs=0.03)

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


LIMITS = Limits(ROBOT)
JOINTS = LIMITS.joints


def draw_tasks(tool, rng):
    """Draw two to four tasks around the tool, in any order, then a posture."""
    near = tool.tip_m + 1e-3 * rng.standard_normal(3)
    speed_m_s = 10.0 ** rng.uniform(-3.0, 0.0)
    kinds = [
        RemoteCentre(near - rng.uniform(0.02, 0.2) * tool.axis),
        Fixture(near, tool.rotation),
        TipVelocity(speed_m_s * rng.standard_normal(3)),
        AxialSpeed(speed_m_s * rng.standard_normal()),
    ]
    chosen = rng.permutation(len(kinds))[: rng.integers(2, 5)]
    goal_rad = rng.uniform(
        JOINTS.position_lower_rad - 0.5, JOINTS.position_upper_rad + 0.5
    )
    return [*(kinds[k] for k in chosen), Posture(goal_rad)]


def draw_problem(rng, is_singular):
    """Draw a tool, tasks around it, and the velocity commanded last."""
    q_rad = rng.uniform(JOINTS.position_lower_rad, JOINTS.position_upper_rad)
    if is_singular:  # near zero the LWR is stretched, or two of its axes are one
        joint = rng.choice((1, 3, 5))
        q_rad[joint] = rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-9.0, -2.0)
    tool = tool_at(q_rad)
    fraction = rng.choice((0.0, 0.01, 0.3, 1.0))
    last_rad_s = fraction * JOINTS.speed_rad_s * rng.uniform(-1.0, 1.0, 7)
    return tool, draw_tasks(tool, rng), last_rad_s


def solved(tool, tasks, last_rad_s):
    """Return a filled stack, and the velocity that serves it."""
    stack = Stack(tasks, 7)
    stack.fill(tasks, tool)
    change_rad_s = 1e-3 * JOINTS.acceleration_rad_s2
    highest_rad_s = np.minimum(last_rad_s + change_rad_s, JOINTS.speed_rad_s)
    lowest_rad_s = np.maximum(last_rad_s - change_rad_s, -JOINTS.speed_rad_s)
    stack.bounds[:] = lowest_rad_s, highest_rad_s
    return stack, hierarchical(stack)[0]


def test_lower_tasks_leave_higher_ones_what_they_get():
    rng = np.random.default_rng(7)
    for index in range(20):
        tool, tasks, last_rad_s = draw_problem(rng, is_singular=index % 2)
        _, full = solved(tool, tasks, last_rad_s)
        for levels in range(1, len(tasks)):
            stack, alone = solved(tool, tasks[:levels], last_rad_s)
            moved = stack.rows[: stack.rates.size] @ (full - alone)
            assert np.abs(moved).max() < 1e-12


def null_directions(rows):
    """Return orthonormal directions that no row sees, in columns."""
    _, sizes, turned = np.linalg.svd(rows)
    rank = np.count_nonzero(sizes > 1e-12 * sizes.max(initial=0.0))
    return np.ascontiguousarray(turned[rank:].T)


def most_gain(rows, rates, velocity, free, bounds):
    """Return by how much a level's norm can fall at most, by the dual of its QP.

    Any pushes p >= 0 of the bounds on the joints bound it: what they leave of the
    gradient can at most move every joint through its box. The pushes are the best of
    `nnls`.
    """
    missing = rates - rows @ velocity
    room = np.maximum((bounds[1] - velocity, velocity - bounds[0]), 0.0)
    ends = np.concatenate(room)
    gradient = free.T @ (rows.T @ missing)
    sides = np.hstack((free.T, -free.T))
    pushes, _ = nnls(np.vstack((sides, 1e-3 * ends)), np.append(gradient, 0.0))
    remaining = np.abs(free @ (sides @ pushes - gradient)) @ room.sum(axis=0)
    return (remaining + pushes @ ends) / max(np.linalg.norm(missing), 1e-9)


def test_no_level_could_be_better_within_what_is_left_to_it():
    rng = np.random.default_rng(3)
    for index in range(60):
        stack, velocity = solved(*draw_problem(rng, is_singular=index % 2))
        all_met = np.linalg.norm(stack.rows @ velocity - stack.rates) < 1e-9
        end = np.clip(0.0, *stack.bounds)
        above = np.zeros((0, 7))
        for rows, rates in (*stack.levels, (np.eye(7), stack.joint_velocity)):
            free = null_directions(above)
            if not free.size:
                break
            length = np.maximum(np.linalg.norm(rows, axis=1), 1e-9)
            level = rows / length[:, None], rates / length
            end = velocity if all_met else solve_level(*level, free, stack.bounds, end)
            assert most_gain(*level, end, free, stack.bounds) < 1e-7
            above = np.vstack((above, level[0]))


def hostile_sample(q_rad, rng):
    """Draw time that passes, and a sample that is late, leaps, or is none."""
    elapsed_s = float(rng.choice((1e-3, 5e-3, 0.02), p=(0.99, 0.007, 0.003)))
    dt_s = elapsed_s
    seen_rad = q_rad + 1e-5 * rng.standard_normal(7)
    kind = rng.random()
    if kind < 0.005:
        dt_s = float(rng.choice((0.0, -1.0, 1e3, np.nan)))
    elif kind < 0.01:
        seen_rad = seen_rad + 0.05 * rng.standard_normal(7)
    elif kind < 0.015:
        seen_rad = seen_rad[:3] if kind < 0.0125 else np.full(7, np.nan)
    return elapsed_s, SimpleNamespace(q_rad=seen_rad, dt_s=dt_s)


def test_hostile_samples_pass_no_limit_and_get_an_answer():
    rng = np.random.default_rng(7)
    control = Controller(ROBOT, LIMITS)
    q_rad = np.array(LWR_POSTURE_rad)
    last_rad_s = np.zeros(7)
    step_s = 1e-3
    for tick in range(500):
        if tick % 200 == 0:
            tasks = draw_tasks(tool_at(q_rad), rng)
        elapsed_s, sample = hostile_sample(q_rad, rng)
        last_step_s = step_s
        step_s = min(sample.dt_s, 0.02) if sample.dt_s > 0.0 else step_s
        q_rad = q_rad + elapsed_s * last_rad_s
        dq_rad_s = control.update(sample, tasks).dq_rad_s
        change_rad_s = JOINTS.acceleration_rad_s2 * max(step_s, last_step_s)

        # A number that is not finite fails, too.
        assert (np.abs(dq_rad_s) <= ROBOT.velocity_limit_rad_s).all()
        assert (np.abs(dq_rad_s - last_rad_s) <= change_rad_s).all()
        assert (q_rad >= ROBOT.position_lower_rad).all()
        assert (q_rad <= ROBOT.position_upper_rad).all()

        last_rad_s = dq_rad_s


@pytest.mark.parametrize("has_jerk", [False, True])
@pytest.mark.parametrize("is_lost", [False, True])
def test_without_tasks_or_samples_it_brakes(has_jerk, is_lost):
    """Without tasks or with bad samples the arm brakes to rest."""
    control = Controller(ROBOT, Limits(ROBOT, jerk_rad_s3=2e3 if has_jerk else None))
    arm = LateArm(ROBOT, Q)
    started = follow(control, arm, [AxialSpeed(0.05)], 50)
    if is_lost:
        arm.q_rad = np.full(7, np.nan)
    braked = follow(control, arm, [], 200)
    speeds_rad_s = [
        np.abs(command.dq_rad_s).max() for command in (started[-1], *braked)
    ]

    assert {bool(command.reason) for command in braked} == {is_lost}
    assert speeds_rad_s[0] > 0.02
    assert np.diff(speeds_rad_s).min() >= -0.011
    assert speeds_rad_s[-1] == 0.0


def test_a_command_says_whether_a_limit_is_in_the_way():
    control = Controller(ROBOT, Limits(ROBOT))
    sample = LateArm(ROBOT, Q).sample()

    assert not control.update(sample, [AxialSpeed(1e-4)]).is_limited
    assert control.update(sample, [AxialSpeed(1.0)]).is_limited


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
        assert command.reason
        assert not command.dq_rad_s.any()
