"""Offset removal that lasts."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from foundation.steps import finish
from groundtruth.arm_plant import BearingFriction
from groundtruth.plant_model import CLEAN
from residual import DEFAULT, BiasPrior, ConfigurationError, TareError, WrenchEstimator
from residual.bias.estimator import BiasEstimator, TareRecorder
from residual.bias.fit import FreeMotionFit
from residual.bias.joint_states import joint_states_step, play_operator
from residual.bias.model import BiasModel, TareBlocks
from residual.bias.tare_check import (
    check_free_of_contact,
    find_contacts,
    tip_torques,
)
from tests.residual.residual_signals import (
    BIAS,
    MIDDLE,
    external_torque_of,
    gravity_of,
    pose_of,
)

TOWARDS = np.array([0.0, 0.12, 0.01, 0.15, 0.0, 0.1, 0.0])
LOOPS = 3
FORWARD = np.zeros((8, 7))
STILL = np.zeros((8, 7))
FORWARD[:LOOPS] = np.sign(TOWARDS)
LATE = np.arange(300) > 270
GROWING = np.linspace(-2.0, 1.0, 300).clip(0.0)
AHEAD = (MIDDLE + 0.8 * TOWARDS, FORWARD, 20.0)
"""Posture, state of the loops and seconds since the tare, at which a fit is judged."""


def stroke(
    robot,
    basis,
    *,
    truth=None,
    noise=0.005,
    seed=0,
    blocks=300,
    reach=1.0,
    joint_speed=False,
):
    """Blocks of a there-and-back motion with a bias drawn from the prior (or given)."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0.0, 3 * np.pi, blocks)
    place = 0.5 * (1 - np.cos(phase)) * reach - reach
    q = MIDDLE + place[:, None] * TOWARDS
    trend = np.sign(np.sin(phase))[:, None, None] * FORWARD
    if joint_speed:
        speed = np.sin(phase)[:, None] * TOWARDS
        trend[:, LOOPS:-1] = np.sign(speed)[:, None]
        trend[:, -1] = speed
    age = np.linspace(-9.0, 0.0, blocks)
    theta = basis.std * rng.normal(size=len(basis.std)) if truth is None else truth
    bias = np.array(
        [basis.columns(*row) @ theta for row in zip(q, trend, age, strict=True)]
    )
    residual = bias + noise * rng.normal(size=bias.shape)
    scatter = np.full(robot.nv, (2 * noise) ** 2)
    gravity = np.array([basis.gravity_Nm(one) for one in q])
    return theta, TareBlocks(
        q_rad=q,
        states=trend,
        residual_Nm=residual,
        torque_Nm=gravity - residual,
        age_s=age,
        scatter_Nm2=scatter,
    )


def fitted_to(basis, blocks):
    return finish(FreeMotionFit.in_steps(basis, blocks))


def check(robot, basis, blocks, wrench):
    fit = fitted_to(basis, blocks)
    finish(
        check_free_of_contact(fit, wrench, 0.25, is_external=False, adds_gravity=False)
    )


def touched(robot, blocks, push_N):
    """The blocks with a force along the needle, shape (m,)."""
    lever_m = external_torque_of(robot, MIDDLE, pose_of(robot, MIDDLE).rotation[:, 2])
    pushed_Nm = push_N[:, None] * lever_m
    return replace(
        blocks,
        residual_Nm=blocks.residual_Nm - pushed_Nm,
        torque_Nm=blocks.torque_Nm + pushed_Nm,
    )


@pytest.fixture
def basis(lwr):
    return BiasModel(lwr, "model", BiasPrior())


