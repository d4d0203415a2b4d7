"""What a tare measures of the torques, and which torques it refuses."""

import numpy as np
import pytest

from residual import DEFAULT, SensorConfig, TareError, VirtualForceSensor
from tests.residual.guarded_sensor import at, feed, rows_of
from tests.residual.residual_signals import external_torque_of, gravity_of, swing
from urdf import Payload

pytestmark = pytest.mark.slow

DT_S = 4e-3
COMPENSATED = SensorConfig(torque_is_gravity_compensated=True)


def sensor_after(
    robot, bend=lambda tau, _: tau, config=DEFAULT, amplitude=0.2, model=None
):
    """A sensor with a model that has seen an arm's noisy swing with bent torques."""
    _, q, dq, tau = swing(robot, seconds=3.0, rate_hz=1.0 / DT_S, amplitude=amplitude)
    rng = np.random.default_rng(0)
    offset_Nm = 0.3 * rng.uniform(-1.0, 1.0, 7) * ([1.0] * 4 + [0.5] * 3)
    tau = tau + offset_Nm + 0.02 * rng.normal(size=tau.shape)
    sensor = VirtualForceSensor(model or robot, config)
    rows = rows_of(q, dq, bend(tau, gravity_of(robot, q)))
    feed(sensor, rows, DT_S)
    return sensor, rows[-1]


def scaled(joint, factor):
    return lambda tau, _: tau * (1.0 + at(joint, factor - 1.0))


REFUSED = {
    "motor side": (lambda tau, _: 0.01 * tau, DEFAULT),
    "negated": (lambda tau, _: -tau, DEFAULT),
    "one joint": (scaled(1, -1.0), DEFAULT),
    "two joints": (lambda tau, _: tau[:, [0, 3, 2, 1, 4, 5, 6]], DEFAULT),
    "no gravity": (lambda tau, gravity: tau - gravity, DEFAULT),
    "gravity twice": (lambda tau, _: tau, COMPENSATED),
    "per cent": (lambda tau, _: tau / [1.76, 1.76, 1, 1, 1, 0.38, 0.38], DEFAULT),
    "a third": (lambda tau, _: 0.3 * tau, DEFAULT),
    "wrong reading of gravity": (lambda tau, gravity: tau + gravity, DEFAULT),
    "all wrong": (lambda tau, _: tau * [1.0, 0.5, 2.0, 1.5, 1.0, 0.3, 1.0], DEFAULT),
    "one joint like a contact": (scaled(3, 1.33), DEFAULT),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_torques_of_another_kind_are_refused_and_may_be_taken(lwr, kind):
    bend, config = REFUSED[kind]
    sensor, _ = sensor_after(lwr, bend, config)
    with pytest.raises(TareError, match="units"):
        sensor.tare()

    sensor.tare(ignore_contact=True)

    assert sensor.diagnosis is None


@pytest.mark.parametrize(
    ("bend", "config"),
    [
        (lambda tau, _: tau, DEFAULT),
        (lambda tau, gravity: tau - gravity, COMPENSATED),
    ],
)
def test_right_torques_have_a_scale_of_one(lwr, bend, config):
    sensor, _ = sensor_after(lwr, bend, config)
    tare = sensor.tare()
    found = sensor.diagnosis

    assert (found.deviating_joints, tare.scale_std) == (
        [],
        pytest.approx(0.0, abs=0.05),
    )
    assert abs(found.scale - 1.0) < min(0.1, 3.0 * found.scale_std)
    assert found.scale_std < 0.1


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_a_factor_near_one_is_measured_and_widens_the_force(lwr, factor):
    sensor, (q, dq, tau) = sensor_after(
        lwr, lambda tau, _: factor * tau, amplitude=0.05
    )
    sensor.tare()
    pushed_Nm = tau - factor * external_torque_of(lwr, q, [0.0, 0.0, 20.0])
    found = feed(sensor, [(q, 0.0 * dq, pushed_Nm)] * 100, DT_S)[-1]

    assert (sensor.diagnosis.scale, sensor.diagnosis.scale_deviates) == (
        pytest.approx(factor, abs=0.05),
        True,
    )
    assert found.axial_std > 0.7 * abs(factor - 1.0) * abs(found.axial)


@pytest.mark.parametrize(("joint", "scale_std"), [(1, 0.33), (5, 0.0)])
def test_a_scale_of_one_joint_widens_the_force_by_its_lever(lwr, joint, scale_std):
    sensor, _ = sensor_after(lwr, scaled(joint, 1.33))
    tare = sensor.tare()
    found = sensor.diagnosis

    assert (found.deviating_joints, tare.scale_std) == (
        [joint],
        pytest.approx(scale_std, abs=0.05),
    )
    assert f"joint {joint + 1} " in found.describe()


def test_what_a_motion_cannot_show_is_said(lwr):
    # Upright, no joint but by offsets has torque against gravity.
    q = np.zeros((750, 7))
    tau = gravity_of(lwr, q) + 0.02 * np.random.default_rng(1).normal(size=q.shape)
    sensor = VirtualForceSensor(lwr)
    feed(sensor, rows_of(q, 0.0 * q, tau), DT_S)
    sensor.tare()

    assert sensor.diagnosis.describe() == ""
    assert "1, 2, 3, 4, 5, 6, 7" in sensor.diagnosis.describe_unchecked()


def with_hand(robot, mass_kg):
    com_m = np.array([0.0, 0.0, 0.1])
    hand = Payload(mass_kg=mass_kg, com_m=com_m, inertia_kg_m2=np.zeros((3, 3)))
    return robot.with_payload(robot.payload + hand)


@pytest.mark.parametrize(
    ("on_arm_kg", "in_model_kg", "missing_kg"),
    [(1.5, 0.0, 1.5), (2.5, 0.0, 2.5), (0.0, 0.76, -0.7)],
)
def test_a_wrong_payload_is_refused_and_measured(
    lwr, on_arm_kg, in_model_kg, missing_kg
):
    arm, model = (with_hand(lwr, kg) for kg in (on_arm_kg, in_model_kg))
    sensor, _ = sensor_after(arm, amplitude=0.3, model=model)
    with pytest.raises(TareError) as caught:
        sensor.tare()

    found = caught.value.diagnosis
    assert found.payload_kg == pytest.approx(missing_kg, abs=0.3)
    assert abs(found.payload_kg) > 3.0 * found.payload_std_kg > 0.0
