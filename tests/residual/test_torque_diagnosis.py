"""What a tare says of torques that are not those of the arm, and what it leaves out."""

import numpy as np
import pytest

from residual import DEFAULT, TareError, VirtualForceSensor
from tests.residual.residual_signals import (
    external_torque_of,
    gravity_of,
    swing,
)
from urdf import Payload

RATE_HZ = 250.0
EFFORT_SHARES = np.array([1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5])


def motion(robot, *, amplitude=0.2):
    """Positions, velocities and torques of a noisy arm that swings freely."""
    _, q, dq, tau = swing(robot, seconds=3.0, rate_hz=RATE_HZ, amplitude=amplitude)
    rng = np.random.default_rng(0)
    offset = 0.3 * EFFORT_SHARES * rng.uniform(-1.0, 1.0, robot.nv)
    return q, dq, tau + offset + 0.02 * rng.normal(size=tau.shape)


def feed(sensor, q, dq, tau):
    for row in zip(q, dq, tau, strict=True):
        estimate = sensor.update(*row, 1.0 / RATE_HZ)
    return estimate


def sensor_after(robot, bend, config=DEFAULT, amplitude=0.2):
    """A sensor that has seen the motion of the arm with bent torques."""
    q, dq, tau = motion(robot, amplitude=amplitude)
    sensor = VirtualForceSensor(robot, config)
    feed(sensor, q, dq, bend(tau, gravity_of(robot, q)))
    return sensor


def turned(joint):
    factors = np.ones(7)
    factors[joint] = -1.0
    return lambda tau, _: tau * factors


def exchanged(first, second):
    order = list(range(7))
    order[first] = second
    order[second] = first
    return lambda tau, _: tau[:, order]


REFUSED = {
    "motor side": lambda tau, _: 0.01 * tau,
    "negated": lambda tau, _: -tau,
    "one joint": turned(1),
    "two joints": exchanged(1, 3),
    "no gravity": lambda tau, g: tau - g,
    "per cent": lambda tau, _: 100.0 * tau / [176, 176, 100, 100, 100, 38, 38],
    "a third": lambda tau, _: 0.3 * tau,
    "wrong reading of gravity": lambda tau, gravity: tau + gravity,
    "all wrong": lambda tau, _: tau * [1.0, 0.5, 2.0, 1.5, 1.0, 0.3, 1.0],
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", REFUSED)
def test_torques_of_another_kind_are_refused(lwr, kind):
    sensor = sensor_after(lwr, REFUSED[kind])
    with pytest.raises(TareError, match="units, signs, order, payload"):
        sensor.tare()


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_a_factor_near_one_is_measured_and_widens_the_force(lwr, factor):
    sensor = sensor_after(lwr, lambda tau, _: factor * tau, amplitude=0.05)
    sensor.tare()
    q, dq, tau = motion(lwr, amplitude=0.05)
    pushed = factor * (tau[-1] - external_torque_of(lwr, q[-1], [0.0, 0.0, 20.0]))
    for _ in range(100):
        estimate = sensor.update(q[-1], 0.0 * dq[-1], pushed, 1.0 / RATE_HZ)

    assert sensor.diagnosis.scale == pytest.approx(factor, abs=0.05)
    assert sensor.diagnosis.scale_deviates
    assert estimate.axial_std > 0.7 * abs(factor - 1.0) * abs(estimate.axial)


@pytest.mark.slow
def test_a_wrong_scale_of_one_joint_is_said_and_widens_the_force(lwr):
    factors = np.ones(7)
    factors[1] = 1.33
    sensor = sensor_after(lwr, lambda tau, _: tau * factors)
    tare = sensor.tare()

    assert sensor.diagnosis.deviating_joints == [1]
    assert sensor.diagnosis.describe_one_joint().startswith(
        "tau of joint 2 is 1.33 +/-"
    )
    assert tare.scale_std == pytest.approx(0.33, abs=0.05)


@pytest.mark.slow
def test_a_wrong_scale_of_a_joint_without_a_lever_does_not_widen_the_force(lwr):
    factors = np.ones(7)
    factors[5] = 1.33
    sensor = sensor_after(lwr, lambda tau, _: tau * factors)
    tare = sensor.tare()

    assert sensor.diagnosis.deviating_joints == [5]
    assert tare.scale_std < 0.05


@pytest.mark.slow
def test_a_wrong_scale_of_one_joint_that_looks_like_a_contact_is_refused(lwr):
    factors = np.ones(7)
    factors[3] = 1.33
    sensor = sensor_after(lwr, lambda tau, _: tau * factors)
    with pytest.raises(TareError, match=r"tau of joint 4 is 1.33 \+/-"):
        sensor.tare()


def test_a_right_torque_raises_no_doubt_and_its_scale_is_known(lwr):
    sensor = sensor_after(lwr, lambda tau, _: tau)
    sensor.tare()
    diagnosis = sensor.diagnosis

    assert abs(diagnosis.scale - 1.0) < 3.0 * diagnosis.scale_std < 0.3
    assert diagnosis.joint_scale[1] == pytest.approx(1.0, abs=0.2)


def test_what_a_motion_cannot_show_is_said(lwr):
    # Upright, no joint but by offsets has torque against gravity.
    q = np.zeros((750, 7))
    rng = np.random.default_rng(1)
    tau = gravity_of(lwr, q) + 0.02 * rng.normal(size=q.shape)
    sensor = VirtualForceSensor(lwr)
    feed(sensor, q, 0.0 * q, tau)
    sensor.tare()

    assert not sensor.diagnosis.is_scale_known
    assert "joints 1, 2, 3, 4, 5, 6, 7 not checked" in (
        sensor.diagnosis.describe_unchecked()
    )


@pytest.mark.slow
def test_a_forgotten_payload_is_measured(lwr):
    hand = Payload(
        mass_kg=1.5, com_m=np.array([0.0, 0.0, 0.1]), inertia_kg_m2=np.zeros((3, 3))
    )
    arm = lwr.with_payload(lwr.payload + hand)
    q, dq, tau = motion(arm)
    sensor = VirtualForceSensor(lwr)
    feed(sensor, q, dq, tau)
    with pytest.raises(TareError) as caught:
        sensor.tare()

    assert caught.value.diagnosis.payload_kg == pytest.approx(1.5, abs=0.3)
