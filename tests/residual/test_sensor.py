"""The facade: tare, insert, and what it says about bad samples."""

from dataclasses import replace

import numpy as np
import pytest

from residual import (
    DEFAULT,
    HAND_DRIVEN,
    PUBLISHED,
    ConfigurationError,
    JointFriction,
    SensorConfig,
    SigmoidFriction,
    SnapshotError,
    Status,
    TareError,
    VirtualForceSensor,
)
from tests.residual.guarded_sensor import feed, rows_of, tared, tared_sensor
from tests.residual.residual_signals import BIAS, external_torque_of, swing


def push(robot, sensor, force, *, with_velocity=True):
    """The estimate after half a second under a force."""
    _, q, dq, tau = swing(
        robot, seconds=0.5, start=2.0, amplitude=0.03, force_at_tip_in_base=force
    )
    return feed(sensor, rows_of(q, dq if with_velocity else None, tau - BIAS))[-1]


@pytest.mark.slow
@pytest.mark.parametrize("with_velocity", [True, False])
def test_force_is_read_through_a_sensor_bias(lwr, with_velocity):
    sensor = tared_sensor(
        lwr, replace(DEFAULT, mode="point"), with_velocity=with_velocity
    )
    force = np.array([1.0, -0.5, 2.0])
    estimate = push(lwr, sensor, force, with_velocity=with_velocity)

    assert estimate.status is Status.OK
    np.testing.assert_allclose(estimate.force, force, atol=0.03)

    # The tare does not fade.
    _, q, dq, tau = swing(lwr, seconds=3.0, start=2.5, amplitude=0.03)
    later = feed(sensor, rows_of(q, dq if with_velocity else None, tau - BIAS))

    assert max(np.abs(e.force).max() for e in later[500:]) < 0.03


def test_paper_preset_reads_the_same_force_later(lwr):
    sensor = tared_sensor(lwr, PUBLISHED)

    assert sensor.lag_s == pytest.approx(0.2)

    estimate = push(lwr, sensor, [0.0, 0.0, 2.0])

    assert estimate.force[2] == pytest.approx(2.0 * (1 - np.exp(-0.5 * 5.0)), abs=0.1)
    assert estimate.covariance.shape == (6, 6)


def test_status_is_initializing_then_not_tared_then_ok(lwr):
    sensor = VirtualForceSensor(lwr)
    _, q, dq, tau = swing(lwr, seconds=1.0)
    statuses = [sensor.update(q[k], dq[k], tau[k], 1e-3).status for k in range(len(q))]

    assert statuses[0] is Status.INITIALIZING
    assert statuses[-1] is Status.NOT_TARED
    assert not sensor.tared

    sensor.tare()

    assert sensor.tared
    assert sensor.update(q[-1], dq[-1], tau[-1], 1e-3).status is Status.OK

    sensor.start_tare_recording()

    assert sensor.update(q[-1], dq[-1], tau[-1], 1e-3).status is Status.NOT_TARED

    after_gap = sensor.update(q[-1], dq[-1], tau[-1], 5.0)

    assert after_gap.status is Status.INITIALIZING

    sensor.update(q[-1], dq[-1], np.full(7, np.nan), 1e-3)

    assert sensor.rejected == 1

    sensor.reset()

    assert (sensor.tared, sensor.rejected, sensor.lag_s) == (False, 0, 0.0)
    with pytest.raises(TareError, match="no settled free motion"):
        sensor.tare()
    assert not sensor.tared


def test_the_prior_gives_the_deviation_before_taring(lwr):
    sensor = VirtualForceSensor(lwr)
    _, q, dq, tau = swing(lwr, seconds=1.0, amplitude=0.03)
    estimate = feed(sensor, rows_of(q, dq, tau - BIAS))[-1]

    assert abs(estimate.axial) < 2 * estimate.axial_std

    sensor.tare()

    assert (
        sensor.update(q[-1], dq[-1], tau[-1] - BIAS, 1e-3).axial_std
        < 0.1 * estimate.axial_std
    )


