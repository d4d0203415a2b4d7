"""What a tare says of torques that are not those of the arm, and what it leaves out."""

import numpy as np
import pytest

from residual import DEFAULT, SensorConfig, TareError, VirtualForceSensor
from tests.residual.residual_signals import (
    MIDDLE,
    external_torque_of,
    gravity_of,
    swing,
)
from urdf import NeedleTool, Payload, load_example
from urdf.payload_rating import rated_payload_kg

RATE_HZ = 250.0
EFFORT_SHARES = np.array([1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5])


NEEDLE = NeedleTool(sensor_mass_kg=0.0, sensor_height_m=0.0)


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
    "motor side": (lambda tau, _: 0.01 * tau, "1:100: multiply it by 100"),
    "motor side, sensors 4 % off": (lambda tau, _: 0.0104 * tau, "multiply it by 100"),
    "mNm": (lambda tau, _: 1000.0 * tau, "mNm read as Nm: multiply it by 0.001"),
    "negated": (lambda tau, _: -tau, "tau has the wrong sign: multiply it by -1"),
    "one joint": (
        turned(1),
        "tau of joint 2 has the wrong sign: multiply it by 1, -1, 1, 1, 1, 1, 1",
    ),
    "two joints": (exchanged(1, 3), "take its numbers 1, 4, 3, 2, 5, 6, 7"),
    "no gravity": (lambda tau, g: tau - g, "torque_is_gravity_compensated=True"),
    "per cent": (
        lambda tau, _: 100.0 * tau / [176, 176, 100, 100, 100, 38, 38],
        "per cent of each joint's effort limit: multiply it by 1.76, 1.76, 1, 1, 1, ",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", REFUSED)
def test_torques_of_another_kind_are_named_with_what_corrects_them(lwr, kind):
    bend, cure = REFUSED[kind]
    sensor = sensor_after(lwr, bend)

    with pytest.raises(TareError, match="the tare is accepted with it") as caught:
        sensor.tare()

    assert cure in str(caught.value)


NO_UNIT = {
    "a third": lambda tau, _: 0.3 * tau,
    "wrong reading of gravity": lambda tau, gravity: tau + gravity,
    "all wrong": lambda tau, _: tau * [1.0, 0.5, 2.0, 1.5, 1.0, 0.3, 1.0],
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", NO_UNIT)
def test_a_factor_that_is_no_unit_is_refused_with_what_was_seen_and_no_guess(lwr, kind):
    sensor = sensor_after(lwr, NO_UNIT[kind])
    with pytest.raises(TareError, match="expected / measured: 1: ") as caught:
        sensor.tare()

    assert caught.value.diagnosis.advice is None
    assert "multiply" not in str(caught.value)
    assert "kg" not in str(caught.value)


@pytest.mark.slow
def test_the_advised_factor_makes_the_tare_pass(lwr):
    sensor = sensor_after(lwr, lambda tau, _: 0.01 * tau)
    with pytest.raises(TareError) as caught:
        sensor.tare()
    factors = caught.value.diagnosis.advice.correction.factors
    cured = sensor_after(lwr, lambda tau, _: factors * (0.01 * tau))
    cured.tare()

    assert cured.diagnosis.advice is None
    assert cured.diagnosis.scale == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_a_fraction_of_gravity_is_not_taken_for_torque_without_gravity(lwr):
    config = SensorConfig(torque_is_gravity_compensated=True)
    sensor = sensor_after(lwr, lambda tau, _: 0.01 * tau, config)

    with pytest.raises(TareError, match="torque_is_gravity_compensated=False") as seen:
        sensor.tare()

    assert "multiply it by 100" in str(seen.value)


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
    assert sensor.diagnosis.advice is None
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
    assert sensor.diagnosis.advice is None
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
    with pytest.raises(TareError, match=r"tau of joint 4 is 1.33 \+/-") as caught:
        sensor.tare()

    assert caught.value.diagnosis.advice is None
    assert "multiply" not in str(caught.value)


def test_a_right_torque_raises_no_doubt_and_its_scale_is_known(lwr):
    sensor = sensor_after(lwr, lambda tau, _: tau)
    sensor.tare()
    diagnosis = sensor.diagnosis

    assert diagnosis.advice is None
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
def test_an_absurd_payload_is_not_named(lwr):
    sensor = sensor_after(lwr, lambda tau, _: -tau)
    with pytest.raises(TareError) as caught:
        sensor.tare()

    assert "kg" not in str(caught.value)
    assert rated_payload_kg(lwr) == 7.0


@pytest.mark.slow
def test_a_forgotten_payload_is_named_with_its_mass(lwr):
    hand = Payload(
        mass_kg=1.5, com_m=np.array([0.0, 0.0, 0.1]), inertia_kg_m2=np.zeros((3, 3))
    )
    arm = lwr.with_payload(lwr.payload + hand)
    q, dq, tau = motion(arm)
    sensor = VirtualForceSensor(lwr)
    feed(sensor, q, dq, tau)
    with pytest.raises(TareError, match=r"payload is mass_kg = 1\.8") as caught:
        sensor.tare()
    missing_kg = caught.value.diagnosis.advice.correction.payload[0]

    assert missing_kg == pytest.approx(1.5, abs=0.3)


@pytest.mark.slow
def test_at_rest_a_hanging_arm_and_a_wrong_sign_are_told_apart_by_no_guess(lwr):
    q = np.tile(MIDDLE, (750, 1))
    rng = np.random.default_rng(2)
    tau = -gravity_of(lwr, q) + 0.02 * rng.normal(size=q.shape)
    sensor = VirtualForceSensor(lwr)
    feed(sensor, q, 0.0 * q, tau)
    with pytest.raises(TareError) as caught:
        sensor.tare()

    assert caught.value.diagnosis.advice is None
    assert "no single unit, sign, order or direction of gravity" in str(caught.value)


@pytest.mark.slow
def test_a_scale_and_a_payload_at_once_are_not_guessed(lwr):
    hand = Payload(
        mass_kg=1.0, com_m=np.array([0.0, 0.0, 0.05]), inertia_kg_m2=np.zeros((3, 3))
    )
    q, dq, tau = motion(lwr.with_payload(lwr.payload + hand))
    sensor = VirtualForceSensor(lwr)
    feed(sensor, q, dq, 0.5 * tau)
    with pytest.raises(TareError) as caught:
        sensor.tare()

    assert caught.value.diagnosis.advice is None


@pytest.mark.slow
def test_a_sign_that_does_not_show_is_not_named_beside_gravity_that_is_added_twice(lwr):
    config = SensorConfig(torque_is_gravity_compensated=True)
    sensor = sensor_after(lwr, lambda tau, _: tau, config)
    with pytest.raises(TareError) as caught:
        sensor.tare()

    assert caught.value.diagnosis.advice.kind == "gravity"


@pytest.mark.slow
def test_an_upright_arm_is_named_where_a_wall_was_told(lwr):
    q, dq, tau = motion(lwr)
    on_wall = load_example("lwr4plus", payload=lwr.payload, gravity_m_s2=(9.81, 0, 0))
    sensor = VirtualForceSensor(on_wall)
    feed(sensor, q, dq, tau)
    with pytest.raises(TareError, match=r"gravity in base axes is \(0, 0, -9.81\)"):
        sensor.tare()


@pytest.mark.slow
def test_joints_in_the_order_of_the_alphabet_are_named():
    # As ROS drivers send them: elbow, lift, pan.
    arm = load_example("ur5e", payload=NEEDLE)
    middle = [0.3, -1.2, 1.4, -1.0, -1.3, 0.4]
    _, q, dq, tau = swing(arm, seconds=4.0, rate_hz=RATE_HZ, middle=middle)
    sensor = VirtualForceSensor(arm)
    order = [2, 1, 0, 3, 4, 5]
    tau = tau + 0.02 * np.random.default_rng(3).normal(size=tau.shape)
    feed(sensor, q[:, order], dq[:, order], tau[:, order])
    with pytest.raises(TareError, match=r"q, dq and tau have .* elbow_joint") as caught:
        sensor.tare()
    advice = caught.value.diagnosis.advice
    cured = VirtualForceSensor(arm)
    columns = list(advice.correction.order)
    feed(cured, *(one[:, order][:, columns] for one in (q, dq, tau)))
    cured.tare()

    assert columns == order
    assert advice.correction.is_order_of_all


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5", "ur3", "ur10"])
def test_a_wrong_arm_becomes_no_factor_and_no_payload(name):
    arm = load_example("ur5e", payload=NEEDLE)
    middle = [0.3, -1.2, 1.4, -1.0, -1.3, 0.4]
    _, q, dq, tau = swing(arm, seconds=4.0, rate_hz=RATE_HZ, middle=middle)
    tau = tau + 0.02 * np.random.default_rng(4).normal(size=tau.shape)
    sensor = VirtualForceSensor(load_example(name, payload=NEEDLE))
    feed(sensor, q, dq, tau)
    with pytest.raises(TareError) as caught:
        sensor.tare()
    motion = caught.value.diagnosis.motion

    assert caught.value.diagnosis.advice is None
    assert sensor.judge_motion(motion) is None
    assert VirtualForceSensor(arm).judge_motion(motion) is not None
