"""Measured velocities that are not the rate of positions are reported; valid ones
never are."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residual import (
    DEFAULT,
    PUBLISHED,
    SensorConfig,
    SensorWarning,
    Status,
    TareError,
    VirtualForceSensor,
)
from tests.residual.guarded_sensor import (
    changed,
    feed,
    feed_external,
    held,
    rows_of,
    signals,
)

RATE_HZ = 250.0
RATIOS = np.array([0.03, -0.8, 0.07, 1.05, 0.25, 1.8, 0.2])
"""Way of every joint in a straight stroke, in times of the stroke's."""
STROKE_RAD = 0.12
STROKE_S = 4.0
DEGREES = 180.0 / np.pi


def stroke():
    """Times, positions and velocities of a tare stroke in air: out, back and out
    again."""
    once = np.arange(round(STROKE_S * RATE_HZ)) / (STROKE_S * RATE_HZ)
    way = once**3 * (10.0 - 15.0 * once + 6.0 * once**2)
    rest = np.zeros(round(0.5 * RATE_HZ))
    s = STROKE_RAD * np.concatenate((rest, way, rest + 1, 1 - way, rest, way, rest + 1))
    ds = np.gradient(s, 1.0 / RATE_HZ)
    return np.arange(len(s)) / RATE_HZ, np.outer(s, RATIOS), np.outer(ds, RATIOS)


def shaking():
    """A fast motion of all joints, each at its own frequency up to 1.3 Hz."""
    times = np.arange(2000) / RATE_HZ
    omega = 2.0 + 0.9 * np.arange(7)
    phase = np.outer(times, omega)
    return times, 0.3 * (1.0 - np.cos(phase)), 0.3 * omega * np.sin(phase)


def reports(robot, times, q, dq):
    """Times at which velocities are reported, the last message, and the sensor."""
    sensor = VirtualForceSensor(robot, SensorConfig(guard=False))
    steps_s = np.diff(times, prepend=times[0] - 1e-3).tolist()
    found = [
        sensor.update_external_torque(*row, np.zeros(7), dt_s)
        for *row, dt_s in zip(q, dq, steps_s, strict=True)
    ]
    is_wrong = [SensorWarning.VELOCITY in e.warnings for e in found]
    return times[is_wrong], found[-1].message, sensor


def late(values, seconds):
    return values[np.maximum(np.arange(len(values)) - round(seconds * RATE_HZ), 0)]


def filtered(values, lag_s):
    gain = -np.expm1(-1.0 / (RATE_HZ * lag_s))
    return values[0] + lfilter([gain], [1.0, gain - 1.0], values - values[0], axis=0)


def differenced(q, resolution):
    q = np.round(q / resolution) * resolution
    return q, np.diff(q, axis=0, prepend=q[:1]) * RATE_HZ


def vibrating(q, dq, hertz, amplitude):
    omega = 2.0 * np.pi * hertz
    wave = amplitude * np.exp(1j * (omega * np.arange(len(q)) / RATE_HZ + 0.5))
    return q + wave.imag[:, None], dq + omega * wave.real[:, None]


def noisy(values, std):
    return values + std * np.random.default_rng(0).normal(size=values.shape)


RIGHT = {
    "as it is": lambda q, dq: (q, dq),
    "noise of good sensors": lambda q, dq: (noisy(q, 1e-5), noisy(dq, 2e-3)),
    "noise of bad encoders": lambda q, dq: (noisy(q, 1e-3), dq),
    "noise of bad velocities": lambda q, dq: (q, noisy(dq, 0.03)),
    "velocities of 0.02 rad/s": lambda q, dq: (q, np.round(dq / 0.02) * 0.02),
    "differences of a 16 bit encoder": lambda q, dq: differenced(q, 1e-4),
    "filter of 20 ms": lambda q, dq: (q, filtered(dq, 0.02)),
    "late by 20 ms": lambda q, dq: (q, late(dq, 0.02)),
    "velocities of 21 Hz": lambda q, dq: (q, held(dq, 12)),
    "both of 50 Hz": lambda q, dq: (held(q, 5), held(dq, 5)),
    "velocity off by 0.01 rad/s": lambda q, dq: (q, dq + 0.01),
    "factor of 1.2": lambda q, dq: (q, 1.2 * dq),
    "vibration of 7 Hz": lambda q, dq: vibrating(q, dq, 7.0, 5e-4),
    "vibration of 50 Hz": lambda q, dq: vibrating(q, dq, 50.0, 5e-5),
    "position that jumps": lambda q, dq: (
        q + (np.arange(len(q)) % 875 > 425)[:, None] * 0.1,
        dq,
    ),
}

