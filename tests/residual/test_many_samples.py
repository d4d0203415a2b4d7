"""Many samples at once are estimated as one by one."""

from dataclasses import replace

import numpy as np
import pytest

from residual import DEFAULT, SensorConfig, SensorWarning, Status, VirtualForceSensor
from residual.estimate_rows import AXIAL, AXIAL_STD, LATERAL, LATERAL_STD, UNSMOOTHED
from tests.residual.guarded_sensor import signals
from tests.residual.residual_signals import gravity_of

STATUSES = {status: number for number, status in enumerate(Status)}
TARED = 2000
ROWS = 2600
"""As many as it takes for a torque that jumps to be found, and blocks of 700."""


def measured(robot, config, rows):
    """Signals of a driver that subtracts gravity from the torque, or does not."""
    q, dq, tau = signals(robot, 1e-3 * rows)
    if config.torque_is_gravity_compensated:
        tau = tau - gravity_of(robot, q)
    return q, dq, tau


def faulty_signals(robot, config, with_velocity):
    """Samples after the tare, with all that a log may have, and their time steps."""
    q, dq, tau = (values[TARED:] for values in measured(robot, config, TARED + ROWS))
    dt_s = np.full(len(q), 1e-3)
    dt_s += 1e-5 * np.random.default_rng(1).normal(size=len(q)).clip(-3.0, 3.0)
    dt_s[:300] = 1e-3
    q[150, 2] = np.nan
    tau[220, 3] += 60.0  # a spike
    dt_s[310] = 0.0  # a stamp that comes twice
    dt_s[400] = 0.3  # a gap
    tau[900:960] = tau[900]  # frozen
    q[900:960] = q[900]
    dq[900:960] = dq[900]
    dt_s[1100] = 1e6  # a clock that was set
    tau[1200:, 1] += 1.5  # a sensor that jumps, and stays there
    tau[2300, 0] = robot.effort_limit_Nm[0] * 1.01
    q[2400:, 4] += 0.01  # a position that jumps, and stays there
    return q, dq if with_velocity else None, tau, dt_s


def one_by_one(sensor, q, dq, torque, dt_s, update):
    estimates = []
    for row in range(len(q)):
        velocity = None if dq is None else dq[row]
        estimates.append(update(q[row], velocity, torque[row], dt_s.item(row)))
    return estimates


def twins(robot, config, with_velocity, is_external):
    """Two sensors that were tared on the same motion."""
    q, dq, tau = measured(robot, config, TARED)
    first = VirtualForceSensor(robot, config)
    second = VirtualForceSensor(robot, config)
    update = first.update_external_torque if is_external else first.update
    one_by_one(
        first, q, dq if with_velocity else None, tau, np.full(TARED, 1e-3), update
    )
    first.tare(ignore_contact=is_external)
    second.restore(first.snapshot())
    return first, second


@pytest.mark.slow
@pytest.mark.parametrize(
    ("with_velocity", "settings", "is_external"),
    [
        (True, {}, False),
        (False, {}, False),
        (True, {"mode": "axial", "axes": "tool"}, False),
        (True, {"mode": "full", "guard": False}, False),
        (True, {"torque_is_gravity_compensated": True, "alignment": "hold"}, False),
        (True, {}, True),
        (False, {"mode": "full"}, True),
    ],
)
def test_many_samples_are_estimated_as_one_by_one(
    lwr, with_velocity, settings, is_external
):
    config: SensorConfig = replace(DEFAULT, **settings)
    sensor, twin = twins(lwr, config, with_velocity, is_external)
    q, dq, tau, dt_s = faulty_signals(lwr, config, with_velocity)
    update = twin.update_external_torque if is_external else twin.update
    singles = []
    start = 0
    while start < ROWS:
        block = slice(start, start + 700)
        velocity = None if dq is None else dq[block]
        rows = sensor.update_rows(
            q[block], velocity, tau[block], dt_s[block], is_external=is_external
        )
        singles = one_by_one(twin, q[block], velocity, tau[block], dt_s[block], update)
        start += 700

        assert rows.statuses(STATUSES).tolist() == [
            STATUSES[one.status] for one in singles
        ]
        assert rows.warnings.tolist() == [int(one.warnings) for one in singles]
        for column, name in (
            (AXIAL, "axial"),
            (AXIAL_STD, "axial_std"),
            (LATERAL, "lateral"),
            (LATERAL_STD, "lateral_std"),
            (UNSMOOTHED, "axial_unsmoothed"),
        ):
            expected = [getattr(one, name) for one in singles]
            np.testing.assert_allclose(
                rows.numbers[:, column], expected, rtol=1e-12, atol=1e-12, err_msg=name
            )
        forces = [np.concatenate((one.force, one.torque)) for one in singles]
        np.testing.assert_allclose(
            rows.wrench, np.array(forces)[:, : rows.wrench.shape[1]], atol=1e-12
        )
        np.testing.assert_allclose(
            rows.variances, [one.covariance.diagonal() for one in singles], rtol=1e-12
        )
        np.testing.assert_allclose(
            rows.model_mismatch, [one.model_mismatch for one in singles], rtol=1e-12
        )
        ours = {
            note.first_row: note.assessment.message
            for note in rows.notes
            if note.assessment.status is Status.REJECTED
        }
        assert ours == {
            row: one.message
            for row, one in enumerate(singles)
            if one.status is Status.REJECTED
        }
        last = sensor.recheck(singles[-1])
        assert last.warnings == twin.recheck(singles[-1]).warnings
        np.testing.assert_array_equal(sensor.kinematics.pose, twin.kinematics.pose)
        np.testing.assert_array_equal(sensor.velocity_rad_s, twin.velocity_rad_s)

    assert sensor.rejected == twin.rejected
    assert sensor.jumps == twin.jumps
    assert sensor.elapsed_s == twin.elapsed_s
    if config.guard and not is_external:
        assert {int(one.warnings) & SensorWarning.SPIKE for one in singles} == {0, 1}
