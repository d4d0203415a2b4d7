"""The momentum residual and the velocity that it is given keep their laws."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from residual import (
    JointFriction,
    MomentumObserver,
    SigmoidFriction,
    VelocityEstimator,
)
from residual.momentum_observer import momentum_smoothing_step
from tests.residual.guarded_sensor import feed, rows_of
from tests.residual.residual_signals import external_torque_of, swing
from urdf import Robot

FEW = settings(max_examples=20)


TICK_S = 2.0**-10  # which the rounding of time steps leaves as it is


def residuals(robot, rows, dt_s=TICK_S, gain=50.0, **kinds):
    return np.array(feed(MomentumObserver(robot, gain, **kinds), rows, dt_s))


@pytest.fixture(scope="module")
def askew():
    """Sliding and turning joints along odd directions, a branch, and rotors."""
    model = pin.Model()
    along = np.array([0.6, 0.0, 0.8])
    joints = [
        pin.JointModelRX(),
        pin.JointModelPY(),
        pin.JointModelRevoluteUnaligned(along),
        pin.JointModelPrismaticUnaligned(-along),
    ]
    pin.seed(1)
    for k, parent in enumerate((0, 1, 2, 1, 4, 5, 5)):
        model.addJoint(parent, joints[k % 4], pin.SE3.Random(), f"j{k}")
        model.appendBodyToJoint(k + 1, pin.Inertia.Random(), pin.SE3.Identity())
    arm = Robot(bare_model=model, tool_frame="universe", flange_frame="universe")
    return arm.with_armature(np.linspace(0.0, 0.6, 7))


@pytest.mark.parametrize("alignment", ["hold", "trapezoid"])
@pytest.mark.parametrize("arm", ["lwr", "askew"])
def test_a_step_is_the_equation_on_the_matrices(arm, alignment, request):
    robot = request.getfixturevalue(arm)
    gain = np.linspace(10.0, 80.0, 7)
    _, q, dq, tau = swing(robot, seconds=0.1, amplitude=1.0, rate_hz=1024.0)
    data = robot.create_data()
    momentum, other = np.zeros((2, *q.shape))
    for k in range(len(q)):
        momentum[k] = pin.crba(robot.model, data, q[k]) @ dq[k]
        coriolis = pin.computeCoriolisMatrix(robot.model, data, q[k], dq[k])
        other[k] = coriolis.T @ dq[k]
        other[k] -= pin.computeGeneralizedGravity(robot.model, data, q[k])
    torque = tau[:-1] if alignment == "hold" else (tau[:-1] + tau[1:]) / 2
    target = np.diff(momentum, axis=0) / TICK_S - (other[:-1] + other[1:]) / 2 - torque
    found = residuals(robot, rows_of(q, dq, tau), gain=gain, alignment=alignment)
    remaining = np.exp(-TICK_S * gain)
    expected = remaining * found[:-1] + (1.0 - remaining) * target

    np.testing.assert_allclose(found[0], 0.0)
    np.testing.assert_allclose(found[1:], expected, atol=1e-10)


@FEW
@given(
    force=st.tuples(*[st.floats(-20.0, 20.0)] * 3),
    gain=st.floats(5.0, 400.0),
    start=st.floats(0.0, 5.0),
    alignment=st.sampled_from(["hold", "trapezoid"]),
    stride=st.sampled_from([1, 2, 4]),
)
def test_a_force_is_reached_exponentially_from_any_motion(
    lwr, force, gain, start, alignment, stride
):
    """Without a force the residual stays zero; halving the step changes nothing."""
    _, *motion = swing(lwr, seconds=0.1, start=start, amplitude=0.03, rate_hz=1024.0)
    q, dq, tau = (values[::stride] for values in motion)
    dt_s = TICK_S * stride
    change = external_torque_of(lwr, q[0], force)
    free, under = (
        residuals(lwr, rows_of(q, dq, tau - one), dt_s, gain, alignment=alignment)
        for one in (0.0, change)
    )
    times_s = dt_s * np.arange(len(q))

    assert np.abs(free).max() < (0.02 if alignment == "trapezoid" else 0.2)
    np.testing.assert_allclose(
        under - free, np.outer(-np.expm1(-gain * times_s), change), atol=1e-9
    )


def test_a_gap_in_time_is_not_integrated_and_reset_forgets(lwr):
    rows = rows_of(*swing(lwr, seconds=2.0)[1:])
    observer = MomentumObserver(lwr, 50.0)
    feed(observer, rows[:100])
    kept = observer.update(*rows[1500], 1.4)

    assert np.abs(kept).max() < 1e-3 > np.abs(observer.update(*rows[1501], 1e-3)).max()
    assert not kept.flags.writeable

    observer.reset()
    np.testing.assert_array_equal(
        feed(observer, rows[:9]), residuals(lwr, rows[:9], 1e-3)
    )


@pytest.mark.parametrize(
    ("distance", "per_s"), [(0.01, 10.0), (1.0, 20.0), (2.0, 170.0)]
)
def test_momentum_far_behind_catches_up_sooner(distance, per_s):
    # What it is behind by becomes the estimate's step.
    assert momentum_smoothing_step(distance, 0.0, 1.0, 1e-6) == pytest.approx(
        distance * per_s * 1e-6, rel=1e-3
    )


SOUND = {"viscous_Nms": [2.0], "coulomb_Nm": [1.0], "offset_Nm": [0.25]}
SIGMOID = SigmoidFriction(amplitude_Nm=[0.5], slope_s_rad=[5.0], shift_rad_s=[0.04])


@pytest.mark.parametrize(
    ("friction", "speed", "torque"),
    [
        (JointFriction(**SOUND), 0.5, 2.25),
        (JointFriction(**SOUND), -0.5, -1.75),
        (JointFriction(**SOUND), 0.0, 0.25),
        (SIGMOID, 0.0, 0.0),
        (SIGMOID, 0.3, 0.5 / (1 + np.exp(-1.7)) - 0.5 / (1 + np.exp(-0.2))),
    ],
)
def test_friction_follows_its_formula(friction, speed, torque):
    assert friction.torque(np.array([speed]))[0] == pytest.approx(torque)


def test_modelled_friction_does_not_read_as_force(lwr):
    friction = JointFriction(
        **{name: np.repeat(value, 7) for name, value in SOUND.items()}
    )
    _, q, dq, tau = swing(lwr, seconds=0.5)
    rows = rows_of(q, dq, tau + [friction.torque(one) for one in dq])

    assert np.abs(residuals(lwr, rows, 1e-3, friction=friction)).max() < 0.01


# Velocity from position, with torque delayed to match.


@given(
    rate=st.floats(-2.0, 2.0),
    bandwidth=st.floats(50.0, 400.0),
    steps_s=st.lists(st.floats(2e-4, 4e-3), min_size=5, max_size=5),
)
def test_a_ramp_has_exact_velocity_and_stated_delay(rate, bandwidth, steps_s):
    estimator = VelocityEstimator(1, bandwidth)
    time_s = 0.0
    while time_s < 30.0 / bandwidth:
        for dt_s in steps_s:
            time_s += dt_s
            found = estimator.update([rate * time_s], [rate * time_s], dt_s)
    late = rate * (time_s - estimator.delay_s)

    assert found.settled
    assert np.r_[found.dq, found.q, found.tau] == pytest.approx(
        [rate, late, late], abs=1e-6
    )


def test_velocity_noise_follows_its_formula():
    rng = np.random.default_rng(0)
    estimator = VelocityEstimator(200, 100.0)
    noise = [
        estimator.update(1e-5 * rng.normal(size=200), np.zeros(200), 1e-3).dq
        for _ in range(500)
    ]

    assert np.std(noise[200:]) == pytest.approx(
        1e-5 * np.sqrt(1e-3 * 100.0**3 / 4), rel=0.15
    )


def test_matched_delay_keeps_motion_from_reading_as_force(lwr):
    _, q, _, tau = swing(lwr, seconds=1.5)
    estimator = VelocityEstimator(7, 100.0)
    found = [estimator.update(*one, 1e-3) for one in zip(q, tau, strict=True)][500:]

    assert all(one.settled for one in found)
    assert np.abs(residuals(lwr, [one[:3] for one in found], 1e-3)).max() < 0.005


@pytest.mark.parametrize(("alignment", "is_held"), [("hold", 1), ("trapezoid", 0)])
def test_a_held_torque_is_filtered_as_held_and_a_gap_starts_anew(alignment, is_held):
    estimator = VelocityEstimator(1, 100.0, alignment=alignment)
    estimator.update([0.0], [1.0], 1e-3)

    assert (estimator.update([0.0], [0.0], 1e-3).tau[0] == 1.0) == is_held

    found = estimator.update([1.0], [0.0], 0.5)

    assert (found.settled, found.dq[0]) == (False, 0.0)
