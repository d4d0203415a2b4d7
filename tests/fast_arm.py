"""Valid signals that look violent: an arm at its velocity limits, hands that let go, ruptures."""

import numpy as np
import pinocchio as pin

from groundtruth import PLANT_MODELS

MOST_ACCELERATION_RAD_S2 = 40.0
"""Twice what a Panda's joints are allowed at most (docs of its interface: 7.5 to 20)."""
CLEAN = PLANT_MODELS["clean"]


def sensed(q, dq, tau, rng):
    """Signals with noise and resolution of the plant `clean`."""
    step = CLEAN.position_step_rad
    q = np.round((q + CLEAN.position_noise_std_rad * rng.normal(size=q.shape)) / step) * step
    dq = dq + CLEAN.velocity_noise_std_rad_s * rng.normal(size=q.shape)
    return q, dq, tau + np.array(CLEAN.torque_noise_std_Nm) * rng.normal(size=q.shape)


def fast_motion(robot, rng, count, middle, *, from_rest=True):
    """Sines up to each joint's velocity limit, as quick as its torques allow; q, dq, tau (m, n)."""
    most, data = robot.model.velocityLimit, robot.create_data()
    quickest = MOST_ACCELERATION_RAD_S2 / most
    omega = np.exp(rng.uniform(np.log(0.3 * quickest), np.log(quickest)))
    phase = rng.uniform(0.0, 2.0 * np.pi, robot.nv)
    t_s = 1e-3 * np.arange(-2, count + 2)[:, None]
    grown = np.clip(t_s - 0.6, 0.0, 1.0) if from_rest else 1.0
    size = grown**3 * (10.0 + grown * (6.0 * grown - 15.0))
    while True:
        q = middle + size * most / omega * np.sin(omega * t_s + phase)
        dq = np.gradient(q, 1e-3, axis=0)
        ddq = np.gradient(dq, 1e-3, axis=0)
        rows = zip(q, dq, ddq, strict=True)
        tau = np.array([pin.rnea(robot.model, data, *row) for row in rows])
        if (np.abs(tau) < 0.9 * robot.effort_limit_Nm).all():
            return q[2:-2], dq[2:-2], tau[2:-2]
        omega = 0.8 * omega


def lever(robot, q, joint, offset_m):
    """Linear Jacobian of a point of the link behind a joint, in base axes, shape (3, n)."""
    data = robot.create_data()
    pin.computeJointJacobians(robot.model, data, q)
    at = pin.SE3(np.eye(3), np.asarray(offset_m))
    jacobian = pin.getFrameJacobian(robot.model, data, int(joint), at, pin.LOCAL_WORLD_ALIGNED)
    return jacobian[:3]


def push(t_s, start_s, rise_s, hold_s, fall_s):
    """A push, 0 to 1: it comes and goes along a cosine; a fall of no time is a step."""
    rise = np.clip((t_s - start_s) / rise_s, 0.0, 1.0)
    fall = np.clip((t_s - start_s - rise_s - hold_s) / max(fall_s, 1e-9), 0.0, 1.0)
    return 0.5 * (np.cos(np.pi * fall) - np.cos(np.pi * rise))
