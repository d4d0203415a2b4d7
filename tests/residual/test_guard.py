"""Valid numbers that are no measurements are held back, reported, and forgotten."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.faults.false_alarms import KINDS, held_back, sensed
from residual import DEFAULT, SensorWarning, Status, VirtualForceSensor
from tests.residual.guarded_sensor import feed, rows_of, signals, tared
from tests.residual.residual_signals import MIDDLE, external_torque_of


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize(("which", "size"), [(0, 0.02), (2, 10.0)])
def test_a_spike_is_rejected_alone(lwr, which, size, with_velocity):
    sensor, rows = tared(lwr, with_velocity=with_velocity)
    before = feed(sensor, rows[:50])[-1]
    spiked = list(rows[50])
    spiked[which] = spiked[which] + size * (np.arange(7) == 2)
    held = sensor.update(*spiked, 1e-3)

    assert held.status is Status.REJECTED
    assert SensorWarning.SPIKE in held.warnings
    assert "at joint 3" in held.message
    assert held.axial == before.axial

    after = feed(sensor, rows[51:200])

    assert all(e.status is Status.OK and not e.warnings for e in after)
    assert max(abs(e.axial) for e in after) < 0.2


@pytest.mark.parametrize(("sigmas", "is_spike"), [(11.0, False), (14.0, True)])
def test_a_noisy_torque_may_jump_by_twelve_times_its_noise(lwr, sigmas, is_spike):
    noise_Nm = 0.3
    q, dq, tau = signals(lwr, 0.7)
    wrist_Nm = noise_Nm * np.random.default_rng(0).normal(size=len(tau))
    wrist_Nm[-2:] = 0.0
    # The difference of two samples has twice the variance of one. A wrist of 38 Nm may
    # also step by 2 % of that.
    wrist_Nm[-1] += sigmas * np.sqrt(2.0) * noise_Nm + 0.76
    tau[:, 6] += wrist_Nm
    sensor = VirtualForceSensor(lwr)
    *_, last = feed(sensor, rows_of(q, dq, tau))

    assert (last.status is Status.REJECTED) == is_spike


@pytest.mark.parametrize("with_velocity", [True, False])
def test_a_jump_that_stays_is_accepted(lwr, with_velocity):
    sensor, rows = tared(lwr, with_velocity=with_velocity)
    feed(sensor, rows[:50])
    step = np.where(np.arange(7) == 1, 12.0, 0.0)
    estimates = feed(sensor, [(q, dq, tau - step) for q, dq, tau in rows[50:300]])
    held = [e.status is Status.REJECTED for e in estimates]

    assert 4 <= sum(held) <= 8
    assert not any(held[10:])
    assert estimates[-1].residual[1] == pytest.approx(12.0, abs=0.5)
    assert Status.INITIALIZING not in {e.status for e in estimates}


def test_a_lasting_position_jump_restarts_the_velocity(lwr):
    sensor, rows = tared(lwr, with_velocity=False)
    feed(sensor, rows[:50])
    estimates = feed(sensor, [(q + 0.01, None, tau) for q, _, tau in rows[50:400]])

    assert estimates[0].status is Status.REJECTED
    assert Status.INITIALIZING in {e.status for e in estimates}
    assert estimates[-1].status is Status.OK
    assert max(abs(e.axial) for e in estimates) < 1.0


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("number", [np.nan, np.inf, 1e10])
def test_impossible_numbers_are_rejected(lwr, number, with_velocity):
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
    estimates = feed(
        sensor,
        [(q, dq, tau + 50.0 * rng.normal(size=7)) for q, dq, tau in rows[50:400]],
    )

    assert any(e.status is not Status.REJECTED for e in estimates)

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
        last = sensor.update(
            q, dq, tau + (limit - tau * (limit > 0)) * (k + 1) / steps, 1e-3
        )
    q, dq, tau = rows[51 + steps]
    last = sensor.update(q, dq, np.where(limit > 0, limit, tau), 1e-3)

    assert last.status is Status.REJECTED
    assert SensorWarning.SATURATED in last.warnings
    assert "at joint 4" in last.message
    assert abs(feed(sensor, rows[300:700])[-1].axial) < 0.1


@pytest.mark.slow
def test_a_joint_at_its_limit_is_reported(lwr):
    middle = MIDDLE.copy()
    middle[5] = lwr.position_upper_rad[5] - 0.05
    sensor, rows = tared(lwr, middle=middle, more=4.0)
    estimates = feed(sensor, rows[:2000])

    assert {SensorWarning.JOINT_LIMIT in e.warnings for e in estimates} == {True, False}

    sensor.start_tare_recording()
    estimates = feed(sensor, rows[2000:])
    named = next(e for e in estimates if SensorWarning.JOINT_LIMIT in e.warnings)

    assert named.status is Status.NOT_TARED
    assert "at a position limit: joint 6" in named.message


@pytest.mark.parametrize("mode", ["axial", "point", "full"])
def test_a_pose_that_feels_nothing_is_reported(lwr, mode):
    sensor = VirtualForceSensor(lwr, replace(DEFAULT, mode=mode))
    for q in (np.full(7, 0.001), MIDDLE):
        estimates = [
            sensor.update(q, np.zeros(7), np.zeros(7), 1e-3) for _ in range(600)
        ][-1]
        assert (SensorWarning.NEAR_SINGULAR in estimates.warnings) == (q[3] > -1.0)
        assert all(np.isfinite(value).all() for value in estimates[:8])
        sensor.reset()


def test_a_lateral_push_mismatches_only_the_axial_mode(lwr):
    for mode, mismatches in (("axial", True), ("point", False)):
        sensor, rows = tared(lwr, replace(DEFAULT, mode=mode))
        assert feed(sensor, rows[:100])[-1].model_mismatch < 2.0
        force = np.array([1.0, 0.5, 0.0])
        pushed = [
            (q, dq, tau - external_torque_of(lwr, q, force))
            for q, dq, tau in rows[100:600]
        ]
        estimates = feed(sensor, pushed)[-1]
        assert (estimates.model_mismatch > 4.0) == mismatches
        assert (SensorWarning.MODEL_MISMATCH in estimates.warnings) == mismatches
        assert estimates.status is Status.OK
        assert bool(estimates.message) == mismatches


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_no_valid_sample_is_held_back(lwr, kind, with_velocity):
    rng = np.random.default_rng(1)
    motion = sensed(KINDS[kind](lwr, rng, 2000), rng)

    assert held_back(lwr, motion, has_velocity=with_velocity) == 0


@pytest.mark.slow
def test_a_coarse_encoder_step_is_no_spike(lwr):
    rng = np.random.default_rng(0)
    step = 3.5e-4
    sensor, rows = tared(lwr, with_velocity=False)
    q, _, tau = rows[0]
    # Near the edge of a step, which noise passes now and then only.
    edge = np.round(q / step) * step + 0.5 * step - 4e-5
    at = [
        np.round((edge + 1.5e-5 * rng.normal(size=7)) / step) * step
        for _ in range(8000)
    ]
    changes = np.count_nonzero(np.diff(at, axis=0), axis=0)

    assert (changes > 10).all()
    assert (changes < 400).all()

    sensor.reset()
    estimates = feed(
        sensor, [(each, None, tau + 0.03 * rng.normal(size=7)) for each in at]
    )

    assert sensor.rejected == 0, {e.message for e in estimates}


def test_a_spike_of_a_fast_arm_is_rejected(lwr):
    rng = np.random.default_rng(1)
    q, dq, tau = sensed(KINDS["up to the velocity limits"](lwr, rng, 2000), rng)
    for which, size in ((q, 0.05), (dq, 0.5), (tau, 20.0)):
        which[1500 + 100 * np.arange(3), 2] += size
        assert held_back(lwr, (q, dq, tau), has_velocity=True) == 3
        which[1500 + 100 * np.arange(3), 2] -= size


def test_acceleration_widens_the_deviation_of_each_joint(lwr):
    sensor, rows = tared(lwr)
    feed(sensor, rows[:100])
    at_rest = sensor.residual_std_Nm
    rng = np.random.default_rng(2)
    fast = KINDS["up to the velocity limits"](lwr, rng, 2000)
    estimates = feed(sensor, list(zip(*fast, strict=True)))

    assert sensor.residual_std_Nm.shape == (7,)
    assert (sensor.residual_std_Nm[:4] > 3.0 * at_rest[:4]).all()
    assert estimates[-1].axial_std > 3.0 * estimates[0].axial_std


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize(
    "middle", [MIDDLE, np.array([0.0, 0.9, 0.0, -1.1, 0.0, 1.1, 0.0])]
)
@pytest.mark.parametrize("newton", [5.0, 40.0])
def test_a_sudden_force_loses_no_sample(lwr, newton, middle, with_velocity):
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
def test_a_spike_of_one_torque_is_no_contact(lwr, joint):
    sensor, rows = tared(lwr)
    before = feed(sensor, rows[:50])[-1]
    q, dq, tau = rows[50]
    spike = np.where(np.arange(7) == joint, 0.06 * lwr.effort_limit_Nm, 0.0)
    held = sensor.update(q, dq, tau + spike, 1e-3)

    assert held.status is Status.REJECTED
    assert held.axial == before.axial
