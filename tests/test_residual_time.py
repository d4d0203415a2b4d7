"""Neither the rounding of time stamps nor a clock that is set spoils an estimate unseen."""

import numpy as np
import pytest
from guarded_sensor import feed, signals, tared

from residual import SensorWarning, Status, TareError, VirtualForceSensor


def run(robot, stamps_s, *, with_velocity=True):
    """Estimates of a sensor that is tared after two seconds."""
    q, dq, tau = signals(robot, 3.0)
    steps = np.diff(stamps_s, prepend=stamps_s[0] - 1e-3).tolist()
    sensor, found = VirtualForceSensor(robot), []
    for k, dt_s in enumerate(steps):
        if k == 2000:
            sensor.tare()
        found.append(sensor.update(q[k], dq[k] if with_velocity else None, tau[k], dt_s))
    return found


@pytest.mark.parametrize("with_velocity", [True, False])
def test_rounding_of_time_stamps_decides_nothing(lwr, with_velocity):
    ticks = np.arange(3000)
    exact = run(lwr, ticks / 1000, with_velocity=with_velocity)
    for stamps_s in (ticks * 1e-3, np.cumsum(np.full(3000, 1e-3)), 1.7e9 + ticks / 1000):
        rounded = run(lwr, stamps_s, with_velocity=with_velocity)
        assert [e.status for e in rounded] == [e.status for e in exact]
        axial = np.array([(a.axial, b.axial) for a, b in zip(rounded, exact, strict=True)])
        assert np.abs(np.diff(axial[2000:])).max() < 1e-4


def test_a_leap_of_the_clock_is_told_until_the_next_tare(lwr):
    sensor, rows = tared(lwr)
    quiet = feed(sensor, rows[:50])[-1]
    assert not quiet.warnings
    sensor.update(*rows[50], 3600.0)
    told = feed(sensor, rows[51:400])
    assert told[-1].status is Status.OK
    assert all(SensorWarning.TARE_EXPIRED in e.warnings for e in told)
    assert "tare again" in told[-1].message
    assert told[-1].axial_std > 10.0 * quiet.axial_std
    resumed = VirtualForceSensor(lwr)
    resumed.restore(sensor.snapshot())
    assert SensorWarning.TARE_EXPIRED in resumed.update(*rows[400], 1e-3).warnings
    sensor.start_tare_recording()
    feed(sensor, rows[400:900])
    sensor.tare()
    last = feed(sensor, rows[900:])[-1]
    assert last.status is Status.OK
    assert not last.warnings
    assert last.axial_std < 2.0 * quiet.axial_std


def test_a_pause_below_a_minute_is_no_leap(lwr):
    sensor, rows = tared(lwr)
    sensor.update(*rows[0], 59.0)
    assert not feed(sensor, rows[1:400])[-1].warnings


@pytest.mark.parametrize("again", [False, True])
def test_a_leap_while_free_motion_is_recorded_is_told_and_what_was_before_it_forgotten(lwr, again):
    q, dq, tau = signals(lwr, 3.0)
    rows = list(zip(q, dq, tau, strict=True))
    sensor = VirtualForceSensor(lwr)
    if again:
        sensor, _ = tared(lwr)
        sensor.start_tare_recording()
    assert not feed(sensor, [(q, dq, tau + 2.0) for q, dq, tau in rows[:1000]])[-1].warnings
    sensor.update(*rows[1000], 3600.0)
    with pytest.raises(TareError, match=r"no settled free motion.*a time step of minutes"):
        sensor.tare()
    told = feed(sensor, rows[1001:2000])
    assert all(SensorWarning.TARE_EXPIRED in e.warnings for e in told)
    assert told[-1].status is Status.NOT_TARED
    assert "forgotten" in told[-1].message
    resumed = VirtualForceSensor(lwr)
    resumed.restore(sensor.snapshot())
    assert SensorWarning.TARE_EXPIRED in resumed.update(*rows[2000], 1e-3).warnings
    sensor.tare()
    last = feed(sensor, rows[2000:])[-1]
    assert last.status is Status.OK
    assert not last.warnings
    assert abs(last.axial) < 0.1


def test_a_leap_before_any_motion_is_recorded_is_none(lwr):
    q, dq, tau = signals(lwr, 1.0)
    sensor = VirtualForceSensor(lwr)
    sensor.update(q[0], dq[0], tau[0], 1e-3)
    sensor.update(q[1], dq[1], tau[1], 3600.0)
    found = feed(sensor, zip(q[2:], dq[2:], tau[2:], strict=True))
    assert not any(e.warnings for e in found)


def test_a_recording_started_anew_after_a_leap_is_as_good_as_any(lwr):
    sensor, rows = tared(lwr)
    sensor.update(*rows[0], 3600.0)
    sensor.start_tare_recording()
    assert not any(e.warnings for e in feed(sensor, rows[1:400]))
