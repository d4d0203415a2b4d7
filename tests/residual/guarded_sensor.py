"""A tared sensor behind its guard, and the samples that come next."""

import numpy as np

from residual import DEFAULT, VirtualForceSensor
from tests.residual.residual_signals import BIAS, swing

NOISE = {"q": 1e-5, "dq": 2e-4, "tau": 0.03}


def signals(robot, seconds, *, middle=None, noisy=True, start=0.0):
    """Free motion with the noise of a good arm."""
    _, q, dq, tau = swing(
        robot, seconds=seconds, amplitude=0.03, middle=middle, start=start
    )
    rng = np.random.default_rng(0)
    tau = tau - BIAS
    if noisy:
        q, dq, tau = (
            value + NOISE[name] * rng.normal(size=value.shape)
            for name, value in (("q", q), ("dq", dq), ("tau", tau))
        )
    return q, dq, tau


def rows_of(q, dq, tau):
    """Arguments of `update`, sample by sample; dq is None for a robot that sends
    none."""
    return list(zip(q, [None] * len(q) if dq is None else dq, tau, strict=True))


def tared(robot, config=DEFAULT, *, with_velocity=True, more=1.0, **kinds):
    """A tared sensor and the samples that come next."""
    q, dq, tau = signals(robot, 2.0 + more, **kinds)
    rows = rows_of(q, dq if with_velocity else None, tau)
    key = robot, config, with_velocity, more, *map(str, kinds.values())
    if key not in TARED:
        sensor = VirtualForceSensor(robot, config)
        feed(sensor, rows[:2000])
        sensor.tare()
        TARED[key] = sensor.snapshot()
    sensor = VirtualForceSensor(robot, config)
    sensor.restore(TARED[key])
    return sensor, rows[2000:]


TARED = {}  # states of sensors that were tared before, by all that they depend on


def tared_sensor(robot, config=DEFAULT, *, with_velocity=True):
    """A sensor that was tared without noise."""
    return tared(robot, config, with_velocity=with_velocity, noisy=False, more=0.0)[0]


def feed(sensor, rows, dt_s=1e-3):
    return [sensor.update(*row, dt_s) for row in rows]
