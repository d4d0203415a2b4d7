"""The facade as a stream: what a caller may do wrong, and what is handed out."""

import math
from dataclasses import replace

import numpy as np
import pytest

from residual import (
    DEFAULT,
    SensorConfig,
    SensorWarning,
    Status,
    TareError,
    VirtualForceSensor,
)
from residual.estimate import UNSEEN_STD
from tests.residual.guarded_sensor import feed, rows_of, signals, tared, tared_sensor
from tests.residual.residual_signals import BIAS, external_torque_of, swing


@pytest.mark.slow
def test_a_second_tare_needs_new_motion(lwr):
    sensor = tared_sensor(lwr)

    with pytest.raises(TareError, match="start_tare_recording"):
        sensor.tare()

    sensor.start_tare_recording()
    _, q, dq, tau = swing(lwr, seconds=1.5, start=2.0, amplitude=0.03)
    shifted = tau - 2.0 * BIAS
    feed(sensor, rows_of(q, dq, shifted))
    sensor.tare()

    assert abs(sensor.update(q[-1], dq[-1], shifted[-1], 1e-3).axial) < 0.02


def test_force_hidden_by_lag_widens_the_deviation(lwr):
    sensor = tared_sensor(lwr)
    _, q, dq, tau = swing(lwr, seconds=0.8, start=2.0, amplitude=0.03)
    calm = sensor.update(q[0], dq[0], tau[0] - BIAS, 1e-3).axial_std
    widest = 0.0
    for k in range(1, 800):
        step = external_torque_of(lwr, q[k], [0.0, 0.0, 2.0]) if k > 20 else 0.0
        estimate = sensor.update(q[k], dq[k], tau[k] - BIAS - step, 1e-3)
        widest = max(widest, estimate.axial_std)

    assert widest > 20 * calm
    # What the lag hid has faded. What remains is the hysteresis of the torque sensors,
    # and what the tare left unknown of their scale.
    assert estimate.axial_std < math.hypot(4 * calm, 0.03 * estimate.axial)
    assert sensor.std_of_bias_N(estimate) < 4 * calm


@pytest.mark.parametrize("mode", ["axial", "point", "full"])
def test_bad_first_samples_give_finite_read_only_numbers(lwr, mode):
    sensor = VirtualForceSensor(lwr, replace(DEFAULT, mode=mode))
    size = {"axial": 1, "point": 3, "full": 6}[mode]
    good = np.zeros(7)
    bad = np.full(7, np.nan)
    for blank in (
        sensor.update(bad, good, good, 1e-3),
        sensor.update(good, good, bad, 1e-3),
    ):
        assert (blank.status, blank.axial_std) == (Status.REJECTED, UNSEEN_STD)
        assert blank.covariance.shape == (size, size)
        assert all(np.isfinite(value).all() for value in blank[:8])
    _, q, dq, tau = swing(lwr, seconds=1.5, amplitude=0.03)
    estimate = feed(sensor, rows_of(q, dq, tau))[-1]
    tare = sensor.tare()
    arrays = [x for e in (blank, estimate) for x in e if isinstance(x, np.ndarray)]
    arrays += [tare.mean, tare.covariance, tare.noise_Nm2]

    assert len(arrays) == 13
    assert not any(array.flags.writeable for array in arrays)


@pytest.mark.parametrize("dt_s", [1e200, 86_401.0])
def test_a_clock_set_forward_is_reported_once(lwr, dt_s):
    sensor = tared_sensor(lwr)
    twin = tared_sensor(lwr)
    _, q, dq, tau = swing(lwr, seconds=0.01, start=2.0, amplitude=0.03)
    reported = sensor.update(q[0], dq[0], tau[0], dt_s)

    assert reported.status is Status.REJECTED
    assert "clock was set" in reported.message

    ours = sensor.update(q[1], dq[1], tau[1], 2e-3)
    theirs = twin.update(q[1], dq[1], tau[1], 2e-3)

    assert ours.status is Status.OK
    assert (ours.axial, ours.axial_std) == (theirs.axial, theirs.axial_std)


@pytest.mark.parametrize("with_velocity", [True, False])
def test_external_torque_has_deviation_and_motion(lwr, with_velocity):
    sensor = VirtualForceSensor(lwr, SensorConfig(force_bandwidth_per_s=None))
    _, q, dq, _ = swing(lwr, seconds=2.0, amplitude=0.03)
    rng = np.random.default_rng(0)
    noise = 0.03 * rng.normal(size=q.shape)
    estimates = []
    for k in range(2000):
        if k == 1000:
            sensor.tare()
        force = external_torque_of(lwr, q[k], [0.0, 0.0, 5.0]) if k >= 1000 else 0.0
        torque = BIAS + force + noise[k]
        estimate = sensor.update_external_torque(
            q[k], dq[k] if with_velocity else None, torque, 1e-3
        )
        estimates.append(estimate)
        if estimate.status is not Status.INITIALIZING:
            at = k if with_velocity else k - 10
            np.testing.assert_allclose(sensor.velocity_rad_s, dq[at], atol=2e-3)

    assert estimates[60].status is Status.NOT_TARED

    stated = np.array([e.axial_std for e in estimates[1000:]])
    error = np.array([e.axial for e in estimates[1000:]]) - np.mean(
        [e.axial for e in estimates[1000:]]
    )

    assert stated.max() < 0.2
    assert 0.3 < np.std(error) / stated.mean() < 3.0
    assert sensor.lag_s == 0.0


