"""Drive the simulated arm along a motion and write down what is true at each tick."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from groundtruth.arm_plant import ArmPlant, TICK_s
from groundtruth.errors import PlantError
from groundtruth.insertion_path import InsertionPath, LWR_POSTURE_rad, insertion_path, needle_down
from groundtruth.scenarios import Scenario
from groundtruth.tissue import TissueForce
from urdf import Robot

# The arm's inner position loop: torque feed-forward and a stiff, mass-weighted PD.


Array = NDArray[np.float64]

BANDWIDTH_rad_s = 200.0
"""Natural frequency of the loop, critically damped: stiff enough that the few newtons of a rupture
move the tip by less than 0.1 mm, slow against the 1 kHz tick."""


def joint_torque(
    position_error_rad: Array,
    velocity_error_rad_s: Array,
    mass_matrix: Array,
    feed_forward_Nm: Array,
) -> Array:
    """Torque to hold over the next tick.

    The mass matrix makes all directions of the arm equally fast, whatever its posture. The loop
    reads the true joint state: it runs inside the robot on the fine motor encoders, while the
    noise of an arm level belongs to what the robot's interface reports.

    Args:
        position_error_rad: Wanted minus actual, shape (n,).
        velocity_error_rad_s: Wanted minus actual, shape (n,).
        mass_matrix: Shape (n, n), near the present posture.
        feed_forward_Nm: Torque that the motion itself takes, shape (n,).

    Returns:
        tau = tau_ff + M (w^2 e + 2 w de), shape (n,).
    """
    acceleration = (BANDWIDTH_rad_s * BANDWIDTH_rad_s) * position_error_rad
    acceleration += (2.0 * BANDWIDTH_rad_s) * velocity_error_rad_s
    return feed_forward_Nm + mass_matrix @ acceleration


# What the arm is told to do, tick by tick, and the dynamics along that motion.


MASS_TICKS = 10
"""The mass matrix is refreshed every so many ticks: the arm turns by 5 mrad meanwhile at most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointMotion:
    """Joint motion at equally spaced ticks, arrays of shape (n + 1, 7)."""

    q_rad: Array
    dq_rad_s: Array

    def then(self, other: "JointMotion") -> "JointMotion":
        """Continue with another motion that starts where this one ends."""
        return JointMotion(
            q_rad=np.concatenate([self.q_rad, other.q_rad[1:]]),
            dq_rad_s=np.concatenate([self.dq_rad_s, other.dq_rad_s[1:]]),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointReference:
    """A motion of n ticks and the dynamics along it."""

    motion: JointMotion
    feed_forward_Nm: Array
    """Torque to hold over each tick so that the arm follows the motion, shape (n, 7)."""
    mass_matrix: Array
    """Shape (ceil(n / MASS_TICKS), 7, 7)."""


def motion_along(path: InsertionPath, travel_m: Array, speed_m_s: Array) -> JointMotion:
    """Follow a straight path with a given travel over time.

    Args:
        path: The line in joint space, q(s).
        travel_m: s at each tick, shape (n + 1,).
        speed_m_s: Its rate at each tick, shape (n + 1,).

    Returns:
        q(s(t)) and dq/ds ds/dt.
    """
    slope = path.spline(travel_m, nu=1)
    return JointMotion(q_rad=path.spline(travel_m), dq_rad_s=slope * speed_m_s[:, None])


def joint_reference(model: pin.Model, motion: JointMotion, tick_s: float) -> JointReference:
    """Work out the dynamics along a motion.

    The feed-forward is the inverse dynamics at the middle of each tick with the mean acceleration
    over it: a torque held over a tick sets the mean, not the value at its start.

    Args:
        model: The true arm.
        motion: Motion at the ticks.
        tick_s: Spacing of the ticks.
    """
    q, dq = motion.q_rad, motion.dq_rad_s
    middles = zip(
        0.5 * (q[1:] + q[:-1]), 0.5 * (dq[1:] + dq[:-1]), np.diff(dq, axis=0) / tick_s, strict=True
    )
    data = model.createData()
    return JointReference(
        motion=motion,
        feed_forward_Nm=np.array([pin.rnea(model, data, *middle) for middle in middles]),
        mass_matrix=np.array([pin.crba(model, data, row).copy() for row in q[:-1:MASS_TICKS]]),
    )


_REPORT_TICKS = 500
_MAX_POSITION_ERROR_rad = 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmTrace:
    """True signals of n ticks of an arm with m joints; row k belongs to the tick's start.

    Attributes:
        q_rad: Joint positions, shape (n, m).
        dq_rad_s: Joint velocities, shape (n, m).
        tau_Nm: Joint torques held over the tick, shape (n, m).
        ft_wrench: Reading of the F/T sensor, shape (n, 6), see `ArmPlant`.
        axial_jacobian: Speed of the tip along the needle per joint velocity, shape (n + 1, m).
        depth_m: Depth of the tip, shape (n,).
        mean_axial_N: Axial force of the tissue, mean over the tick, shape (n,).
        forces: The tissue's answer, n of them.
    """

    q_rad: Array
    dq_rad_s: Array
    tau_Nm: Array
    ft_wrench: Array
    axial_jacobian: Array
    depth_m: Array
    mean_axial_N: Array
    forces: list[TissueForce]

    @property
    def speed_m_s(self) -> Array:
        """Speed of the tip along the needle, shape (n,)."""
        return np.vecdot(self.axial_jacobian[:-1], self.dq_rad_s)

    @property
    def external_torque_Nm(self) -> Array:
        """Torque of the tissue on the joints, mean over each tick, shape (n, m)."""
        middle = 0.5 * (self.axial_jacobian[:-1] + self.axial_jacobian[1:])
        return -self.mean_axial_N[:, None] * middle


def drive(
    plant: ArmPlant,
    reference: JointReference,
    progress: Callable[[float], None] | None = None,
) -> ArmTrace:
    """Let the controller follow the motion from its first sample on.

    Args:
        plant: The arm; it is placed at the start of the motion.
        reference: The motion, n ticks.
        progress: Called with the share done, 0 to 1.

    Raises:
        PlantError: The arm has lost the motion.
    """
    wanted_q, wanted_dq = reference.motion.q_rad, reference.motion.dq_rad_s
    trace = _empty_trace(*reference.feed_forward_Nm.shape)
    plant.place(wanted_q[0], wanted_dq[0])
    for k, feed_forward in enumerate(reference.feed_forward_Nm):
        error = wanted_q[k] - plant.q_rad
        torque = joint_torque(
            error,
            wanted_dq[k] - plant.dq_rad_s,
            reference.mass_matrix[k // MASS_TICKS],
            feed_forward,
        )
        if k % _REPORT_TICKS == 0:
            _check(error, k)
            if progress is not None:
                progress(k / len(reference.feed_forward_Nm))
        trace.q_rad[k], trace.dq_rad_s[k], trace.tau_Nm[k] = plant.q_rad, plant.dq_rad_s, torque
        trace.axial_jacobian[k], trace.depth_m[k] = plant.axial_jacobian, plant.depth_m
        plant.tick(torque)
        trace.ft_wrench[k], trace.mean_axial_N[k] = plant.ft_wrench, plant.mean_axial_N
        trace.forces.append(plant.tissue_force)
    trace.axial_jacobian[-1] = plant.axial_jacobian
    if progress is not None:
        progress(1.0)
    return trace


def _empty_trace(ticks: int, joints: int) -> ArmTrace:
    return ArmTrace(
        q_rad=np.empty((ticks, joints)),
        dq_rad_s=np.empty((ticks, joints)),
        tau_Nm=np.empty((ticks, joints)),
        ft_wrench=np.empty((ticks, 6)),
        axial_jacobian=np.empty((ticks + 1, joints)),
        depth_m=np.empty(ticks),
        mean_axial_N=np.empty(ticks),
        forces=[],
    )


def _check(error_rad: Array, tick: int) -> None:
    worst = np.abs(error_rad).max()
    if not worst < _MAX_POSITION_ERROR_rad:
        raise PlantError(
            f"a joint is {worst:.3g} rad off its motion at tick {tick}, expected less than "
            f"{_MAX_POSITION_ERROR_rad}; use softer tissue or a slower motion"
        )


# Free motion: all joints at once, incommensurate slow sines that start and end at rest.


# Peak speeds near 0.5 rad/s; no two periods with a small common multiple within a run.
_AMPLITUDE_rad = np.array([0.55, 0.40, 0.50, 0.45, 0.50, 0.45, 0.40])
_FREQUENCY_Hz = np.array([0.11, 0.13, 0.12, 0.14, 0.15, 0.16, 0.18])
_REST_s = 1.0
_FADE_s = 4.0


def joint_excitation(
    centre_rad: NDArray[np.float64], duration_s: float, tick_s: float
) -> JointMotion:
    """Sample the excitation.

    Args:
        centre_rad: Posture around which the joints swing, shape (7,).
        duration_s: Length of the run; a rest of 1 s at both ends is part of it.
        tick_s: Spacing of the ticks.

    Returns:
        The motion, n = duration / tick + 1 samples.
    """
    time = np.arange(round(duration_s / tick_s) + 1, dtype=np.float64) * tick_s
    moving = np.clip(time - _REST_s, 0.0, duration_s - 2.0 * _REST_s)
    fade, fade_rate = _fade(moving, duration_s - 2.0 * _REST_s)
    angle = 2.0 * np.pi * _FREQUENCY_Hz
    sine, cosine = np.sin(moving[:, None] * angle), np.cos(moving[:, None] * angle)
    rate = fade_rate[:, None] * sine + fade[:, None] * angle * cosine
    at_rest = (time <= _REST_s) | (time >= duration_s - _REST_s)
    rate[at_rest] = 0.0
    return JointMotion(
        q_rad=centre_rad + _AMPLITUDE_rad * fade[:, None] * sine, dq_rad_s=_AMPLITUDE_rad * rate
    )


def _fade(
    time: NDArray[np.float64], duration_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Quintic fade-in and fade-out between 0 and 1, and its rate."""
    edge = np.minimum(time, duration_s - time)
    x = np.clip(edge / _FADE_s, 0.0, 1.0)
    value = x**3 * (10.0 + x * (6.0 * x - 15.0))
    rate = 30.0 * x**2 * (1.0 - x) ** 2 / _FADE_s
    return value, np.where(time < duration_s / 2.0, rate, -rate)


# The joint motion of a scenario: the needle along its line, or all joints in free air.


FREE_MOTION_s = 20.0
"""Length of the joint motion that follows the tare stroke where there is no tissue."""


def scenario_path(robot: Robot, scenario: Scenario) -> InsertionPath:
    """Plan the needle's line for a scenario, from the LWR's starting posture straight down.

    Args:
        robot: The LWR with its needle.
        scenario: Gives the travel.

    Raises:
        PathError: The line is out of the arm's reach.
    """
    start = needle_down(robot, np.array(LWR_POSTURE_rad))
    motion = scenario.motion
    return insertion_path(robot, start, (0.0, motion.deepest_m - motion.start_m))


def scenario_motion(path: InsertionPath, scenario: Scenario) -> JointMotion:
    """Sample a scenario's motion at the controller's ticks.

    A scenario without layers keeps its tare stroke; a motion of all joints then takes the place
    of the insertion.

    Args:
        path: Of `scenario_path`.
        scenario: Gives the travel over time.
    """
    motion = scenario.motion
    end_s = motion.duration_s if scenario.layers else motion.tare_end_s
    time = np.arange(round(end_s / TICK_s) + 1, dtype=np.float64) * TICK_s
    along = motion_along(path, motion.position_m(time) - motion.start_m, motion.speed_m_s(time))
    if scenario.layers:
        return along
    return along.then(joint_excitation(along.q_rad[-1], FREE_MOTION_s, TICK_s))