BAD = {
    "not finite": lambda q, dq, tau: (
        q,
        dq,
        np.where(np.arange(7) == 3, np.nan, tau),
        1e-3,
    ),
    "shape": lambda q, dq, tau: (q[:3], dq, tau, 1e-3),
    "not an array of numbers": lambda q, dq, tau: (q, dq, ["a"] * 7, 1e-3),
    "dq was given before": lambda q, dq, tau: (q, None, tau, 1e-3),
}


@pytest.mark.parametrize("reason", BAD)
def test_bad_sample_is_reported_and_never_used(lwr, reason):
    sensor = tared_sensor(lwr)
    twin = tared_sensor(lwr)
    _, q, dq, tau = swing(lwr, seconds=0.02, start=2.0, amplitude=0.03)
    good = sensor.update(q[0], dq[0], tau[0], 1e-3)
    twin.update(q[0], dq[0], tau[0], 1e-3)
    rejected = sensor.update(*BAD[reason](q[1], dq[1], tau[1]))

    assert rejected.status is Status.REJECTED
    assert reason in rejected.message
    assert rejected.axial == good.axial
    assert sensor.rejected == 1

    # The time of a bad sample with a valid clock still passes.
    next_one = sensor.update(q[2], dq[2], tau[2], 1e-3)

    assert next_one.axial == twin.update(q[2], dq[2], tau[2], 2e-3).axial


def test_a_clock_that_goes_back_is_waited_for(lwr):
    sensor = tared_sensor(lwr)
    twin = tared_sensor(lwr)
    _, q, dq, tau = swing(lwr, seconds=0.02, start=2.0, amplitude=0.03)
    for one in (sensor, twin):
        one.update(q[0], dq[0], tau[0], 1e-3)
    for k, dt_s in ((1, -2e-3), (2, 1e-3), (3, 0.0), (4, 1e-3)):
        assert sensor.update(q[k], dq[k], tau[k], dt_s).status is Status.REJECTED
    ours = sensor.update(q[5], dq[5], tau[5], 5e-3)

    assert ours.axial == twin.update(q[5], dq[5], tau[5], 5e-3).axial
    assert sensor.update(q[6], dq[6], tau[6], -3600.0).status is Status.REJECTED
    assert sensor.update(q[7], dq[7], tau[7], 1e-3).status is not Status.REJECTED


@pytest.mark.slow
def test_tare_in_contact_is_refused_unless_ignored(lwr):
    sensor = VirtualForceSensor(lwr)
    twin = VirtualForceSensor(lwr)
    _, q, dq, tau = swing(lwr, seconds=3.0, amplitude=0.03)
    for k in range(2995):
        touching = external_torque_of(lwr, q[k], [0.0, 0.0, 2.0]) if k > 2700 else 0.0
        for one in (sensor, twin):
            one.update(q[k], dq[k], tau[k] - touching, 1e-3)

    with pytest.raises(TareError, match="in contact"):
        sensor.tare()
    assert not sensor.tared

    ours, theirs = (
        one.update(q[2995], dq[2995], tau[2995], 1e-3) for one in (sensor, twin)
    )

    assert (ours.axial, ours.axial_std) == (theirs.axial, theirs.axial_std)

    sensor.tare(ignore_contact=True)

    assert sensor.tared


def test_external_torque_gives_the_same_force(lwr):
    sensor = VirtualForceSensor(lwr, replace(DEFAULT, mode="point"))
    q = swing(lwr, seconds=1.0, amplitude=0.03)[1]
    for k in range(500):
        sensor.update_external_torque(q[k], None, BIAS, 1e-3)
    sensor.tare()
    force = np.array([0.5, 1.0, -2.0])
    torque = BIAS + external_torque_of(lwr, q[500], force)
    estimate = sensor.update_external_torque(q[500], None, torque, 1e-3)

    np.testing.assert_allclose(estimate.force, force, atol=0.02)
    assert estimate.axial_std < 0.1

    for bad, dt_s in ((torque * np.nan, 1e-3), (torque, -1.0)):
        reported = sensor.update_external_torque(q[501], None, bad, dt_s)
        assert reported.status is Status.REJECTED


