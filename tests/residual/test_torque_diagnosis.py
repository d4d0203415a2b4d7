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
from urdf import Payload, load_example
from urdf.payload_rating import rated_payload_kg

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
    "a third": (lambda tau, _: 0.3 * tau, "TORQUE_SCALE", "factors", "3.3"),
    "motor side": (lambda tau, _: 0.01 * tau, "TORQUE_SCALE", "factors", "100"),
    "mNm": (lambda tau, _: 1000.0 * tau, "TORQUE_SCALE", "factors", "0.001"),
    "negated": (lambda tau, _: -tau, "TORQUE_SIGN", "factors", "-1"),
    "one joint": (turned(1), "TORQUE_SIGN", "factors", "1,-1,1,1,1,1,1"),
    "two joints": (exchanged(1, 3), "JOINT_ORDER", "order", "1,4,3,2,5,6,7"),
    "no gravity": (lambda tau, g: tau - g, "GRAVITY_MISSING", "", ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", REFUSED)
def test_torques_of_another_kind_are_named_with_what_corrects_them(lwr, kind):
    bend, code, place, value = REFUSED[kind]
    sensor = sensor_after(lwr, bend)

    with pytest.raises(TareError, match="corrected, the sensor reads") as caught:
        sensor.tare()

    assert caught.value.code.name == code
    assert caught.value.places.get(place, "").startswith(value)


@pytest.mark.slow
def test_the_advised_factor_makes_the_tare_pass(lwr):
    sensor = sensor_after(lwr, lambda tau, _: 0.3 * tau)
    with pytest.raises(TareError) as caught:
        sensor.tare()
    factor = float(caught.value.places["factors"])
    cured = sensor_after(lwr, lambda tau, _: factor * (0.3 * tau))
    cured.tare()

    assert cured.diagnosis.findings == ()
    assert cured.diagnosis.scale == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_a_fraction_of_gravity_is_not_taken_for_torque_without_gravity(lwr):
    config = SensorConfig(torque_is_gravity_compensated=True)
    sensor = sensor_after(lwr, lambda tau, _: 0.01 * tau, config)

    with pytest.raises(TareError, match="must not be added") as caught:
        sensor.tare()

    assert caught.value.code.name == "TORQUE_SCALE"


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_a_factor_near_one_is_named_and_widens_the_force(lwr, factor):
    sensor = sensor_after(lwr, lambda tau, _: factor * tau, amplitude=0.05)
    sensor.tare()
    codes = {one.cause.code.name for one in sensor.diagnosis.findings}
    q, dq, tau = motion(lwr, amplitude=0.05)
    pushed = factor * (tau[-1] - external_torque_of(lwr, q[-1], [0.0, 0.0, 20.0]))
    for _ in range(100):
        estimate = sensor.update(q[-1], 0.0 * dq[-1], pushed, 1.0 / RATE_HZ)

    assert "TORQUE_SCALE" in codes
    assert estimate.axial_std > 0.7 * abs(factor - 1.0) * abs(estimate.axial)


def test_a_right_torque_raises_no_doubt_and_its_scale_is_known(lwr):
    sensor = sensor_after(lwr, lambda tau, _: tau)
    sensor.tare()
    diagnosis = sensor.diagnosis

    assert diagnosis.findings == ()
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
    try:
        sensor.tare()
        findings = sensor.diagnosis.findings
    except TareError as error:
        findings = error.diagnosis.findings
    payload = next(one for one in findings if one.cause.code.name == "PAYLOAD")

    assert payload.hypothesis.correction.payload[0] == pytest.approx(1.5, abs=0.3)
    # The given payload and the missing one, as a file for --payload has them.
    assert payload.cause.places["payload"].startswith("mass_kg = 1.")


@pytest.mark.slow
def test_an_arm_on_the_ceiling_is_named(lwr):
    q = np.tile(MIDDLE, (750, 1))
    rng = np.random.default_rng(2)
    tau = -gravity_of(lwr, q) + 0.02 * rng.normal(size=q.shape)
    sensor = VirtualForceSensor(lwr)
    feed(sensor, q, 0.0 * q, tau)
    with pytest.raises(TareError) as caught:
        sensor.tare()
    codes = {caught.value.code.name, *(a.code.name for a in caught.value.alternatives)}

    assert codes == {"TORQUE_SIGN", "GRAVITY_DIRECTION"}
    assert "How the arm is mounted tells them apart" in str(caught.value)


def test_gravity_twice_in_the_torque_is_not_named_a_factor_that_hides_forces(lwr):
    sensor = sensor_after(lwr, lambda tau, gravity: tau + gravity)
    with pytest.raises(TareError) as caught:
        sensor.tare()
    assert not caught.value.diagnosis.findings


@pytest.mark.slow
def test_a_scale_and_a_payload_at_once_are_named_together(lwr):
    hand = Payload(
        mass_kg=1.0, com_m=np.array([0.0, 0.0, 0.05]), inertia_kg_m2=np.zeros((3, 3))
    )
    q, dq, tau = motion(lwr.with_payload(lwr.payload + hand))
    sensor = VirtualForceSensor(lwr)
    feed(sensor, q, dq, 0.5 * tau)
    with pytest.raises(TareError) as caught:
        sensor.tare()
    first = caught.value.diagnosis.findings[0]
    assert first.hypothesis.kind == "scale and payload"
    assert first.hypothesis.scale == pytest.approx(0.5, abs=0.05)


@pytest.mark.slow
def test_a_sign_that_does_not_show_is_not_named_beside_gravity_that_is_added_twice(lwr):
    config = SensorConfig(torque_is_gravity_compensated=True)
    sensor = sensor_after(lwr, lambda tau, _: tau, config)
    with pytest.raises(TareError) as caught:
        sensor.tare()
    kinds = [one.hypothesis.kind for one in caught.value.diagnosis.findings]
    assert kinds == ["gravity"]


@pytest.mark.slow
def test_an_upright_arm_is_not_said_to_hang_where_a_wall_was_told(lwr):
    q, dq, tau = motion(lwr)
    on_wall = load_example("lwr4plus", payload=lwr.payload, gravity_m_s2=(9.81, 0, 0))
    sensor = VirtualForceSensor(on_wall)
    feed(sensor, q, dq, tau)
    with pytest.raises(TareError, match="stands upright"):
        sensor.tare()
