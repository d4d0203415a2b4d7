"""The momentum residual: its exact step and the observer around it."""

from copy import deepcopy as copy

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from residual import (
    ConfigurationError,
    JointFriction,
    MomentumObserver,
    SigmoidFriction,
    VelocityEstimator,
)
from residual.checks.input import round_step
from residual.momentum_observer import (
    ROWS,
    momentum_smoothing_step,
    set_step_weights,
)
from residual.velocity_filter import lag_pair_coefficients
from tests.residual.guarded_sensor import feed, rows_of
from tests.residual.residual_signals import JOINTS, external_torque_of, swing
from urdf import Robot

numbers = st.floats(-100.0, 100.0)


def rows(momentum, coriolis, gravity, torque, residual=0.0):
    return np.array([[residual], [momentum], [coriolis], [gravity], [torque]])


def step(before, after, gain, dt_s, alignment="trapezoid"):
    """Residual at the end of a tick, shape (n,), from rows as above at its start and
    its end."""
    known = np.concatenate((before, after[1:]))
    gains = np.atleast_1d(np.asarray(gain, dtype=float))
    weights = np.empty((len(gains), ROWS))
    set_step_weights(weights, gains, dt_s, alignment == "hold")
    return (weights.T * known).sum(axis=0)


@given(
    residual=numbers,
    slope=numbers,
    held=numbers,
    gain=st.floats(0.1, 1000.0),
    dt=st.floats(1e-5, 0.05),
)
def test_half_steps_equal_one_for_held_input(residual, slope, held, gain, dt):
    gain = np.array([gain])
    start = rows(0.0, 1.0, 2.0, held, residual)
    middle = rows(slope * dt / 2, 1.0, 2.0, held)
    end = rows(slope * dt, 1.0, 2.0, held)
    whole = step(start, end, gain, dt)
    middle[0] = step(start, middle, gain, dt / 2)

    assert step(middle, end, gain, dt / 2) == pytest.approx(whole, rel=1e-9, abs=1e-9)


@given(gain_dt=st.floats(1e-6, 50.0), residual=numbers, target=numbers)
def test_step_never_diverges_whatever_the_gain(gain_dt, residual, target):
    before = rows(0.0, 0.0, 0.0, 0.0, residual)
    after = rows(target * 1e-3, 0.0, 0.0, 0.0)
    found = step(before, after, np.array([gain_dt / 1e-3]), 1e-3)
    low, high = sorted((residual, target))

    assert low - 1e-9 <= found[0] <= high + 1e-9


@pytest.mark.parametrize(("alignment", "torque"), [("hold", 1.0), ("trapezoid", 3.0)])
def test_alignment_weights_the_torque_of_a_tick(alignment, torque):
    found = step(rows(0, 0, 0, 1.0), rows(0, 0, 0, 5.0), 50.0, 1e-3, alignment)
    assert found == pytest.approx(np.expm1(-0.05) * torque)


@pytest.fixture(scope="module")
def askew():
    """Sliding and turning joints along odd directions, a branch, and rotors."""
    model = pin.Model()
    along = np.array([0.6, 0.0, 0.8])
    turning = pin.JointModelRevoluteUnaligned(along)
    sliding = pin.JointModelPY()
    joints = [
        pin.JointModelRX(),
        sliding,
        turning,
        pin.JointModelPrismaticUnaligned(-along),
    ]
    pin.seed(1)
    for k, parent in enumerate((0, 1, 2, 1, 4, 5, 5)):
        model.addJoint(parent, joints[k % 4], pin.SE3.Random(), f"j{k}")
        model.appendBodyToJoint(k + 1, pin.Inertia.Random(), pin.SE3.Identity())
    return Robot(
        bare_model=model, tool_frame="universe", flange_frame="universe"
    ).with_armature(np.linspace(0.0, 0.6, 7))


@pytest.mark.parametrize("alignment", ["hold", "trapezoid"])
@pytest.mark.parametrize(
    "gain", [40.0, np.linspace(10.0, 80.0, 7)], ids=["one gain", "gains"]
)
@pytest.mark.parametrize("arm", ["lwr", "askew"])
def test_observer_and_pure_step_on_the_matrices_agree(arm, gain, alignment, request):
    robot = request.getfixturevalue(arm)
    observer = copy(MomentumObserver(robot, gain, alignment=alignment))
    times, q, dq, tau = swing(robot, seconds=0.1, amplitude=1.0)
    data = robot.create_data()

    def sample_rows(k):
        inertia = pin.crba(robot.model, data, q[k]).copy()
        coriolis = pin.computeCoriolisMatrix(robot.model, data, q[k], dq[k]).copy()
        gravity = pin.computeGeneralizedGravity(robot.model, data, q[k]).copy()
        return np.stack(
            [np.zeros(7), inertia @ dq[k], coriolis.T @ dq[k], gravity, tau[k]]
        )

    expected = np.zeros(7)
    before = sample_rows(0)
    observer.update(q[0], dq[0], tau[0], 0.0)
    for k in range(1, len(times)):
        after = sample_rows(k)
        dt = round_step(times[k] - times[k - 1])
        before[0] = expected
        expected = step(before, after, gain, dt, alignment)
        before = after
        np.testing.assert_allclose(
            observer.update(q[k], dq[k], tau[k], dt), expected, atol=1e-12
        )


