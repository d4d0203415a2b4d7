"""Samples of sound numbers that are no measurements are held back, told, and got over."""

from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from guarded_sensor import feed, signals, tared
from residual_signals import external_torque_of

from residual import DEFAULT, SampleError, SensorWarning, Status, VirtualForceSensor
from residual.fault_detection import FaultDetector, OutlierGate
from residual.sample_stream import ExternalTorqueStream


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize(("which", "size"), [(0, 0.02), (2, 10.0)])
def test_a_spike_is_held_back_and_the_next_sample_is_taken(lwr, which, size, with_velocity):
    sensor, rows = tared(lwr, with_velocity=with_velocity)
    before = feed(sensor, rows[:50])[-1]
    spiked = list(rows[50])
    spiked[which] = spiked[which] + size * (np.arange(7) == 2)
    held = sensor.update(*spiked, 1e-3)
    assert held.status is Status.REJECTED
    assert SensorWarning.SPIKE in held.warnings
    assert "joint index [2]" in held.message
    assert held.axial == before.axial
    after = feed(sensor, rows[51:200])
    assert all(e.status is Status.OK and not e.warnings for e in after)
    assert max(abs(e.axial) for e in after) < 0.2


@pytest.mark.parametrize("with_velocity", [True, False])
def test_a_jump_that_stays_is_believed(lwr, with_velocity):
    sensor, rows = tared(lwr, with_velocity=with_velocity)
    feed(sensor, rows[:50])
    step = np.where(np.arange(7) == 1, 12.0, 0.0)
    found = feed(sensor, [(q, dq, tau - step) for q, dq, tau in rows[50:300]])
    held = [e.status is Status.REJECTED for e in found]
    assert 4 <= sum(held) <= 8
    assert not any(held[10:])
    assert found[-1].residual[1] == pytest.approx(12.0, abs=0.5)


def test_a_position_that_jumps_and_stays_restarts_the_velocity(lwr):
    sensor, rows = tared(lwr, with_velocity=False)
    feed(sensor, rows[:50])
    found = feed(sensor, [(q + 0.01, None, tau) for q, _, tau in rows[50:400]])
    assert found[0].status is Status.REJECTED
    assert Status.INITIALIZING in {e.status for e in found}
    assert found[-1].status is Status.OK
    assert max(abs(e.axial) for e in found) < 1.0


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("number", [np.nan, np.inf, 1e10, 1e200, -1e308])
def test_numbers_that_no_sample_has_never_pass_for_ordinary_ones(lwr, number, with_velocity):
    sensor, rows = tared(lwr, with_velocity=with_velocity)
    before = feed(sensor, rows[:50])[-1]
    for which in (0, 1, 2) if with_velocity else (0, 2):
        bad = list(rows[50])
        bad[which] = np.where(np.arange(7) == 3, number, bad[which])
        held = sensor.update(*bad, 1e-3)
        assert held.status is Status.REJECTED
        assert "finite" in held.message or "expected SI units" in held.message
        assert held.axial == before.axial
    assert feed(sensor, rows[50:60])[-1].status is Status.OK


def test_garbage_is_not_held_back_for_ever(lwr):
    sensor, rows = tared(lwr)
    feed(sensor, rows[:50])
    rng = np.random.default_rng(0)
    found = feed(sensor, [(q, dq, tau + 50.0 * rng.normal(size=7)) for q, dq, tau in rows[50:400]])
    assert any(e.status is not Status.REJECTED for e in found)
    recovered = feed(sensor, rows[400:])
    assert recovered[-1].status is Status.OK
    assert abs(recovered[-1].axial) < 0.1


@pytest.mark.parametrize("slowly", [False, True])
def test_a_saturated_torque_is_held_back(lwr, slowly):
    sensor, rows = tared(lwr)
    feed(sensor, rows[:50])
    limit = np.where(np.arange(7) == 3, lwr.effort_limit_Nm, 0.0)
    steps = 200 if slowly else 1
    for k in range(steps):
        q, dq, tau = rows[50 + k]
        last = sensor.update(q, dq, tau + (limit - tau * (limit > 0)) * (k + 1) / steps, 1e-3)
    q, dq, tau = rows[51 + steps]
    last = sensor.update(q, dq, np.where(limit > 0, limit, tau), 1e-3)
    assert last.status is Status.REJECTED
    assert SensorWarning.SATURATED in last.warnings
    assert "joint index [3]" in last.message
    assert abs(feed(sensor, rows[300:700])[-1].axial) < 0.1


