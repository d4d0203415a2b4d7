"""Does the fault guard hold back valid samples? Arms at their limits, hands.

``python -m benchmarks run faults-guard --seeds 125`` counts a million samples each.
"""

from collections.abc import Callable, Mapping

import numpy as np
import pinocchio as pin

from benchmarks.insertion.signals import inverse_dynamics
from foundation.arrays import Array
from groundtruth import PLANT_MODELS
from groundtruth.motion import Stroke
from groundtruth.sensors import measured_position, measured_velocity
from residual import DEFAULT, SampleError
from residual.sample_stream import SampleStream
from urdf import Robot

Motion = tuple[Array, Array, Array]
"""Positions [rad], velocities [rad/s] and torques [Nm] of m samples at 1 kHz, each
(m, n)."""

PERIOD_s = 1e-3
MIDDLE = np.array([0.1, 0.5, -0.2, -1.5, 0.3, 1.0, 0.2])
LEARNT_s = 0.8
"""By then the guard has learnt the noise of the signals."""


def sensed(motion: Motion, rng: np.random.Generator) -> Motion:
    """Return the motion as the sensors of the plant `clean` see it."""
    level = PLANT_MODELS["clean"]
    q = measured_position(motion[0], level, rng)
    dq = measured_velocity(motion[1], level, rng)
    assert dq is not None
    return (
        q,
        dq,
        motion[2] + np.array(level.torque_noise_std_Nm) * rng.normal(size=q.shape),
    )


def fast_motion(robot: Robot, rng: np.random.Generator, count: int) -> Motion:
    """Draw sines up to each joint's velocity limit, as quick as torque allows.

    Half of them begin at rest, the others at full speed while the guard still learns.
    """
    limit_rad_s = robot.velocity_limit_rad_s
    middle = MIDDLE + rng.uniform(-0.5, 0.5, robot.nv)
    # 40 rad/s2: twice what the interface of a Panda allows its joints at most.
    quickest = 40.0 / limit_rad_s
    omega = np.exp(rng.uniform(np.log(0.3 * quickest), np.log(quickest)))
    phase = rng.uniform(0.0, 2.0 * np.pi, robot.nv)
    t_s = PERIOD_s * np.arange(-2, count + 2, dtype=np.float64)[:, None]
    start = Stroke("quintic", 0.6, 1.0, 0.0, 1.0)
    size = start.evaluate(t_s).position_m if rng.random() < 0.5 else np.ones_like(t_s)
    while True:
        q = middle + size * limit_rad_s / omega * np.sin(omega * t_s + phase)
        dq = np.gradient(q, PERIOD_s, axis=0)
        tau = inverse_dynamics(robot.model, q, dq, np.gradient(dq, PERIOD_s, axis=0))
        if (np.abs(tau) < 0.9 * robot.effort_limit_Nm).all():
            return q[2:-2], dq[2:-2], tau[2:-2]
        omega = 0.8 * omega


def slow_motion(robot: Robot, rng: np.random.Generator, count: int) -> Motion:
    """Draw a motion of a few centimetres a second."""
    middle = MIDDLE + rng.uniform(-0.5, 0.5, robot.nv)
    omega = rng.uniform(0.2, 0.6, robot.nv)
    phase = omega * PERIOD_s * np.arange(count)[:, None]
    q = middle + 0.05 * np.sin(phase)
    dq = 0.05 * omega * np.cos(phase)
    return q, dq, inverse_dynamics(robot.model, q, dq, -0.05 * omega**2 * np.sin(phase))


def hands(robot: Robot, rng: np.random.Generator, count: int) -> Motion:
    """Push the arm behind its third joint or further out with 5 to 50 N, and let go.

    The force comes within 30 to 200 ms and goes within 10 to 50 ms, in any direction.
    """
    q, dq, tau = slow_motion(robot, rng, count)
    t_s = PERIOD_s * np.arange(count)
    data = robot.create_data()
    for start_s in np.arange(LEARNT_s, t_s[-1] - 0.6, 0.6):
        joint = int(rng.integers(3, robot.nv + 1))
        offset = rng.uniform(-0.1, 0.1, 3)
        force = rng.normal(size=3)
        force *= rng.uniform(5.0, 50.0) / np.linalg.norm(force)
        rise_s, hold_s, fall_s = rng.uniform((0.03, 0.02, 0.01), (0.2, 0.2, 0.05))
        rise = np.clip((t_s - start_s) / rise_s, 0.0, 1.0)
        fall = np.clip((t_s - start_s - rise_s - hold_s) / fall_s, 0.0, 1.0)
        push = 0.5 * (np.cos(np.pi * fall) - np.cos(np.pi * rise))
        place = pin.SE3(np.eye(3), offset)
        for k in np.flatnonzero(push):
            pin.computeJointJacobians(robot.model, data, q[k])
            axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            lever = pin.getFrameJacobian(robot.model, data, joint, place, axes)[:3]
            tau[k] -= push[k] * lever.T @ force
    return q, dq, tau


KINDS: Mapping[str, Callable[[Robot, np.random.Generator, int], Motion]] = {
    "up to the velocity limits": fast_motion,
    "hands": hands,
}
"""Valid signals, by name."""


def held_back(robot: Robot, motion: Motion, *, has_velocity: bool) -> int:
    """Return how many samples of a motion the sensor would not use."""
    stream = SampleStream(robot, DEFAULT, has_velocity=has_velocity)
    missed_s = 0.0
    count = 0
    for q, dq, tau in zip(*motion, strict=True):
        try:
            stream.update(q, dq if has_velocity else None, tau, PERIOD_s + missed_s)
            missed_s = 0.0
        except SampleError:
            missed_s = missed_s + PERIOD_s
            count = count + 1
    return count