def test_bias_is_linear_in_its_physical_causes(lwr, basis):
    model = lwr.model.copy()
    heavier = model.inertias[5]
    model.inertias[5] = pin.Inertia(heavier.mass + 0.1, heavier.lever, heavier.inertia)
    gravity = pin.computeGeneralizedGravity(model, model.createData(), MIDDLE)
    theta = np.zeros(len(basis.std))
    start = basis.groups["links"].start + 4 * 4
    theta[start] = 0.1
    theta[start + 1 : start + 4] = 0.1 * heavier.lever
    got = basis.columns(MIDDLE, STILL, 0.0) @ theta

    np.testing.assert_allclose(got, gravity - gravity_of(lwr, [MIDDLE])[0], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_fit_extrapolates_better_than_a_constant(lwr, basis, seed):
    theta, blocks = stroke(lwr, basis, seed=seed)
    truth = basis.columns(*AHEAD) @ theta
    fitted = fitted_to(basis, blocks).tare
    fit = fitted_to(BiasModel(lwr, "constant", BiasPrior()), blocks)
    loops = basis.groups["hysteresis"]  # the narrowest first

    assert fitted.mean[loops][7:].min() > -1e-9 > theta[loops][7:].min()

    ours = np.abs(basis.bias_Nm(fitted, *AHEAD) - truth).max()
    paper = np.abs(fit.basis.bias_Nm(fit.tare, *AHEAD) - truth).max()

    assert ours < 0.5 * paper


@pytest.mark.slow
def test_stated_covariance_is_believable(lwr, basis):
    scores = []
    for seed in range(20):
        theta, blocks = stroke(lwr, basis, seed=seed)
        fitted = fitted_to(basis, blocks).tare
        error = basis.bias_Nm(fitted, *AHEAD) - basis.columns(*AHEAD) @ theta
        covariance = basis.covariance_Nm2(fitted, *AHEAD) - fitted.noise_Nm2
        scores.append((error**2 / covariance.diagonal())[1:4])

    assert 0.5 < np.mean(scores) < 1.6


def test_waviness_does_not_pass_for_a_slope(lwr, basis):
    _, blocks = stroke(lwr, basis, truth=np.zeros(len(basis.std)))
    ripple = 0.02 * np.sin(320.0 * blocks.q_rad + 1.0)
    wavy = replace(blocks, residual_Nm=blocks.residual_Nm + ripple)
    at_once = (*AHEAD[:2], 0.0)
    tares = [fitted_to(basis, each).tare for each in (blocks, wavy)]
    covariances = [
        basis.covariance_Nm2(tare, *at_once) - tare.noise_Nm2 for tare in tares
    ]
    smooth, rough = (np.sqrt(covariance.diagonal()[1:4]) for covariance in covariances)

    assert (rough > 1.5 * smooth).all()
    assert (np.abs(basis.bias_Nm(tares[1], *at_once))[1:4] < 3.0 * rough).all()


def test_uncertainty_grows_with_distance_and_time(lwr, basis):
    fitted = fitted_to(basis, stroke(lwr, basis)[1]).tare

    def uncertainty(distance, age):
        covariance = basis.covariance_Nm2(
            fitted, MIDDLE + distance * TOWARDS, STILL, age
        )
        return covariance.trace()

    assert uncertainty(0.0, 0.0) < uncertainty(0.5, 0.0) < uncertainty(1.0, 0.0)
    assert uncertainty(0.0, 0.0) < uncertainty(0.0, 60.0) < uncertainty(0.0, 600.0)


def test_constant_kind_is_the_mean_residual(lwr):
    basis = BiasModel(lwr, "constant", BiasPrior())
    _, blocks = stroke(lwr, basis, truth=BIAS)
    tare = fitted_to(basis, blocks).tare
    mean = blocks.residual_Nm.mean(axis=0)

    np.testing.assert_allclose(basis.bias_Nm(tare, MIDDLE, STILL, 5.0), mean, atol=2e-4)


@pytest.mark.parametrize(
    "push", [1.0 * LATE, -1.0 * LATE, np.full(300, 60.0), 0.5 * GROWING]
)
def test_contact_during_the_stroke_is_refused(lwr, basis, push):
    wrench = WrenchEstimator(lwr)
    stands = push[0] > 0.0
    _, blocks = stroke(lwr, basis, truth=np.zeros(len(basis.std)) if stands else None)
    check(lwr, basis, blocks, wrench)
    with pytest.raises(TareError, match="in contact"):
        check(lwr, basis, touched(lwr, blocks, push), wrench)


def test_a_contact_is_refused_from_five_deviations_on(lwr, basis):
    wrench = WrenchEstimator(lwr)
    _, blocks = stroke(lwr, basis, truth=np.zeros(len(basis.std)), noise=0.2)
    slight = touched(lwr, blocks, 0.2 * LATE)
    clear = touched(lwr, blocks, 0.47 * LATE)
    torque_Nm = finish(tip_torques(clear, wrench))
    fit = fitted_to(basis, clear)
    contacts = finish(find_contacts(fit, torque_Nm, wrench, 0.0))

    assert all(5.3 < abs(one.force_N) / one.std_N < 6.0 for one in contacts)
    with pytest.raises(TareError, match="in contact"):
        check(lwr, basis, clear, wrench)
    check(lwr, basis, slight, wrench)


def recorded(values, block):
    """A recorder of one loop that was given samples at 1 kHz, in blocks of so many."""
    recorder = TareRecorder.of_size(values.shape[1], 1)
    for k, value in enumerate(values):
        recorder.add(
            np.full_like(value, k), np.ones((1, len(value))), value, 1e-3 * k, 1e-3
        )
        if (k + 1) % block == 0:
            recorder.close_block()
    return recorder


def test_recorder_keeps_block_means_in_bounded_memory():
    values = np.repeat(2.0 * np.arange(20_000)[:, None], 2, axis=1)
    early = recorded(values[:100], 10)

    assert len(early.blocks(now_s=0.1).age_s) == 10
    assert len(early.blocks(now_s=0.1, window_s=0.021).age_s) == 2

    recorder = recorded(values, 10)
    blocks = recorder.blocks(now_s=20.0)

    assert 100 < len(blocks.age_s) < 400
    np.testing.assert_allclose(blocks.residual_Nm, 2 * blocks.q_rad)
    np.testing.assert_allclose(
        blocks.q_rad[:, 0] * 1e-3, blocks.age_s + 20.0, atol=1e-3
    )
    assert len(recorder.blocks(now_s=99.0, window_s=0.1).age_s) == 1


def test_ripple_of_a_known_gear_ratio_is_fitted(lwr):
    ratio = (160.0,) * 4 + (100.0,) * 3
    basis = BiasModel(lwr, "model", BiasPrior(gear_ratio=ratio))
    theta = np.zeros(len(basis.std))
    theta[basis.groups["sine"]] = 0.02
    theta[basis.groups["cosine"]] = -0.01
    _, blocks = stroke(lwr, basis, truth=theta)
    ahead = MIDDLE + 0.5 * TOWARDS
    angle = 2 * np.array(ratio) * ahead
    expected = 0.02 * np.sin(angle) - 0.01 * np.cos(angle)
    got = basis.bias_Nm(fitted_to(basis, blocks).tare, ahead, FORWARD, 0.0)

    np.testing.assert_allclose(got[[1, 3]], expected[[1, 3]], atol=0.01)
    with pytest.raises(ConfigurationError, match="expected 7"):
        BiasModel(lwr, "model", BiasPrior(gear_ratio=(160.0,)))


def test_a_sliding_bearing_rubs_more_at_low_speed():
    states = np.zeros((7, 1))  # three loops, two elements, more at low speed, speed
    plays = np.zeros((5, 1))
    lagged_q = np.zeros(1)
    q = np.zeros(1)
    for _ in range(2000):
        q = q + 0.02e-3  # 0.02 rad/s
        joint_states_step(
            plays,
            np.zeros(1),
            lagged_q,
            states,
            q,
            np.zeros(1),
            np.full((5, 1), 1e-3),
            loops=3,
            stribeck_rad_s=0.02,
            dt_s=1e-3,
        )

    assert states[:3, 0] == pytest.approx(np.zeros(3))
    assert states[3:5, 0] == pytest.approx(np.ones(2))
    assert states[5, 0] == pytest.approx(np.exp(-1.0), rel=1e-3)
    assert states[6, 0] == pytest.approx(0.02, rel=1e-3)


def test_hysteresis_state_remembers_and_turns_over_width():
    half_width = 0.01
    trend = 0.0
    for _ in range(10):
        trend = play_operator(trend, 0.002, half_width)

    assert trend == 1.0
    assert play_operator(trend, 0.0, half_width) == 1.0

    back = play_operator(trend, -0.01, half_width)

    assert back == pytest.approx(0.0)
    assert play_operator(back, -1.0, half_width) == -1.0


def test_settings_that_cannot_work_are_refused(lwr):
    for name, value in (
        ("mass_fraction", 0.0),
        ("hysteresis_widths", 1e-4),
        ("com_m", np.nan),
    ):
        with pytest.raises(ConfigurationError, match=name):
            BiasPrior(**{name: value})
    with pytest.raises(ConfigurationError, match="constant"):
        BiasModel(lwr, "quadratic", BiasPrior())


DT_S = 4e-3
REACH_RAD = np.array([0.01, 0.1, 0.02, 0.13, 0.035, 0.22, 0.03])
NOISE_NM = np.array([0.05, 0.05, 0.03, 0.03, 0.03, 0.011, 0.011]) * 0.19
"""Torque noise of the plant `clean` after the observer's low-pass."""


def quintic(s):
    return s**3 * (10.0 + s * (6.0 * s - 15.0))


def place(t_s):
    """A second of rest, three strokes of 4 s, then on at a tenth of their speed, 0
    to 1.3."""
    stroke, s = np.divmod(np.clip((t_s - 1.0) / 4.0, 0.0, 3.0), 1.0)
    there = np.where(stroke % 2 == 0, quintic(s), 1.0 - quintic(s))
    return np.where(stroke == 3, 1.0 + 0.03 * (t_s - 13.0), there)


class Arm:
    """Residuals of a simulated arm whose bearings rub; no tissue but what a test
    adds."""

    def __init__(self, robot, seed, factor=1.0):
        # 0.02 to 0.1 Nm of friction, equal chance per octave.
        coulomb_Nm = (
            factor * 0.02 * 5.0 ** np.random.default_rng([seed, 1]).uniform(size=7)
        )
        rng = self.rng = np.random.default_rng(seed)
        model = replace(
            CLEAN,
            joint_coulomb=1.0,
            joint_viscous_Nms_per_rad=(0.3 * coulomb_Nm.max(),) * 7,
        )
        self.bearings = BearingFriction(model, coulomb_Nm, rng)
        self.offset = rng.uniform(-0.5, 0.5, 7)
        self.wrench = WrenchEstimator(robot)

    def feed(self, estimator, start_s, end_s, force=lambda _t: 0.0, *, record=True):
        """Feed an estimator; returns error and std of the axial force at every
        sample."""
        found = []
        for t in np.arange(start_s, end_s, DT_S):
            q = MIDDLE + place(t) * REACH_RAD
            dq = (place(t + 1e-4) - place(t - 1e-4)) / 2e-4 * REACH_RAD
            rubbed = self.bearings.step(dq, DT_S)
            self.wrench.kinematics.update(q)
            pushed = -force(t) * self.wrench.kinematics.axial_jacobian
            residual = self.offset + rubbed + pushed
            tau = estimator._basis.gravity_Nm(q) - residual
            estimator.update(q, dq, tau, DT_S)
            residual = residual + NOISE_NM * self.rng.standard_normal(7)
            if record:
                estimator.record(residual, DT_S)
            elif estimator.memory.renewed_s == estimator.memory.now_s:
                self.wrench.set_torque_covariance(estimator.covariance_Nm2())
                seen = self.wrench.estimate(q, residual - estimator.memory.bias)
                found.append((seen.axial - force(t), seen.axial_std))
        return np.array(found).T


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "most_N"), [(1.0, 0.05), (3.0, 0.1)])
@pytest.mark.parametrize("seed", [0, 1])
def test_friction_is_learnt_from_strokes_both_ways(lwr, factor, most_N, seed):
    arm = Arm(lwr, seed, factor)
    estimator = BiasEstimator(lwr, DEFAULT)
    arm.feed(estimator, 0.0, 13.0)
    estimator.tare(WrenchEstimator(lwr), ignore_contact=False)
    error, std = arm.feed(estimator, 13.0, 21.0, record=False)

    assert np.sqrt(np.mean(error**2)) < most_N
    assert np.mean(np.abs(error) < 2.0 * std) > 0.85


@pytest.mark.slow
@pytest.mark.parametrize("since_s", [5.0, 11.0])
@pytest.mark.parametrize("seed", [2, 3])
def test_contact_is_refused_in_spite_of_friction(lwr, since_s, seed):
    arm = Arm(lwr, seed)
    estimator = BiasEstimator(lwr, DEFAULT)
    arm.feed(
        estimator, 0.0, 13.0, lambda t: 0.5 * min(1.0, max(0.0, t - since_s) / 0.3)
    )

    with pytest.raises(TareError, match="in contact"):
        estimator.tare(WrenchEstimator(lwr), ignore_contact=False)


def test_a_short_tare_states_its_ignorance(lwr):
    arm = Arm(lwr, 5)
    estimator = BiasEstimator(lwr, DEFAULT)
    arm.feed(estimator, 0.0, 1.0)
    estimator.tare(WrenchEstimator(lwr), ignore_contact=False)
    _, at_rest = arm.feed(estimator, 0.9, 1.0, record=False)
    error, moving = arm.feed(estimator, 1.0, 3.0, record=False)

    assert moving[-1] > 3.0 * at_rest[-1]
    assert np.mean(np.abs(error) < 2.0 * moving) > 0.85