def test_the_guard_may_be_turned_off(lwr):
    sensor, rows = tared(lwr, replace(DEFAULT, guard=False))
    feed(sensor, rows[:50])
    q, dq, tau = rows[50]
    assert sensor.update(q, dq, tau + 100.0, 1e-3).status is Status.OK


def test_a_joint_at_its_limit_is_reported(lwr):
    middle = np.array([0.1, 0.5, -0.2, -1.5, 0.3, 1.0, 0.2])
    middle[5] = lwr.position_upper_rad[5] - 0.05
    sensor, rows = tared(lwr, middle=middle, more=4.0)
    warnings = {bool(SensorWarning.JOINT_LIMIT in e.warnings) for e in feed(sensor, rows)}
    assert warnings == {True, False}


@pytest.mark.parametrize("mode", ["axial", "point", "full"])
def test_a_pose_that_feels_nothing_is_reported(lwr, mode):
    sensor = VirtualForceSensor(lwr, replace(DEFAULT, mode=mode))
    for q in (np.full(7, 0.001), np.array([0.1, 0.5, -0.2, -1.5, 0.3, 1.0, 0.2])):
        found = [sensor.update(q, np.zeros(7), np.zeros(7), 1e-3) for _ in range(600)][-1]
        assert (SensorWarning.NEAR_SINGULAR in found.warnings) == (q[3] > -1.0)
        assert all(np.isfinite(value).all() for value in found[:8])
        sensor.reset()


def test_a_push_aside_does_not_fit_the_axial_mode_and_fits_the_point_mode(lwr):
    for mode, misfits in (("axial", True), ("point", False)):
        sensor, rows = tared(lwr, replace(DEFAULT, mode=mode))
        assert feed(sensor, rows[:100])[-1].model_mismatch < 2.0
        force = np.array([1.0, 0.5, 0.0])
        pushed = [(q, dq, tau - external_torque_of(lwr, q, force)) for q, dq, tau in rows[100:600]]
        found = feed(sensor, pushed)[-1]
        assert (found.model_mismatch > 4.0) == misfits
        assert (SensorWarning.MODEL_MISMATCH in found.warnings) == misfits
        assert found.status is Status.OK
        assert bool(found.message) == misfits


def test_a_guard_resumes_where_it_was(lwr):
    rows = np.concatenate(signals(lwr, 1.0), axis=1)
    guard, other = (FaultDetector(lwr, has_velocity=True) for _ in range(2))
    for row in rows[:700]:
        guard.check(row, 1e-3)
        guard.accept(row, row[7:14], 1e-3)
    other.restore(guard.state)
    for row in rows[700:900]:
        for one in (guard, other):
            one.check(row, 1e-3)
            one.accept(row, row[7:14], 1e-3)
    ours, theirs = (asdict(one.state) for one in (guard, other))
    assert ours.pop("probe") is theirs.pop("probe") is None
    np.testing.assert_equal(ours, theirs)


def test_a_robot_of_six_joints_has_nothing_left_to_tell_a_misfit_by(lwr):
    sensor, rows = tared(lwr, replace(DEFAULT, mode="full"))
    assert feed(sensor, rows[:100])[-1].model_mismatch >= 0.0


MIDDLES = [
    np.array([0.1, 0.5, -0.2, -1.5, 0.3, 1.0, 0.2]),
    np.array([1.0, 0.2, 0.5, -1.0, -0.4, 1.3, 0.0]),
    np.array([0.0, 0.9, 0.0, -1.1, 0.0, 1.1, 0.0]),
]


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("middle", MIDDLES)
@pytest.mark.parametrize("newton", [5.0, 12.0, 40.0])
def test_a_force_that_comes_in_one_sample_loses_none(lwr, newton, middle, with_velocity):
    sensor, rows = tared(lwr, with_velocity=with_velocity, middle=middle)
    directions = np.repeat(
        [[0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 1]], 50, 0
    )
    pushed = [
        (q, dq, tau - external_torque_of(lwr, q, newton * direction))
        for direction, (q, dq, tau) in zip(directions, rows, strict=False)
    ]
    assert {e.status for e in feed(sensor, pushed)} == {Status.OK}


