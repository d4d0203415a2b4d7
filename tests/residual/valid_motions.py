"""Valid motions that a fault detector might hold back: arms at their limits, hands."""

import numpy as np

from benchmarks.insertion.signals import inverse_dynamics
from residual import VirtualForceSensor
from tests.residual.guarded_sensor import NOISE, feed, rows_of, signals
from tests.residual.residual_signals import MIDDLE, jacobian_of


def sensed(motion, rng):
    """The motion as good sensors see it."""
    return [
        value + std * rng.normal(size=value.shape)
        for value, std in zip(motion, NOISE.values(), strict=True)
    ]


def fast_motion(robot, rng):
    """Two seconds of sines up to each joint's velocity limit, as quick as torque
    allows."""
    limit_rad_s = robot.velocity_limit_rad_s
    middle = MIDDLE + rng.uniform(-0.5, 0.5, robot.nv)
    # 40 rad/s2: twice what the interface of a Panda allows its joints at most.
    quickest = 40.0 / limit_rad_s
    omega = np.exp(rng.uniform(np.log(0.3 * quickest), np.log(quickest)))
    phase = rng.uniform(0.0, 2.0 * np.pi, robot.nv)
    t_s = 1e-3 * np.arange(2000)[:, None]
    while True:
        wave = omega * t_s + phase
        q = middle + limit_rad_s / omega * np.sin(wave)
        dq = limit_rad_s * np.cos(wave)
        ddq = -limit_rad_s * omega * np.sin(wave)
        tau = inverse_dynamics(robot.model, q, dq, ddq)
        if (np.abs(tau) < 0.9 * robot.effort_limit_Nm).all():
            return q, dq, tau
        omega = 0.8 * omega


def hands(robot, rng):
    """Pushes on the forearm of 5 to 50 N, each within 30 ms, let go within 10 ms."""
    q, dq, tau = signals(robot, 2.0, noisy=False)
    t_s = 1e-3 * np.arange(len(q))
    for start_s in (0.8, 1.2, 1.6):
        force = rng.normal(size=3)
        force *= rng.uniform(5.0, 50.0) / np.linalg.norm(force)
        size = np.interp(t_s - start_s, [0.0, 0.03, 0.2, 0.21], [0.0, 1.0, 1.0, 0.0])
        for k in np.flatnonzero(size):
            lever = jacobian_of(robot, q[k], "lwr_link_5")[:3]
            tau[k] -= size[k] * lever.T @ force
    return q, dq, tau


KINDS = {"up to the velocity limits": fast_motion, "hands": hands}
"""Valid signals, by name."""


def held_back(robot, motion, *, has_velocity):
    """How many samples of a motion a sensor does not use."""
    q, dq, tau = motion
    sensor = VirtualForceSensor(robot)
    feed(sensor, rows_of(q, dq if has_velocity else None, tau))
    return sensor.rejected