def force_noise(robot, config, amplitude):
    """Deviation of the force read in free motion with a noisy velocity, quiet or
    quick."""
    rng = np.random.default_rng(0)
    sensor = VirtualForceSensor(robot, config)
    for start_s in (0.0, 3.0):  # one motion: a robot that leaps has jumped
        _, q, dq, tau = swing(robot, seconds=3.0, amplitude=amplitude, start=start_s)
        noisy = dq + 2e-4 * rng.normal(size=dq.shape)
        forces_N = [
            sensor.update(*sample, 1e-3).axial
            for sample in zip(q, noisy, tau, strict=True)
        ]
        if not sensor.tared:
            sensor.tare()
    return np.std(forces_N[200:])


@pytest.mark.slow
def test_smoothed_momentum_is_quiet_and_follows_acceleration(lwr):
    smoothed = replace(DEFAULT, force_bandwidth_per_s=None)
    plain = replace(smoothed, smooth_momentum=False)

    assert force_noise(lwr, smoothed, 0.005) < 0.5 * force_noise(lwr, plain, 0.005)
    assert force_noise(lwr, smoothed, 0.3) < 2.0 * force_noise(lwr, plain, 0.3)


def worst_force_in_quick_free_motion(robot, config):
    """Largest force read while an arm that sends no velocity, but noisy positions,
    swings."""
    rng = np.random.default_rng(0)
    sensor = VirtualForceSensor(robot, config)
    for start_s in (0.0, 3.0):
        _, q, _, tau = swing(robot, seconds=3.0, amplitude=0.1, start=start_s)
        rows = rows_of(q + 1e-5 * rng.normal(size=q.shape), None, tau)
        forces_N = [estimate.axial_unsmoothed for estimate in feed(sensor, rows)]
        if not sensor.tared:
            sensor.tare()
    return np.abs(forces_N[500:]).max()


@pytest.mark.slow
def test_hand_settings_read_less_force_in_quick_motion(lwr):
    default = worst_force_in_quick_free_motion(lwr, DEFAULT)
    assert worst_force_in_quick_free_motion(lwr, HAND_DRIVEN) < 0.5 * default


SIX = np.ones(6)


@pytest.mark.parametrize(
    "settings",
    [
        {"gain_per_s": (50.0, 50.0)},
        {"friction": JointFriction(viscous_Nms=SIX, coulomb_Nm=SIX, offset_Nm=SIX)},
        {
            "friction": SigmoidFriction(
                amplitude_Nm=SIX, slope_s_rad=SIX, shift_rad_s=SIX
            )
        },
        {"friction": type("NoNumber", (), {"torque": lambda self, dq: dq + np.nan})()},
    ],
)
def test_settings_of_another_arm_are_refused(lwr, settings):
    with pytest.raises(ConfigurationError, match=next(iter(settings))):
        VirtualForceSensor(lwr, SensorConfig(**settings))


# A snapshot is taken back only by a sensor that would have made the same one.


def with_friction(viscous_7):
    """Settings whose friction differs in the tenth digit of one number among many."""
    viscous = np.full(7, 0.1)
    viscous[6] = viscous_7
    friction = JointFriction(
        viscous_Nms=viscous, coulomb_Nm=np.full(7, 0.2), offset_Nm=np.zeros(7)
    )
    return replace(DEFAULT, friction=friction)


def test_settings_are_compared_in_all_digits(lwr):
    state = VirtualForceSensor(lwr, with_friction(0.1)).snapshot()
    VirtualForceSensor(lwr, with_friction(0.1)).restore(state)

    with pytest.raises(SnapshotError, match="other settings"):
        VirtualForceSensor(lwr, with_friction(0.1 + 1e-10)).restore(state)


def test_a_damaged_snapshot_changes_nothing(lwr):
    sensor, rows = tared(lwr, more=0.2)
    twin, _ = tared(lwr, more=0.2)
    state = sensor.snapshot()
    for damaged in (
        state._replace(offset=replace(state.offset, recorder=None)),
        state._replace(torque_covariance=-np.eye(7)),
        state._replace(monitor=None),
        state._replace(offset=replace(state.offset, plays=np.full((6, 7), np.nan))),
    ):
        with pytest.raises(SnapshotError, match="damaged"):
            sensor.restore(damaged)
    for ours, theirs in zip(feed(sensor, rows), feed(twin, rows), strict=True):
        assert (ours.axial, ours.axial_std, ours.status) == (
            theirs.axial,
            theirs.axial_std,
            "ok",
        )
