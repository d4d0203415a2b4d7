"""Measured velocities that are not the rate of positions are reported; valid ones
never are."""

import re
from typing import NamedTuple

import numpy as np
import pytest
from scipy.signal import lfilter

from needleforce import InsertionSession
from residual import (
    DEFAULT,
    PUBLISHED,
    SensorWarning,
    Status,
    TareError,
    VirtualForceSensor,
)
from residual.checks.velocity import first_match, velocity_fault, velocity_match_step
from tests.residual.guarded_sensor import feed, signals, tared
from tests.residual.residual_signals import BIAS

RATIOS = np.array([0.03, -0.8, 0.07, 1.05, 0.25, 1.8, 0.2])
"""Way of every joint in a straight stroke, in times of the stroke's."""
STROKE_RAD = 0.12
STROKE_S = 4.0
REST_S = 0.5
RATE_HZ = 1000.0


def stroke():
    """Times, positions and velocities of a tare stroke in air: out, back and out
    again."""
    once = np.arange(round(STROKE_S * RATE_HZ)) / (STROKE_S * RATE_HZ)
    way = once**3 * (10.0 - 15.0 * once + 6.0 * once**2)
    speed = 30.0 * once**2 * (1.0 - once) ** 2 / STROKE_S
    rest = np.zeros(round(REST_S * RATE_HZ))
    s = STROKE_RAD * np.concatenate((rest, way, rest + 1, 1 - way, rest, way, rest + 1))
    ds = STROKE_RAD * np.concatenate((rest, speed, rest, -speed, rest, speed, rest))
    return np.arange(len(s)) / RATE_HZ, np.outer(s, RATIOS), np.outer(ds, RATIOS)


def shaking():
    """A fast motion of all joints, each at its own frequency up to 1.3 Hz."""
    times = np.arange(8000) / RATE_HZ
    omega = 2.0 + 0.9 * np.arange(7)
    phase = np.outer(times, omega)
    return times, 0.3 * (1.0 - np.cos(phase)), 0.3 * omega * np.sin(phase)


class Report(NamedTuple):
    """What one check reports of the velocities."""

    time_s: float
    text: str


def reports(times, q, dq):
    """The report of every check, and the match after the last one."""
    q = np.ascontiguousarray(q)
    dq = np.ascontiguousarray(dq)
    match = first_match(q[0], dq[0])
    checked_s = times[0]
    checks = []
    for k in range(1, len(times)):
        if times[k] - checked_s > 0.02 - 1e-9:
            match = velocity_match_step(match, q[k], dq[k], times[k] - checked_s)
            checks.append(Report(times[k], velocity_fault(match)))
            checked_s = times[k]
    return checks, match


def late(values, seconds):
    return values[np.maximum(np.arange(len(values)) - round(seconds * RATE_HZ), 0)]


def held(values, rate_hz):
    steps = round(RATE_HZ / rate_hz)
    return values[np.arange(len(values)) // steps * steps]


def filtered(values, lag_s):
    gain = -np.expm1(-1.0 / (RATE_HZ * lag_s))
    return values[0] + lfilter([gain], [1.0, gain - 1.0], values - values[0], axis=0)


def differenced(q, resolution):
    q = np.round(q / resolution) * resolution
    return q, np.diff(q, axis=0, prepend=q[:1]) * RATE_HZ


def vibrating(q, dq, hertz, amplitude):
    omega = 2.0 * np.pi * hertz
    times = np.arange(len(q)) / RATE_HZ
    wave = np.sin(omega * times + 0.5)
    rate = omega * np.cos(omega * times + 0.5)
    return q + amplitude * wave[:, None], dq + amplitude * rate[:, None]


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
    "velocities of 20 Hz": lambda q, dq: (q, held(dq, 20.0)),
    "both of 50 Hz": lambda q, dq: (held(q, 50.0), held(dq, 50.0)),
    "velocity off by 0.01 rad/s": lambda q, dq: (q, dq + 0.01),
    "factor of 1.2": lambda q, dq: (q, 1.2 * dq),
    "vibration of 7 Hz": lambda q, dq: vibrating(q, dq, 7.0, 5e-4),
    "vibration of 50 Hz": lambda q, dq: vibrating(q, dq, 50.0, 5e-5),
    "position that jumps": lambda q, dq: (
        q + (np.arange(len(q)) % 3500 > 1700)[:, None] * 0.1,
        dq,
    ),
}