def test_residual_converges_to_the_external_torque(lwr):
    force = np.array([1.0, -2.0, 3.0])
    _, q, dq, tau = swing(lwr, seconds=0.5, force_at_tip_in_base=force)
    observer = MomentumObserver(lwr, 200.0)
    residual = feed(observer, rows_of(q, dq, tau))[-1]

    np.testing.assert_allclose(
        residual, external_torque_of(lwr, q[-1], force), atol=0.02
    )


def test_start_on_a_moving_arm_has_no_spike(lwr):
    _, q, dq, tau = swing(lwr, seconds=0.2, start=0.4)
    observer = MomentumObserver(lwr, 500.0)

    assert np.abs(dq[0]).max() > 0.1
    assert np.abs(feed(observer, rows_of(q, dq, tau))).max() < 1e-3


def test_a_gap_in_time_is_not_integrated(lwr):
    times, q, dq, tau = swing(lwr, seconds=2.0)
    observer = MomentumObserver(lwr, 50.0)
    feed(observer, rows_of(q, dq, tau)[:500])
    after_gap = observer.update(q[1500], dq[1500], tau[1500], times[1500] - times[499])

    assert np.abs(after_gap).max() < 1e-3
    assert np.abs(observer.update(q[1501], dq[1501], tau[1501], 1e-3)).max() < 1e-3


def test_modelled_friction_does_not_read_as_force(lwr):
    friction = JointFriction(
        viscous_Nms=np.full(JOINTS, 2.0),
        coulomb_Nm=np.full(JOINTS, 1.0),
        offset_Nm=np.zeros(JOINTS),
    )
    _, q, dq, tau = swing(lwr, seconds=1.0)
    with_friction = np.array(
        [t + friction.torque(v) for t, v in zip(tau, dq, strict=True)]
    )
    known = MomentumObserver(lwr, 50.0, friction=friction)
    unknown = MomentumObserver(lwr, 50.0)
    rows = rows_of(q, dq, with_friction)
    worst_known, worst_unknown = (
        np.abs(feed(one, rows)).max() for one in (known, unknown)
    )

    assert worst_known < 0.01 < 0.5 < worst_unknown


def test_state_resumes_bit_equal_and_reset_forgets_it(lwr):
    _, q, dq, tau = swing(lwr, seconds=0.1)
    one = MomentumObserver(lwr, 50.0)
    other = MomentumObserver(lwr, 50.0)
    one.smooth_momentum(np.full(7, 1e-3), q[0])
    feed(one, rows_of(q, dq, tau)[:50])
    other.restore(copy(one.memory))
    sample = (q[50], dq[50] + 1e-3, tau[50], 1e-3)

    np.testing.assert_array_equal(one.update(*sample), other.update(*sample))

    handed_out = one.update(*sample)
    kept = handed_out.copy()
    one.update(*sample[:2], sample[2] + 5.0, 1e-3)

    np.testing.assert_array_equal(handed_out, kept)
    assert not handed_out.flags.writeable
    with pytest.raises(ConfigurationError, match="rows of shape"):
        one.restore(type(one.memory)(np.zeros((ROWS, 3))))

    one.reset()
    fresh = MomentumObserver(lwr, 50.0)
    for k in range(3):
        sample = (q[k], dq[k] + 1e-3 * k, tau[k], 1e-3)
        np.testing.assert_array_equal(one.update(*sample), fresh.update(*sample))


def test_smooth_friction_reaches_coulomb_plus_viscous():
    friction = JointFriction(viscous_Nms=[2.0], coulomb_Nm=[1.0], offset_Nm=[0.25])

    assert friction.torque(np.array([0.5]))[0] == pytest.approx(2.0 * 0.5 + 1.0 + 0.25)
    assert friction.torque(np.array([-0.5]))[0] == pytest.approx(
        -2.0 * 0.5 - 1.0 + 0.25
    )
    assert friction.torque(np.array([0.0]))[0] == pytest.approx(0.25)


def test_sigmoid_friction_follows_its_formula():
    friction = SigmoidFriction(
        amplitude_Nm=[0.5], slope_s_rad=[5.0], shift_rad_s=[0.04]
    )

    assert friction.torque(np.array([0.0]))[0] == 0.0

    expected = 0.5 / (1 + np.exp(-5 * (0.3 + 0.04))) - 0.5 / (1 + np.exp(-5 * 0.04))

    assert friction.torque(np.array([0.3]))[0] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"viscous_Nms": [-1.0]}, "negative"),
        ({"coulomb_Nm": [1.0, 2.0]}, "differ in length"),
        ({"offset_Nm": [np.nan]}, "offset_Nm"),
        ({"offset_Nm": ["much"]}, "offset_Nm"),
        ({"reversal_speed_rad_s": 0.0}, "reversal_speed"),
    ],
)
def test_parameters_that_cannot_be_are_refused(change, match):
    sound = {"viscous_Nms": [0.1], "coulomb_Nm": [0.1], "offset_Nm": [0.0]}
    with pytest.raises(ConfigurationError, match=match):
        JointFriction(**(sound | change))