@pytest.mark.parametrize("joint", range(7))
def test_a_torque_spike_of_one_joint_is_no_contact(lwr, joint):
    sensor, rows = tared(lwr)
    before = feed(sensor, rows[:50])[-1]
    q, dq, tau = rows[50]
    spike = np.where(np.arange(7) == joint, 0.06 * lwr.effort_limit_Nm, 0.0)
    held = sensor.update(q, dq, tau + spike, 1e-3)
    assert held.status is Status.REJECTED
    assert held.axial == before.axial


def test_a_torque_jump_does_not_restart_the_velocity(lwr):
    sensor, rows = tared(lwr, with_velocity=False)
    feed(sensor, rows[:50])
    step = np.where(np.arange(7) == 1, 12.0, 0.0)
    found = feed(sensor, [(q, dq, tau - step) for q, dq, tau in rows[50:150]])
    assert sum(e.status is Status.REJECTED for e in found) <= 6
    assert Status.INITIALIZING not in {e.status for e in found}


@pytest.mark.parametrize("with_velocity", [True, False])
def test_without_a_guard_nothing_of_it_is_remembered(lwr, with_velocity):
    sensor, rows = tared(lwr, replace(DEFAULT, guard=False), with_velocity=with_velocity)
    feed(sensor, rows[:50])
    assert sensor.snapshot().joints.guard is None
    sensor.start_tare_recording()
    sensor.update_external_torque(rows[50][0], None, rows[50][2], 1e-3)
    assert sensor.snapshot().external_torque.guard is None


def test_garbage_in_the_first_samples_is_refused_by_name(lwr):
    stream = ExternalTorqueStream(lwr, DEFAULT, has_velocity=False)
    with pytest.raises(SampleError, match=r"external_torque is not finite at joint index \[2\]"):
        stream.update(np.zeros(7), None, np.where(np.arange(7) == 2, np.nan, 0.0), 1e-3)
    with pytest.raises(SampleError, match="q has shape"):
        stream.update(np.zeros(6), None, np.zeros(7), 1e-3)
    with pytest.raises(SampleError, match="dq was given"):
        stream.update(np.zeros(7), np.zeros(7), np.zeros(7), 1e-3)


@pytest.mark.parametrize("with_velocity", [True, False])
def test_a_source_slower_than_the_clock_makes_no_spikes(lwr, with_velocity):
    q, dq, tau = signals(lwr, 4.0)
    sensor, held = VirtualForceSensor(lwr), np.arange(4000) // 10 * 10
    rows = [(q[k], dq[k] if with_velocity else None, tau[k]) for k in held]
    assert not any(e.warnings & SensorWarning.SPIKE for e in feed(sensor, rows))


def test_time_stamps_may_be_off_by_milliseconds(lwr):
    gates = OutlierGate(lwr, has_velocity=True, delay_s=0.0)
    off = np.zeros(21)
    off[3] = 4e-3
    quick, slow = np.full(7, 1.0), np.full(7, 0.1)
    assert not gates.beyond(off, quick, 1e-3).any()
    assert gates.beyond(off, slow, 1e-3)[0, 3]


def test_gears_of_a_small_wrist_are_no_spike():
    arm = SimpleNamespace(nv=2, effort_limit_Nm=np.array([87.0, 12.0]))
    gates = OutlierGate(arm, has_velocity=True, delay_s=0.0)
    off = np.zeros(6)
    off[-1] = 0.65
    assert not gates.beyond(off, np.zeros(2), 1e-3).any()
    off[-1] = 1.0
    assert gates.beyond(off, np.zeros(2), 1e-3)[-1, 1]


def test_currents_that_turn_round_are_no_spike_where_the_effort_limit_is_unknown():
    arm = SimpleNamespace(nv=2, effort_limit_Nm=np.zeros(2))
    gates = OutlierGate(arm, has_velocity=True, delay_s=0.0)
    off = np.zeros(6)
    off[-1] = 11.0
    assert not gates.beyond(off, np.zeros(2), 0.01).any()
    off[-1] = 30.0
    assert gates.beyond(off, np.zeros(2), 0.01)[-1, 1]