DEGREES = 180.0 / np.pi
WRONG = {
    "deg/s": (
        lambda q, dq: (q, DEGREES * dq),
        "is 57.3 times the rate of q: is it in deg/s",
    ),
    "q in degrees": (
        lambda q, dq: (DEGREES * q, dq),
        "is 0.0175 times the rate .*q in degrees",
    ),
    "sign": (
        lambda q, dq: (q, -dq),
        r"joints 2, 4, 6 is -1 times the rate .* sign the other one",
    ),
    "deg/s and sign": (
        lambda q, dq: (q, -DEGREES * dq),
        "is -57.3 times .*is its sign .* deg/s",
    ),
    "rpm": (
        lambda q, dq: (q, 30.0 / np.pi * dq),
        "is 9.55 times .*revolutions per minute",
    ),
    "gear": (
        lambda q, dq: (q, 100.0 * dq),
        "is 100 times the rate of q: .* before its gear",
    ),
    "not sent": (lambda q, dq: (q, 0.0 * dq), "stands still while q moves"),
    "stale": (lambda q, dq: (q, 0.0 * dq + dq[1500]), "does not follow q: .* stale"),
    "late by 0.5 s": (lambda q, dq: (q, late(dq, 0.5)), "is 0.5 s behind q"),
    "reversed order": (
        lambda q, dq: (q, dq[:, ::-1]),
        r"joint 2 is the rate of q at joint 6",
    ),
    "two joints swapped": (
        lambda q, dq: (q, dq[:, [0, 1, 2, 5, 4, 3, 6]]),
        r"joint 4 is the rate of q at joint 6.*joint 6 is the rate of q at joint 4",
    ),
    "one joint's sign": (
        lambda q, dq: (q, dq * np.where(np.arange(7) == 3, -1.0, 1.0)),
        r"^dq at joint 4 is -1 times",
    ),
}


SECONDS = {"late by 0.5 s": 6.5, "stale": 6.5}
"""Until these are reported; for those the way back is needed."""


@pytest.mark.parametrize("source", RIGHT)
@pytest.mark.parametrize("motion", [stroke, shaking])
def test_right_signals_are_never_reported(motion, source):
    times, q, dq = motion()
    checks, _ = reports(times, *RIGHT[source](q, dq))

    assert not any(check.text for check in checks)


def test_clock_jitter_and_gaps_are_not_reported():
    times, q, dq = stroke()
    rng = np.random.default_rng(2)
    stamps = np.maximum.accumulate(times + 5e-3 * rng.uniform(size=len(times)))
    checks, _ = reports(stamps, q, dq)

    assert not any(check.text for check in checks)

    is_sent = np.ones(len(times), dtype=bool)
    for start, length in zip(
        rng.uniform(0, 14, 12), (0.03, 0.1, 0.19, 0.4) * 3, strict=True
    ):
        is_sent &= ~((times >= start) & (times < start + length))
    checks, _ = reports(times[is_sent], q[is_sent], dq[is_sent])

    assert not any(check.text for check in checks)


@pytest.mark.parametrize("kind", WRONG)
def test_wrong_velocities_are_reported_and_stay_so(kind):
    bend, words = WRONG[kind]
    times, q, dq = stroke()
    checks, match = reports(times, *bend(q, dq))
    first_s = next(check.time_s for check in checks if check.text)
    final_text = checks[-1].text

    assert REST_S < first_s < REST_S + SECONDS.get(kind, 2.5)
    assert re.search(words, final_text), final_text

    q_end = bend(q, dq)[0][-1]
    still = np.zeros(7)
    for _ in range(3000):
        match = velocity_match_step(match, q_end, still, 0.02)

    assert velocity_fault(match) == final_text


