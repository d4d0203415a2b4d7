"""Commanded motion of the arm: the needle's straight line, and free joint motion."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.interpolate import BSpline, make_interp_spline

from foundation.arrays import Array
from groundtruth.errors import MotionError
from groundtruth.motion import Stroke
from groundtruth.plant_model import TICK_s
from groundtruth.scenarios import Scenario
from urdf import Robot

LWR_POSTURE_rad = (0.2, 0.4, 0.3, -1.5, -0.2, 1.2, 0.1)
"""Where every run of the LWR starts, once `needle_down` has made it exactly vertical:
elbow bent and out of the vertical plane, tip 0.29 m above the base. Condition number of
the Jacobian 8 to 10 over 0.24 m of travel, no joint within 25 degrees of a limit."""

# Length of the joint motion after the tare stroke where there is no tissue.
FREE_MOTION_s = 20.0


# Slow sines of the free motion, with peak speeds near 0.5 rad/s.
_AMPLITUDE_rad = np.array([0.55, 0.40, 0.50, 0.45, 0.50, 0.45, 0.40])
# Incommensurate: no two periods have a small common multiple within a run.
_FREQUENCY_Hz = np.array([0.11, 0.13, 0.12, 0.14, 0.15, 0.16, 0.18])


class JointMotion(NamedTuple):
    """Commanded motion of all joints at n + 1 ticks.

    Attributes:
        q_rad: Positions, shape (n + 1, 7).
        dq_rad_s: Velocities, shape (n + 1, 7).
    """

    q_rad: Array
    dq_rad_s: Array


class InsertionPath(NamedTuple):
    """A straight line of the tool frame along its own z axis.

    Attributes:
        posture_rad: Joint positions, shape (7,), as a function of the travel [m]: a
            quintic spline through knots solved to rounding every 5 mm. Between knots
            the tip leaves the line by less than a nanometre.
        start: Placement of the tool frame in the base at travel zero.
    """

    posture_rad: BSpline
    start: pin.SE3


def needle_down(robot: Robot, posture_rad: Array) -> Array:
    """Turn a posture, tip kept in place, until the tool's z axis points straight down.

    It must do so within 90 degrees. `MotionError` if the posture cannot be reached, or
    lies outside the limits or near a singularity.
    """
    data = robot.create_data()
    pin.framesForwardKinematics(robot.model, data, posture_rad)
    tool = data.oMf[robot.tool_frame_id]
    turn = pin.Quaternion.FromTwoVectors(
        tool.rotation[:, 2], np.array([0.0, 0.0, -1.0])
    ).matrix()
    turned = reach_pose(
        robot, posture_rad, pin.SE3(turn @ tool.rotation, tool.translation)
    )
    _check_postures(robot, data, turned[None])
    return turned


def insertion_path(
    robot: Robot, start_rad: Array, travel_m: tuple[float, float]
) -> InsertionPath:
    """Plan the straight line along the tool's z axis, orientation kept.

    It is valid from the smallest to the largest travel, counted from the start, and one
    knot beyond. Each knot takes the smallest joint step from its neighbour, so the
    redundancy is resolved by least motion. `MotionError` if the line leaves the
    workspace or the joint limits, or comes near a singularity.
    """
    knot_spacing_m = 5e-3
    spline_degree = 5
    data = robot.create_data()
    pin.framesForwardKinematics(robot.model, data, start_rad)
    start = data.oMf[robot.tool_frame_id].copy()
    first_knot = int(np.floor(travel_m[0] / knot_spacing_m)) - 1
    last_knot = int(np.ceil(travel_m[1] / knot_spacing_m)) + 1
    last_knot = max(last_knot, spline_degree)
    knots = {0: start_rad}
    for indices in (range(1, last_knot + 1), range(-1, first_knot - 1, -1)):
        posture = start_rad
        for index in indices:
            offset = pin.SE3(np.eye(3), np.array([0.0, 0.0, index * knot_spacing_m]))
            posture = knots[index] = reach_pose(robot, posture, start * offset)
    indices = sorted(knots)
    postures = np.array([knots[index] for index in indices])
    _check_postures(robot, data, postures)
    travels_m = np.array(indices) * knot_spacing_m
    spline = make_interp_spline(travels_m, postures, k=spline_degree)
    return InsertionPath(spline, start)


def reach_pose(
    robot: Robot,
    posture_rad: Array,
    target: pin.SE3,
    *,
    tolerance: float = 1e-12,
    max_step_rad: float = np.inf,
) -> Array:
    """Return a posture with the tool at a place, by Newton steps of least norm.

    Args:
        robot: The arm.
        posture_rad: Where the search begins.
        target: Place of the tool frame.
        tolerance: Error that is left [m, rad].
        max_step_rad: Of a joint in a step; from far away large ones lead astray.

    Raises:
        MotionError: It is out of reach.
    """
    data = robot.create_data()
    posture = np.array(posture_rad)
    for _ in range(60):
        pin.framesForwardKinematics(robot.model, data, posture)
        error = pin.log6(data.oMf[robot.tool_frame_id].actInv(target)).vector
        if np.abs(error).max() < tolerance:
            return posture
        jacobian = pin.computeFrameJacobian(
            robot.model, data, posture, robot.tool_frame_id
        )
        step_rad = np.linalg.pinv(jacobian) @ error
        posture = posture + np.clip(step_rad, -max_step_rad, max_step_rad)
    raise MotionError(
        f"no posture reaches {target.translation.round(4)} m; start elsewhere or "
        "travel less"
    )


def _check_postures(robot: Robot, data: pin.Data, postures: Array) -> None:
    """Raise `MotionError` for a posture outside the limits or near a singularity."""
    outside = (postures < robot.position_lower_rad) | (
        postures > robot.position_upper_rad
    )
    if outside.any():
        joints = [robot.joint_names[j] for j in np.flatnonzero(outside.any(axis=0))]
        raise MotionError(
            f"the limits of {', '.join(joints)} are exceeded; start elsewhere"
        )
    for posture in postures:
        jacobian = pin.computeFrameJacobian(
            robot.model, data, posture, robot.tool_frame_id
        )
        if np.linalg.cond(jacobian) > 30.0:
            raise MotionError(
                f"the arm is nearly singular at {posture.round(2)} rad; start elsewhere"
            )


def joint_excitation(centre_rad: Array, duration_s: float) -> JointMotion:
    """Return a motion of all joints about a posture by slow sines.

    The first and the last second are at rest.
    """
    # At rest before and after the sines
    rest_s = 1.0
    # Time in which they grow and fade
    fade_s = 4.0
    time = np.arange(round(duration_s / TICK_s) + 1, dtype=np.float64) * TICK_s
    moving_s = duration_s - 2.0 * rest_s
    moving = np.clip(time - rest_s, 0.0, moving_s)
    ramp = Stroke("quintic", 0.0, fade_s, 0.0, 1.0)
    fade, fade_rate = ramp.evaluate(np.minimum(moving, moving_s - moving))
    fade_rate = np.where(moving < moving_s / 2.0, fade_rate, -fade_rate)
    angle = 2.0 * np.pi * _FREQUENCY_Hz
    sine = np.sin(moving[:, None] * angle)
    cosine = np.cos(moving[:, None] * angle)
    rate = fade_rate[:, None] * sine + fade[:, None] * angle * cosine
    at_rest = (time <= rest_s) | (time >= duration_s - rest_s)
    rate[at_rest] = 0.0
    return JointMotion(
        q_rad=centre_rad + _AMPLITUDE_rad * fade[:, None] * sine,
        dq_rad_s=_AMPLITUDE_rad * rate,
    )


def scenario_path(robot: Robot, scenario: Scenario) -> InsertionPath:
    """Plan a scenario's line from the LWR's posture at the start straight down.

    `MotionError` if the arm cannot follow it.
    """
    start = needle_down(robot, np.array(LWR_POSTURE_rad))
    motion = scenario.motion
    return insertion_path(robot, start, (0.0, motion.deepest_m - motion.start_m))


def scenario_motion(path: InsertionPath, scenario: Scenario) -> JointMotion:
    """Return a scenario's joint motion at the controller's ticks.

        q(t) = q(s(t)),  dq/dt = dq/ds ds/dt,  s the travel.

    A scenario without layers keeps its tare stroke; a motion of all joints then takes
    the place of the insertion.
    """
    motion = scenario.motion
    end_s = motion.duration_s if scenario.layers else motion.tare_end_s
    time = np.arange(round(end_s / TICK_s) + 1, dtype=np.float64) * TICK_s
    travel_m = motion.position_m(time) - motion.start_m
    q_rad = path.posture_rad(travel_m)
    dq_rad_s = path.posture_rad(travel_m, nu=1) * motion.speed_m_s(time)[:, None]
    if not scenario.layers:
        free = joint_excitation(q_rad[-1], FREE_MOTION_s)
        q_rad = np.concatenate([q_rad, free.q_rad[1:]])
        dq_rad_s = np.concatenate([dq_rad_s, free.dq_rad_s[1:]])
    return JointMotion(q_rad, dq_rad_s)
