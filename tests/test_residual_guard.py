"""Samples of sound numbers that are no measurements are held back, told, and got over."""

from dataclasses import replace

import numpy as np
import pytest
from residual_signals import BIAS, external_torque_of, swing

from residual import DEFAULT, Caution, Status, VirtualForceSensor
from residual.sample_guard import SampleGuard

NOISE = {"q": 1e-5, "dq": 2e-4, "tau": 0.03}


def signals(robot, seconds, *, middle=None, noisy=True, start=0.0):
    """Free motion with the noise of a good arm."""
    _, q, dq, tau = swing(robot, seconds=seconds, amplitude=0.03, middle=middle, start=start)
    rng = np.random.default_rng(0)
    tau = tau - BIAS
    if noisy:
        q, dq, tau = (
            value + NOISE[name] * rng.normal(size=value.shape)
            for name, value in (("q", q), ("dq", dq), ("tau", tau))
        )
    return q, dq, tau


def tared(robot, config=DEFAULT, *, with_velocity=True, more=1.0, **kinds):
    """A tared sensor and the samples that come next."""
    q, dq, tau = signals(robot, 2.0 + more, **kinds)
    sensor = VirtualForceSensor(robot, config)
    for k in range(2000):
        sensor.update(q[k], dq[k] if with_velocity else None, tau[k], 1e-3)
    sensor.tare()
    rest = [(q[k], dq[k] if with_velocity else None, tau[k]) for k in range(2000, len(q))]
    return sensor, rest


def feed(sensor, rows, dt_s=1e-3):
    return [sensor.update(*row, dt_s) for row in rows]


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize(("which", "size"), [(0, 0.02), (2, 10.0)])
def test_a_spike_is_held_back_and_the_next_sample_is_taken(lwr, which, size, with_velocity):
    sensor, rows = tared(lwr, with_velocity=with_velocity)
    before = feed(sensor, rows[:50])[-1]
    spiked = list(rows[50])
    spiked[which] = spiked[which] + size * (np.arange(7) == 2)
    held = sensor.update(*spiked, 1e-3)
    assert held.status is Status.SKIPPED
    assert Caution.SPIKE in held.cautions
    assert "joint index [2]" in held.message
    assert held.axial == before.axial
    after = feed(sensor, rows[51:200])
    assert all(e.status is Status.OK and not e.cautions for e in after)
    assert max(abs(e.axial) for e in after) < 0.2


@pytest.mark.parametrize("with_velocity", [True, False])
def test_a_jump_that_stays_is_believed(lwr, with_velocity):
    sensor, rows = tared(lwr, with_velocity=with_velocity)
    feed(sensor, rows[:50])
    step = np.where(np.arange(7) == 1, 12.0, 0.0)
    found = feed(sensor, [(q, dq, tau - step) for q, dq, tau in rows[50:300]])
    held = [e.status is Status.SKIPPED for e in found]
    assert 4 <= sum(held) <= 8
    assert not any(held[10:])
    assert found[-1].residual[1] == pytest.approx(12.0, abs=0.5)


def test_a_position_that_jumps_and_stays_restarts_the_velocity(lwr):
    sensor, rows = tared(lwr, with_velocity=False)
    feed(sensor, rows[:50])
    found = feed(sensor, [(q + 0.01, None, tau) for q, _, tau in rows[50:400]])
    assert found[0].status is Status.SKIPPED
    assert Status.SETTLING in {e.status for e in found}
    assert found[-1].status is Status.OK
    assert max(abs(e.axial) for e in found) < 1.0


def test_garbage_is_not_held_back_for_ever(lwr):
    sensor, rows = tared(lwr)
    feed(sensor, rows[:50])
    rng = np.random.default_rng(0)
    found = feed(sensor, [(q, dq, tau + 50.0 * rng.normal(size=7)) for q, dq, tau in rows[50:400]])
    assert any(e.status is not Status.SKIPPED for e in found)
    recovered = feed(sensor, rows[400:])
    assert recovered[-1].status is Status.OK
    assert abs(recovered[-1].axial) < 0.1