def test_lag_is_that_of_the_current_stream(lwr):
    sensor = tared_sensor(lwr)

    assert sensor.lag_s > 0.0

    _, q, dq, tau = swing(lwr, seconds=0.01, start=2.0, amplitude=0.03)
    sensor.start_tare_recording()
    sensor.update_external_torque(q[0], None, np.zeros(7), 1e-3)

    assert sensor.lag_s == 0.0

    sensor.start_tare_recording()
    sensor.update(q[1], dq[1], tau[1], 1e-3)

    assert sensor.lag_s > 0.0


def test_a_tare_serves_one_kind_of_torque(lwr):
    sensor = tared_sensor(lwr)
    twin = tared_sensor(lwr)
    _, q, dq, tau = swing(lwr, seconds=0.01, start=2.0, amplitude=0.03)
    reported = sensor.update_external_torque(q[0], None, np.zeros(7), 1e-9)

    assert reported.status is Status.REJECTED
    assert "were mixed" in reported.message
    assert sensor.update(q[1], dq[1], tau[1], 1e-3).axial == pytest.approx(
        twin.update(q[1], dq[1], tau[1], 1e-3).axial, abs=1e-6
    )

    sensor.start_tare_recording()

    assert (
        sensor.update_external_torque(q[2], dq[2], np.zeros(7), 1e-3).status
        is Status.NOT_TARED
    )
    assert sensor.update(q[3], dq[3], tau[3], 1e-3).status is Status.REJECTED

    sensor.reset()

    assert sensor.update(q[3], dq[3], tau[3], 1e-3).status is not Status.REJECTED


@pytest.mark.parametrize("with_velocity", [True, False])
def test_no_state_shares_arrays_with_the_caller(lwr, with_velocity):
    sensor = VirtualForceSensor(lwr)
    twin = VirtualForceSensor(lwr)
    _, q, dq, tau = swing(lwr, seconds=0.7, amplitude=0.03)
    dq = dq if with_velocity else [None] * len(q)
    for row in zip(q, dq, tau, strict=True):
        mine = [None if values is None else values.copy() for values in row]
        ours = sensor.update(*mine, 1e-3)
        theirs = twin.update(*row, 1e-3)
        velocity = sensor.velocity_rad_s.copy()
        for buffer in mine:
            if buffer is not None:
                buffer[:] = 7.0
        assert ours.axial == theirs.axial
        np.testing.assert_array_equal(sensor.velocity_rad_s, velocity)


# Neither the rounding of time stamps nor a clock that is set spoils an estimate unseen.


def run(robot, stamps_s, *, with_velocity=True):
    """Estimates of a sensor that is tared after two seconds."""
    q, dq, tau = signals(robot, 3.0)
    steps = np.diff(stamps_s, prepend=stamps_s[0] - 1e-3).tolist()
    sensor = VirtualForceSensor(robot)
    estimates = []
    for k, dt_s in enumerate(steps):
        if k == 2000:
            sensor.tare()
        estimates.append(
            sensor.update(q[k], dq[k] if with_velocity else None, tau[k], dt_s)
        )
    return estimates


@pytest.mark.slow
@pytest.mark.parametrize("with_velocity", [True, False])
def test_rounding_of_time_stamps_decides_nothing(lwr, with_velocity):
    ticks = np.arange(3000)
    exact = run(lwr, ticks / 1000, with_velocity=with_velocity)
    for stamps_s in (
        ticks * 1e-3,
        np.cumsum(np.full(3000, 1e-3)),
        1.7e9 + ticks / 1000,
    ):
        rounded = run(lwr, stamps_s, with_velocity=with_velocity)
        assert [e.status for e in rounded] == [e.status for e in exact]
        axial = np.array(
            [(a.axial, b.axial) for a, b in zip(rounded, exact, strict=True)]
        )
        assert np.abs(np.diff(axial[2000:])).max() < 1e-4


def test_a_clock_leap_is_reported_until_the_tare(lwr):
    sensor, rows = tared(lwr)
    sensor.update(*rows[0], 59.0)  # a pause
    quiet = feed(sensor, rows[1:50])[-1]

    assert not quiet.warnings

    sensor.update(*rows[50], 3600.0)
    reported = feed(sensor, rows[51:400])

    assert reported[-1].status is Status.OK
    assert all(SensorWarning.TARE_EXPIRED in e.warnings for e in reported)
    assert "tare again" in reported[-1].message
    assert reported[-1].axial_std > 10.0 * quiet.axial_std

    resumed = VirtualForceSensor(lwr)
    resumed.restore(sensor.snapshot())

    assert SensorWarning.TARE_EXPIRED in resumed.update(*rows[400], 1e-3).warnings

    sensor.start_tare_recording()

    assert not any(e.warnings for e in feed(sensor, rows[400:900]))

    sensor.tare()
    last = feed(sensor, rows[900:])[-1]

    assert last.status is Status.OK
    assert not last.warnings
    assert last.axial_std < 2.0 * quiet.axial_std


def test_a_clock_leap_forgets_the_recording_before(lwr):
    rows = list(zip(*signals(lwr, 3.0), strict=True))
    sensor = VirtualForceSensor(lwr)

    assert not feed(sensor, [(q, dq, tau + 2.0) for q, dq, tau in rows[:1000]])[
        -1
    ].warnings

    sensor.update(*rows[1000], 3600.0)

    with pytest.raises(
        TareError, match=r"no settled free motion.*a time step of minutes"
    ):
        sensor.tare()

    reported = feed(sensor, rows[1001:2000])

    assert all(SensorWarning.TARE_EXPIRED in e.warnings for e in reported)
    assert reported[-1].status is Status.NOT_TARED
    assert "forgotten" in reported[-1].message

    sensor.tare()
    last = feed(sensor, rows[2000:])[-1]

    assert last.status is Status.OK
    assert not last.warnings
    assert abs(last.axial) < 0.1
