"""What is reported of wrong velocities: by the sensor and by a session."""

import numpy as np
import pytest
from guarded_sensor import feed, signals, tared
from insertion_run import same
from residual_signals import BIAS

from needleforce import InsertionSession, read_snapshot, write_snapshot
from residual import (
    DEFAULT,
    PUBLISHED,
    SensorWarning,
    SnapshotError,
    Status,
    TareError,
    VirtualForceSensor,
)
from residual.virtual_force_sensor import SensorState

DEGREES = 180.0 / np.pi


def rows_of(robot, seconds=4.0, factor=1.0, start=0.0):
    q, dq, tau = signals(robot, seconds, start=start)
    return [(q_k, factor * dq_k, tau_k) for q_k, dq_k, tau_k in zip(q, dq, tau, strict=True)]


@pytest.mark.parametrize("config", [DEFAULT, PUBLISHED])
@pytest.mark.parametrize("factor", [DEGREES, -1.0])
def test_the_tare_is_refused_with_the_reason_and_not_with_contact(lwr, factor, config):
    sensor = VirtualForceSensor(lwr, config)
    found = feed(sensor, rows_of(lwr, factor=factor))
    assert SensorWarning.VELOCITY in found[-1].warnings
    assert found[-1].status is Status.NOT_TARED
    assert f"is {factor:.3g} times the rate of q" in found[-1].message
    with pytest.raises(TareError, match="times the rate of q") as refused:
        sensor.tare()
    assert "in contact" not in str(refused.value)
    assert not sensor.tared
    sensor.tare(ignore_contact=True)
    later = feed(sensor, rows_of(lwr, 0.1, factor, start=4.0))[-1]
    assert sensor.tared
    assert SensorWarning.VELOCITY in later.warnings
    assert "times the rate of q" in later.message


def test_sound_velocities_are_not_told_and_without_velocities_nothing_is(lwr):
    sensor, rows = tared(lwr)
    assert not any(e.warnings for e in feed(sensor, rows))
    sensor, rows = tared(lwr, with_velocity=False)
    assert not any(e.warnings for e in feed(sensor, rows))
    assert sensor.snapshot().monitor.match is None


def test_free_motion_recorded_anew_is_judged_anew(lwr):
    sensor = VirtualForceSensor(lwr)
    assert feed(sensor, rows_of(lwr, factor=DEGREES))[-1].warnings == SensorWarning.VELOCITY
    # A jump of all velocities, which the filters have to forget first.
    feed(sensor, rows_of(lwr, 0.5, start=4.0))
    sensor.start_tare_recording()
    found = feed(sensor, rows_of(lwr, start=4.5))
    assert not any(e.warnings for e in found)
    sensor.tare()
    sensor.start_tare_recording()
    assert SensorWarning.VELOCITY in feed(sensor, rows_of(lwr, start=8.0, factor=-1.0))[-1].warnings


def test_the_robots_own_external_torque_is_judged_the_same_way(lwr):
    sensor = VirtualForceSensor(lwr)
    rows = rows_of(lwr, factor=-1.0)
    found = [sensor.update_external_torque(q, dq, BIAS, 1e-3) for q, dq, _ in rows]
    assert SensorWarning.VELOCITY in found[-1].warnings
    sensor.reset()
    found = [sensor.update_external_torque(q, None, BIAS, 1e-3) for q, _, _ in rows]
    assert not any(e.warnings for e in found)


def test_a_session_keeps_wrong_velocities_from_its_identifier(lwr):
    session = InsertionSession(lwr)
    for row in rows_of(lwr, factor=-1.0):
        session.update(*row, 1e-3)
    with pytest.raises(TareError, match="times the rate of q"):
        session.tare()
    session.tare(force=True)
    found = [session.update(*row, 1e-3) for row in rows_of(lwr, 0.3, -1.0, start=4.0)]
    assert all(
        SensorWarning.VELOCITY in e.warnings and not e.used_for_identification for e in found
    )


@pytest.mark.parametrize("cut", [900, 2500])
def test_a_snapshot_goes_on_bit_for_bit_before_and_after_it_is_told(lwr, tmp_path, cut):
    rows = rows_of(lwr, factor=-1.0)
    sensor, other = VirtualForceSensor(lwr), VirtualForceSensor(lwr)
    feed(sensor, rows[:cut])
    state = sensor.snapshot()
    write_snapshot(state, tmp_path / "state")
    stored = read_snapshot(tmp_path / "state")
    assert isinstance(stored, SensorState)
    other.restore(stored)
    assert other.snapshot().monitor.match is not state.monitor.match
    for row in rows[cut:]:
        assert same(sensor.update(*row, 1e-3), other.update(*row, 1e-3))
    assert same(sensor.snapshot().monitor, other.snapshot().monitor)
    assert SensorWarning.VELOCITY in sensor.update(*rows[-1], 1e-3).warnings


@pytest.mark.parametrize("name", ["position", "seconds", "products"])
@pytest.mark.parametrize("shape", [(), (25,), (3, 3), (7, 6), (6,)])
def test_a_damaged_match_is_refused(lwr, name, shape):
    sensor, rows = tared(lwr)
    feed(sensor, rows[:50])
    state = sensor.snapshot()
    match = state.monitor.match
    assert match is not None
    assert match.products.shape == (7, 7)
    match = match._replace(**{name: np.zeros(shape)})
    damaged = state._replace(monitor=state.monitor._replace(match=match))
    with pytest.raises(SnapshotError, match="damaged"):
        sensor.restore(damaged)
    sensor.restore(state)