@pytest.mark.parametrize("joints", [[1], list(range(7))])
def test_a_torque_that_repeats_is_frozen_until_it_moves_again(lwr, joints):
    sensor, rows = tared(lwr)
    feed(sensor, rows[:100])
    stuck = np.isin(np.arange(7), joints)
    value = rows[99][2]
    found = feed(sensor, [(q, dq, np.where(stuck, value, tau)) for q, dq, tau in rows[100:400]])
    assert all(e.status is Status.SKIPPED and Caution.FROZEN in e.cautions for e in found[64:])
    assert f"joint index {joints}" in found[-1].message
    after = feed(sensor, rows[400:600])
    assert after[0].status is Status.SETTLING
    assert after[-1].status is Status.OK
    assert not after[-1].cautions
    assert max(abs(e.axial) for e in after) < 0.2


def test_signals_without_noise_may_repeat_themselves(lwr):
    sensor = VirtualForceSensor(lwr)
    q, tau = np.array([0.1, 0.5, -0.2, -1.5, 0.3, 1.0, 0.2]), np.zeros(7)
    found = [sensor.update(q, np.zeros(7), tau, 1e-3) for _ in range(1000)]
    assert found[-1].status is Status.NOT_TARED
    assert not found[-1].cautions


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
    assert last.status is Status.SKIPPED
    assert Caution.SATURATED in last.cautions
    assert "joint index [3]" in last.message
    assert abs(feed(sensor, rows[300:700])[-1].axial) < 0.1


def test_the_guard_may_be_turned_off(lwr):
    sensor, rows = tared(lwr, replace(DEFAULT, guard=False))
    feed(sensor, rows[:50])
    q, dq, tau = rows[50]
    assert sensor.update(q, dq, tau + 100.0, 1e-3).status is Status.OK


def test_a_joint_at_its_limit_is_told(lwr):
    middle = np.array([0.1, 0.5, -0.2, -1.5, 0.3, 1.0, 0.2])
    middle[5] = lwr.position_upper_rad[5] - 0.05
    sensor, rows = tared(lwr, middle=middle, more=4.0)
    cautions = {bool(Caution.JOINT_LIMIT in e.cautions) for e in feed(sensor, rows)}
    assert cautions == {True, False}


@pytest.mark.parametrize("mode", ["axial", "point", "full"])
def test_a_pose_that_feels_nothing_is_told(lwr, mode):
    sensor = VirtualForceSensor(lwr, replace(DEFAULT, mode=mode))
    for q in (np.full(7, 0.001), np.array([0.1, 0.5, -0.2, -1.5, 0.3, 1.0, 0.2])):
        found = [sensor.update(q, np.zeros(7), np.zeros(7), 1e-3) for _ in range(600)][-1]
        assert (Caution.NEAR_SINGULAR in found.cautions) == (q[3] > -1.0)
        assert all(np.isfinite(value).all() for value in found[:8])
        sensor.reset()


def test_a_push_aside_misfits_the_axial_mode_and_fits_the_point_mode(lwr):
    for mode, misfits in (("axial", True), ("point", False)):
        sensor, rows = tared(lwr, replace(DEFAULT, mode=mode))
        assert feed(sensor, rows[:100])[-1].misfit < 2.0
        force = np.array([1.0, 0.5, 0.0])
        pushed = [(q, dq, tau - external_torque_of(lwr, q, force)) for q, dq, tau in rows[100:600]]
        found = feed(sensor, pushed)[-1]
        assert (found.misfit > 4.0) == misfits
        assert (Caution.MISFIT in found.cautions) == misfits
        assert found.status is Status.OK
        assert bool(found.message) == misfits


def test_a_guard_resumes_where_it_was(lwr):
    q, dq, tau = signals(lwr, 1.0)
    guard, other = (SampleGuard(lwr, has_velocity=True) for _ in range(2))
    for k in range(700):
        guard.check(q[k], dq[k], tau[k], 1e-3)
        guard.accept(dq[k], 1e-3)
    other.restore(guard.state)
    for k in range(700, 900):
        for one in (guard, other):
            one.check(q[k], dq[k], tau[k], 1e-3)
            one.accept(dq[k], 1e-3)
    for ours, theirs in zip(guard.state, other.state, strict=True):
        np.testing.assert_equal(ours, theirs)


def test_a_robot_of_six_joints_has_nothing_left_to_tell_a_misfit_by(lwr):
    sensor, rows = tared(lwr, replace(DEFAULT, mode="full"))
    assert feed(sensor, rows[:100])[-1].misfit >= 0.0