# Velocity from position, with torque delayed to match.


@given(split=st.floats(0.05, 0.95), start=st.floats(-5, 5), end=st.floats(-5, 5))
def test_partial_steps_equal_one_for_straight_input(split, start, end):
    def outputs(before, first, last, dt_s):
        return lag_pair_coefficients(120.0, dt_s)[:2] @ (*before, first, last)

    middle = start + split * (end - start)
    whole = outputs((1.0, -2.0), start, end, 0.01)
    part = outputs((1.0, -2.0), start, middle, 0.01 * split)
    parts = outputs(part, middle, end, 0.01 * (1 - split))

    np.testing.assert_allclose(parts, whole, atol=1e-12)


def test_a_ramp_has_exact_velocity_and_stated_delay():
    estimator = VelocityEstimator(1, 200.0)
    rng = np.random.default_rng(0)
    time = 0.0
    for _ in range(400):
        dt = rng.uniform(5e-4, 2e-3)
        time += dt
        sample = estimator.update([0.3 * time], [0.0], dt)

    assert sample.settled
    assert sample.dq[0] == pytest.approx(0.3, rel=1e-9)
    assert sample.q[0] == pytest.approx(0.3 * (time - estimator.delay_s), rel=1e-9)


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
    _, q, _, tau = swing(lwr, seconds=2.0)
    estimator = VelocityEstimator(7, 100.0)
    observer = MomentumObserver(lwr, 50.0)
    careless = MomentumObserver(lwr, 50.0)
    worst = worst_careless = 0.0
    for k in range(len(q)):
        sample = estimator.update(q[k], tau[k], 1e-3)
        if sample.settled:
            matched = observer.update(sample.q, sample.dq, sample.tau, 1e-3)
            undelayed = careless.update(q[k], sample.dq, tau[k], 1e-3)
            if k > 500:
                worst = max(worst, np.abs(matched).max())
                worst_careless = max(worst_careless, np.abs(undelayed).max())

    assert worst < 0.005
    assert worst < 0.1 * worst_careless


def test_held_torque_is_filtered_as_held():
    held = VelocityEstimator(1, 100.0, alignment="hold")
    held.update([0.0], [1.0], 1e-3)

    assert held.update([0.0], [0.0], 1e-3).tau[0] == 1.0

    sampled = VelocityEstimator(1, 100.0)
    sampled.update([0.0], [1.0], 1e-3)

    assert sampled.update([0.0], [0.0], 1e-3).tau[0] < 1.0


def test_gap_starts_the_filter_anew():
    estimator = VelocityEstimator(1, 200.0)
    for _ in range(100):
        sample = estimator.update([0.0], [0.0], 1e-3)

    assert sample.settled

    sample = estimator.update([1.0], [0.0], 0.5)

    assert not sample.settled
    assert sample.dq[0] == 0.0


def smoothed_momentum(momentum, threshold, dt_s=1e-3):
    """A momentum, sample by sample, smoothed as the observer does it."""
    smoothed = np.zeros(1)
    values = []
    for value in momentum:
        newest = np.array([value])
        momentum_smoothing_step(newest, smoothed, np.array([threshold]), dt_s)
        smoothed = newest
        values.append(float(newest[0]))
    return np.array(values)


def test_momentum_at_rest_is_smoothed_from_ten_radians_per_second_on():
    times_s = 1e-3 * np.arange(6000)
    turning = np.exp(-10j * times_s)  # unfolds the part at 10 rad/s
    momentum = np.sin(10.0 * times_s)
    after_start = slice(720, 720 + 8 * 628)  # whole periods
    smoothed = smoothed_momentum(momentum, threshold=1e3)
    ratio = (smoothed * turning)[after_start].sum()
    ratio /= (momentum * turning)[after_start].sum()

    assert abs(ratio) == pytest.approx(np.sqrt(0.5), rel=0.02)
    assert np.angle(ratio, deg=True) == pytest.approx(-45.0, abs=1.0)


@pytest.mark.parametrize(
    ("distance", "per_s"), [(0.01, 10.0), (1.0, 20.0), (2.0, 170.0)]
)
def test_momentum_far_behind_catches_up_sooner(distance, per_s):
    dt_s = 1e-6
    smoothed = smoothed_momentum([distance], threshold=1.0, dt_s=dt_s)

    # What it is behind by becomes the estimate's step.
    assert smoothed[0] / distance == pytest.approx(per_s * dt_s, rel=1e-3)
