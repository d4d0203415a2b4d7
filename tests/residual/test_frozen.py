"""Signals that are stuck are distinguished from valid ones that repeat."""

import numpy as np
import pytest

from residual import SensorWarning, Status, VirtualForceSensor
from residual.checks.stuck_signals import MAX_REFUSAL_S
from tests.residual.guarded_sensor import NOISE, feed, rows_of, tared
from tests.residual.residual_signals import BIAS, MIDDLE, swing

pytestmark = pytest.mark.slow


def held(values, samples, rng=None):
    """A slower source: every value comes several times; with a generator, one time
    more or less."""
    lengths = np.full(len(values), samples)
    if rng is not None:
        lengths += rng.integers(-1, 2, size=len(values))
    first = np.concatenate(([0], np.cumsum(lengths)))
    return values[
        first[np.searchsorted(first, np.arange(len(values)), side="right") - 1]
    ]


def rounded(values, resolution):
    return np.round(values / resolution) * resolution if resolution else values


SOURCES = {
    **{
        f"resolution of {lsb:g} Nm, noise of {noise:g} Nm": (lsb, noise, 1)
        for lsb in (0.0, 4e-3, 0.1)
        for noise in (0.0, 0.03)
    },
    "100 Hz": (0.0, 0.03, 10),
    "250 Hz and 0.02 Nm": (0.02, 4e-3, 4),
}


@pytest.mark.parametrize("moves_first", [False, True])
@pytest.mark.parametrize("source", SOURCES)
def test_an_arm_at_rest_is_never_refused(lwr, source, moves_first):
    resolution, noise, samples = SOURCES[source]
    rng = np.random.default_rng(1)
    _, q, dq, tau = swing(lwr, seconds=0.8, amplitude=0.1)
    if not moves_first:
        q, dq, tau = (np.repeat(x[:1], len(x), axis=0) for x in (q, 0.0 * dq, tau))
    q, dq, tau = (
        np.concatenate((x, np.repeat(x[-1:], 2000, axis=0))) for x in (q, dq, tau)
    )
    tau = held(rounded(tau + noise * rng.normal(size=tau.shape), resolution), samples)
    sensor = VirtualForceSensor(lwr)
    rows = list(zip(q, tau, strict=True))
    estimates = [
        sensor.update_external_torque(q_k, None, tau_k, 1e-3) for q_k, tau_k in rows
    ]

    assert not any(SensorWarning.FROZEN in e.warnings for e in estimates[800:])


@pytest.mark.parametrize("which", ["torque", "position", "all"])
@pytest.mark.parametrize("resolution", [0.0, 1e-2])
def test_signals_are_frozen_until_they_move_again(lwr, resolution, which):
    sensor, rows = tared(lwr)
    rows = [(q, dq, rounded(tau, resolution)) for q, dq, tau in rows]
    feed(sensor, rows[:100])
    q0, dq0, tau0 = rows[99]
    stuck = [
        (q, dq, tau0)
        if which == "torque"
        else (q0, dq0, tau if which == "position" else tau0)
        for q, dq, tau in rows[100:400]
    ]
    estimates = feed(sensor, stuck)

    assert all(
        e.status is Status.REJECTED and SensorWarning.FROZEN in e.warnings
        for e in estimates[30:]
    )
    assert ("position and torque" if which == "all" else which) in estimates[-1].message

    after = feed(sensor, rows[400:600])

    assert after[0].status is Status.INITIALIZING
    assert after[-1].status is Status.OK
    assert not after[-1].warnings
    assert max(abs(e.axial) for e in after) < 0.2


def test_a_slow_source_is_frozen_after_far_longer(lwr):
    rng = np.random.default_rng(0)
    tau = held(NOISE["tau"] * rng.normal(size=(2000, 7)), 10)
    tau[1000:] = tau[999]
    sensor = VirtualForceSensor(lwr)
    estimates = [
        sensor.update_external_torque(MIDDLE, None, tau_k, 1e-3) for tau_k in tau
    ]
    frozen = [SensorWarning.FROZEN in e.warnings for e in estimates]

    assert not any(frozen[:1150])
    assert all(frozen[1250:])