def test_a_stuck_position_under_velocity_is_reported():
    times, q, dq = stroke()
    checks, _ = reports(times, 0.0 * q, 0.0 * dq + 1.0)

    assert "moves while q stands still" in checks[-1].text


def rows_of(robot, seconds=4.0, factor=1.0, start=0.0):
    q, dq, tau = signals(robot, seconds, start=start)
    return [
        (q_k, factor * dq_k, tau_k) for q_k, dq_k, tau_k in zip(q, dq, tau, strict=True)
    ]


@pytest.mark.parametrize("config", [DEFAULT, PUBLISHED])
@pytest.mark.parametrize("factor", [DEGREES, -1.0])
def test_the_tare_is_refused_for_wrong_velocities(lwr, factor, config):
    sensor = VirtualForceSensor(lwr, config)
    estimates = feed(sensor, rows_of(lwr, factor=factor))

    assert SensorWarning.VELOCITY in estimates[-1].warnings
    assert estimates[-1].status is Status.NOT_TARED
    assert f"is {factor:.3g} times the rate of q" in estimates[-1].message
    with pytest.raises(TareError, match="times the rate of q") as refused:
        sensor.tare()
    assert "in contact" not in str(refused.value)
    assert not sensor.tared

    sensor.tare(ignore_contact=True)
    later = feed(sensor, rows_of(lwr, 0.1, factor, start=4.0))[-1]

    assert sensor.tared
    assert SensorWarning.VELOCITY in later.warnings
    assert "times the rate of q" in later.message


def test_right_or_missing_velocities_are_not_reported(lwr):
    sensor, rows = tared(lwr)

    assert not any(e.warnings for e in feed(sensor, rows))

    sensor, rows = tared(lwr, with_velocity=False)

    assert not any(e.warnings for e in feed(sensor, rows))
    assert sensor.snapshot().monitor.match is None


@pytest.mark.slow
def test_free_motion_recorded_anew_is_judged_anew(lwr):
    sensor = VirtualForceSensor(lwr)

    assert (
        feed(sensor, rows_of(lwr, factor=DEGREES))[-1].warnings
        == SensorWarning.VELOCITY
    )

    # A jump of all velocities, which the filters have to forget first.
    feed(sensor, rows_of(lwr, 0.5, start=4.0))
    sensor.start_tare_recording()
    estimates = feed(sensor, rows_of(lwr, start=4.5))

    assert not any(e.warnings for e in estimates)

    sensor.tare()
    sensor.start_tare_recording()

    assert (
        SensorWarning.VELOCITY
        in feed(sensor, rows_of(lwr, start=8.0, factor=-1.0))[-1].warnings
    )


@pytest.mark.slow
def test_external_torque_has_its_velocities_checked(lwr):
    sensor = VirtualForceSensor(lwr)
    rows = rows_of(lwr, factor=-1.0)
    estimates = [sensor.update_external_torque(q, dq, BIAS, 1e-3) for q, dq, _ in rows]

    assert SensorWarning.VELOCITY in estimates[-1].warnings

    sensor.reset()
    estimates = [sensor.update_external_torque(q, None, BIAS, 1e-3) for q, _, _ in rows]

    assert not any(e.warnings for e in estimates)


def test_a_session_keeps_wrong_velocities_from_its_identifier(lwr):
    session = InsertionSession(lwr)
    for row in rows_of(lwr, factor=-1.0):
        session.update(*row, 1e-3)

    with pytest.raises(TareError, match="times the rate of q"):
        session.tare()

    session.tare(ignore_contact=True)
    estimates = [
        session.update(*row, 1e-3) for row in rows_of(lwr, 0.3, -1.0, start=4.0)
    ]

    assert all(
        SensorWarning.VELOCITY in e.warnings and not e.used_for_identification
        for e in estimates
    )
