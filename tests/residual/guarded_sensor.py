"""A tared sensor, the samples that come next, and what may be done to them."""

import numpy as np
import pytest

from residual import DEFAULT, VirtualForceSensor
from tests.residual.residual_signals import BIAS, external_torque_of, swing

NOISE = {"q": 1e-5, "dq": 2e-4, "tau": 0.03}
WITH_OR_WITHOUT = pytest.mark.parametrize("with_velocity", [True, False])


def at(joint, value):
    """A value at one joint, zero at the others."""
    return value * (np.arange(7) == joint)


def signals(robot, seconds, *, middle=None, noisy=True, start=0.0, amplitude=0.03):
    """Free motion with the noise of a good arm."""
    _, *clean = swing(
        robot, seconds=seconds, amplitude=amplitude, middle=middle, start=start
    )
    rng = np.random.default_rng(0)
    clean[2] = clean[2] - BIAS[: robot.nv]
    return tuple(
        value + noisy * std * rng.normal(size=value.shape)
        for value, std in zip(clean, NOISE.values(), strict=True)
    )


def rows_of(q, dq, tau):
    """Arguments of `update`, sample by sample; dq is None for a robot that sends
    none."""
    return list(zip(q, [None] * len(q) if dq is None else dq, tau, strict=True))


def tared(robot, config=DEFAULT, *, with_velocity=True, more=1.0, **kinds):
    """A tared sensor and the samples that come next."""
    q, dq, tau = signals(robot, 2.0 + more, **kinds)
    rows = rows_of(q, dq if with_velocity else None, tau)
    key = robot, config, with_velocity, more, *map(str, kinds.values())
    sensor = VirtualForceSensor(robot, config)
    if key not in TARED:
        feed(sensor, rows[:2000])
        sensor.tare()
        TARED[key] = sensor.snapshot()
    sensor.restore(TARED[key])
    return sensor, rows[2000:]


TARED = {}  # states of sensors that were tared before, by all that they depend on


def feed(sensor, rows, dt_s=1e-3):
    return [sensor.update(*row, dt_s) for row in rows]


def feed_external(sensor, rows, dt_s=1e-3):
    return [sensor.update_external_torque(*row, dt_s) for row in rows]


def changed(rows, which, change, first=0, last=None):
    """Samples of which one signal is changed from the first to before the last."""
    rows = [list(row) for row in rows]
    for row in rows[first:last]:
        row[which] = change(row[which])
    return rows


def pushed(robot, rows, force_N, first=0):
    """Samples under a force at the tip, in base axes, from the first on."""
    return [
        (q, dq, tau - external_torque_of(robot, q, force_N) * (k >= first))
        for k, (q, dq, tau) in enumerate(rows)
    ]


def held(values, samples, rng=None):
    """A slower source: every value comes several times; with a generator, one time
    more or less."""
    more = 0 if rng is None else rng.integers(-1, 2, size=len(values))
    lengths = np.full(len(values), samples) + more
    first = np.repeat(np.cumsum(lengths) - lengths, lengths)
    return values[first[: len(values)]]