def test_one_stuck_torque_is_reported_and_not_refused(lwr):
    sensor, rows = tared(lwr, more=1.5)
    feed(sensor, rows[:100])
    alone = np.arange(7) == 1
    value = rows[99][2]
    estimates = feed(
        sensor, [(q, dq, np.where(alone, value, tau)) for q, dq, tau in rows[100:1000]]
    )

    assert all(e.status is Status.OK for e in estimates)
    assert not any(SensorWarning.FROZEN in e.warnings for e in estimates[:400])
    assert all(SensorWarning.FROZEN in e.warnings for e in estimates[600:])
    assert "at joint 2" in estimates[-1].message
    assert SensorWarning.FROZEN not in feed(sensor, rows[1000:1100])[-1].warnings


def test_nothing_is_refused_for_ever(lwr):
    sensor, rows = tared(lwr)
    feed(sensor, rows[:100])
    dt_s = 0.01
    estimates = feed(sensor, [rows[99]] * 1000, dt_s)
    refused = sum(e.status is Status.REJECTED for e in estimates) * dt_s

    assert 0.9 * MAX_REFUSAL_S < refused <= MAX_REFUSAL_S
    assert estimates[-1].status is Status.OK
    assert SensorWarning.FROZEN in estimates[-1].warnings
    assert "no longer held back" in estimates[-1].message


def test_signals_without_noise_may_repeat_themselves(lwr):
    sensor = VirtualForceSensor(lwr)
    tau = swing(lwr, seconds=0.1)[-1][0]
    for status in (Status.NOT_TARED, Status.OK):
        estimates = [sensor.update(MIDDLE, np.zeros(7), tau, 1e-3) for _ in range(1500)]
        assert estimates[-1].status is status
        assert not any(e.warnings for e in estimates)
        assert "neither q nor tau has changed" in estimates[-1].message
        if status is Status.NOT_TARED:
            sensor.tare()

    assert sensor.update(MIDDLE, np.zeros(7), tau + 1e-3, 0.1).message == ""


# A source slower than the clock repeats its samples, then jumps: that is no spike.


MILLISECONDS = (2, 5, 20)


def moving(robot, noise_rad, seconds=1.5):
    """Positions, velocities and torques of a brisk motion, up to half a radian a
    second."""
    _, q, dq, tau = swing(robot, seconds=seconds)
    rng = np.random.default_rng(0)
    tau = tau - BIAS + 0.03 * rng.normal(size=q.shape)
    dq = dq + 1e-3 * rng.normal(size=q.shape)
    return q + noise_rad * rng.normal(size=q.shape), dq, tau


def spikes(estimates):
    return [k for k, e in enumerate(estimates) if SensorWarning.SPIKE in e.warnings]


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("noise_rad", [0.0, 1e-4])
@pytest.mark.parametrize("samples", MILLISECONDS)
def test_positions_of_slow_sources_are_no_spikes(
    lwr, samples, noise_rad, with_velocity
):
    q, dq, tau = moving(lwr, noise_rad)
    for rng in (None, np.random.default_rng(1)):
        sent = (held(q, samples, rng), dq if with_velocity else None, tau)
        estimates = feed(VirtualForceSensor(lwr), rows_of(*sent))
        assert not any(e.warnings for e in estimates)
        assert estimates[-1].status is Status.NOT_TARED


@pytest.mark.parametrize("samples", MILLISECONDS)
def test_a_spike_of_a_held_position_is_rejected(lwr, samples):
    q, dq, tau = moving(lwr, 1e-5)
    q = held(q, samples)
    q[1000 : 1000 + 4, 2] += 0.05
    estimates = feed(VirtualForceSensor(lwr), rows_of(q, dq, tau))

    assert spikes(estimates)[0] == 1000
    assert all(e.status is Status.REJECTED for e in estimates[1000:1004])
    assert len(spikes(estimates)) <= 5
    assert estimates[-1].status is Status.NOT_TARED


def test_a_long_rest_makes_no_gate_wide(lwr):
    q, dq, tau = moving(lwr, 0.0)
    q = np.repeat(q[:1], 4000, axis=0)
    rng = np.random.default_rng(3)
    dq = 1e-3 * rng.normal(size=q.shape)
    tau = tau[0] + 0.03 * rng.normal(size=q.shape)
    q[3990, 4] += 1e-3

    assert spikes(feed(VirtualForceSensor(lwr), rows_of(q, dq, tau))) == [3990]