WRONG = {
    "deg/s": (lambda q, dq: (q, DEGREES * dq), "2, 4"),
    "q in degrees": (lambda q, dq: (DEGREES * q, dq), "2, 4"),
    "sign": (lambda q, dq: (q, -dq), "2, 4"),
    "deg/s and sign": (lambda q, dq: (q, -DEGREES * dq), "2, 4"),
    "rpm": (lambda q, dq: (q, 30.0 / np.pi * dq), "2, 4"),
    "gear": (lambda q, dq: (q, 100.0 * dq), "2, 4"),
    "not sent": (lambda q, dq: (q, 0.0 * dq), "2, 4"),
    "no position": (lambda q, dq: (0.0 * q, 0.0 * dq + 1.0), "1, 2, 3"),
    "stale": (lambda q, dq: (q, 0.0 * dq + dq[375]), "2"),
    "late by 0.5 s": (lambda q, dq: (q, late(dq, 0.5)), "6"),
    "reversed": (lambda q, dq: (q, dq[:, ::-1]), "2"),
    "swapped": (lambda q, dq: (q, dq[:, [0, 1, 2, 5, 4, 3, 6]]), "4"),
    "one sign": (
        lambda q, dq: (q, dq * np.where(np.arange(7) == 3, -1.0, 1.0)),
        "joint 4 ",
    ),
}
SECONDS = {"swapped": 2.8, "late by 0.5 s": 6.5, "stale": 6.5}
"""Until these are reported; for those the way back is needed."""


@pytest.mark.parametrize("source", RIGHT)
@pytest.mark.parametrize("motion", [stroke, shaking])
def test_right_signals_are_never_reported(lwr, motion, source):
    times, q, dq = motion()

    assert not len(reports(lwr, times, *RIGHT[source](q, dq))[0])


def test_clock_jitter_and_gaps_are_not_reported(lwr):
    times, q, dq = stroke()
    rng = np.random.default_rng(2)
    stamps = np.maximum.accumulate(times + 5e-3 * rng.uniform(size=len(times)))
    starts = np.arange(1.0, 13.0)[:, None]
    lengths = np.tile((0.03, 0.1, 0.19, 0.4), 3)[:, None]
    is_sent = ~((times >= starts) & (times < starts + lengths)).any(axis=0)

    assert not len(reports(lwr, stamps, q, dq)[0])
    assert not len(reports(lwr, times[is_sent], q[is_sent], dq[is_sent])[0])


@pytest.mark.parametrize("kind", WRONG)
def test_wrong_velocities_are_reported_and_stay_so(lwr, kind):
    bend, joints = WRONG[kind]
    times, *motion = stroke()
    q, dq = bend(*motion)
    wrong_s, message, sensor = reports(lwr, times, q, dq)
    found = feed_external(sensor, [(q[-1], np.zeros(7), np.zeros(7))] * 1000, 0.02)

    assert 0.5 < wrong_s[0] < 0.5 + SECONDS.get(kind, 2.5)
    assert joints in message
    assert found[-1].message == message


@pytest.mark.parametrize(("config", "factor"), [(DEFAULT, DEGREES), (PUBLISHED, -1.0)])
def test_the_tare_is_refused_for_wrong_velocities(lwr, config, factor):
    sensor = VirtualForceSensor(lwr, config)
    rows = changed(rows_of(*signals(lwr, 4.1)), 1, lambda dq: factor * dq)
    before = feed(sensor, rows[:4000])[-1]
    with pytest.raises(TareError, match=r"^dq"):
        sensor.tare()
    sensor.tare(ignore_contact=True)
    after = feed(sensor, rows[4000:])[-1]

    assert [
        (e.status, SensorWarning.VELOCITY in e.warnings) for e in (before, after)
    ] == [(Status.NOT_TARED, True), (Status.OK, True)]
