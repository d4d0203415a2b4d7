"""Equation (13) and its weighted forms: signs, frames, covariance, singular poses."""

from copy import deepcopy

import numpy as np
import pytest

from needleforce.tip_travel import tip_motion
from residual import PUBLISHED, ConfigurationError, SensorConfig, WrenchEstimator
from residual.checks.torque_change import unusual_change
from residual.estimate import UNSEEN_STD
from residual.tool_kinematics import ToolKinematics
from residual.wrench_estimator import WrenchFilterState
from tests.residual.residual_signals import (
    MIDDLE,
    external_torque_of,
    jacobian_of,
    pose_of,
)
from urdf import UrdfError, load_lwr

POINTING_DOWN = np.array([0.0, 0.6, 0.0, -1.4, 0.0, 1.14159265, 0.0])
MODES = ["axial", "point", "full"]
SMOOTHING_LAG = 100.0 / 3.0
"""Lag of 30 1/s in ticks of 1 ms."""


def estimator_of(robot, **settings):
    return WrenchEstimator(robot, SensorConfig(**settings))


def tip_axis(robot, q):
    return pose_of(robot, q).rotation[:, 2]


@pytest.mark.parametrize("mode", MODES)
def test_a_hanging_weight_reads_as_force_down(lwr, mode):
    assert tip_axis(lwr, POINTING_DOWN) == pytest.approx([0, 0, -1], abs=1e-6)

    weight = np.array([0.0, 0.0, -2.0])
    for robot in (lwr, load_lwr()):  # without a needle at its flange
        torque = external_torque_of(robot, POINTING_DOWN, weight)
        estimate = estimator_of(robot, mode=mode).estimate(POINTING_DOWN, torque)
        np.testing.assert_allclose(estimate.force, weight, atol=2e-3)
        assert estimate.axial == pytest.approx(-2.0, abs=2e-3), (
            "a pull on the needle is negative"
        )


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("axes", ["base", "tool"])
def test_tissue_pushing_back_reads_positive(lwr, mode, axes):
    push_back = -1.5 * tip_axis(lwr, MIDDLE)
    torque = external_torque_of(lwr, MIDDLE, push_back)
    estimate = estimator_of(lwr, mode=mode, axes=axes).estimate(MIDDLE, torque)

    assert estimate.axial == pytest.approx(1.5, abs=2e-3)

    expected = push_back if axes == "base" else [0.0, 0.0, -1.5]

    np.testing.assert_allclose(estimate.force, expected, atol=2e-3)


def test_force_and_torque_act_at_named_frames(lwr):
    wrench = np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
    jacobian = jacobian_of(lwr, MIDDLE, "flange")
    estimator = estimator_of(lwr, mode="full", frame="flange", expected_force_N=None)
    estimate = estimator.estimate(MIDDLE, jacobian.T @ wrench)

    np.testing.assert_allclose(
        np.r_[estimate.force, estimate.torque], wrench, atol=1e-9
    )


def test_unweighted_full_mode_is_equation_13(lwr):
    torque = np.random.default_rng(0).normal(size=7)
    estimator = WrenchEstimator(lwr, PUBLISHED)
    estimator.set_torque_covariance(np.diag(np.linspace(0.1, 0.7, 7)))
    estimate = estimator.estimate(MIDDLE, torque)
    expected = np.linalg.pinv(jacobian_of(lwr, MIDDLE).T) @ torque

    np.testing.assert_allclose(
        np.r_[estimate.force, estimate.torque], expected, rtol=1e-9
    )


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("weighting", ["covariance", "none"])
def test_standard_deviation_is_that_of_repeated_noise(lwr, mode, weighting):
    rng = np.random.default_rng(0)
    std = np.array([0.05, 0.05, 0.03, 0.03, 0.03, 0.011, 0.011])
    estimator = estimator_of(lwr, mode=mode, weighting=weighting)
    estimator.set_torque_covariance(np.diag(std**2))
    estimates = [
        estimator.estimate(MIDDLE, std * rng.normal(size=7)) for _ in range(2000)
    ]

    assert np.std([e.axial for e in estimates]) == pytest.approx(
        estimates[0].axial_std, rel=0.06
    )


def test_fewer_unknowns_mean_less_noise(lwr):
    found = [
        estimator_of(lwr, mode=mode).estimate(MIDDLE, np.zeros(7)) for mode in MODES
    ]

    assert found[0].axial_std < found[1].axial_std < found[2].axial_std
    assert {one.axial for one in found} == {0.0}


def test_singular_pose_gives_finite_numbers_that_say_so(lwr):
    stretched = np.zeros(7)
    torque = external_torque_of(lwr, stretched, [0.0, 0.0, 5.0])
    for mode in MODES:
        estimate = estimator_of(lwr, mode=mode).estimate(stretched, torque)
        assert np.isfinite(estimate.axial)
        assert np.isfinite(estimate.force).all()
        assert estimate.axial_std > 50.0, (
            "the joints cannot see a force along the stretched arm"
        )
        assert estimate.conditioning > 1e3
        assert estimate.damping_fraction.max() > 0.5
    undamped = estimator_of(lwr, mode="full", expected_force_N=None).estimate(
        stretched, torque
    )

    assert undamped.axial_std == UNSEEN_STD
    assert np.isfinite(undamped.force).all()


def test_damping_is_negligible_where_the_joints_see_well(lwr):
    estimator = WrenchEstimator(lwr)
    estimator.set_torque_covariance(1e-4 * np.eye(7))
    estimate = estimator.estimate(MIDDLE, np.zeros(7))

    assert estimate.damping_fraction.max() < 1e-5
    assert 1.0 <= estimate.conditioning < 10.0


def test_results_are_read_only_and_covariance_copied(lwr):
    covariance = np.eye(7) * 0.01
    estimator = WrenchEstimator(lwr)
    estimator.set_torque_covariance(covariance)
    before = estimator.estimate(MIDDLE, np.zeros(7))
    covariance *= 100.0

    assert estimator.estimate(MIDDLE, np.zeros(7)).axial_std == before.axial_std

    for array in (before.force, before.torque, before.covariance):
        assert not array.flags.writeable


def test_unknown_frames_and_invalid_covariances_are_refused(lwr):
    with pytest.raises(UrdfError, match="needle_tip"):
        estimator_of(lwr, frame="nowhere")

    skew = 1.0 * np.eye(7) + np.triu(np.ones((7, 7)), 1)
    refused = {"shape": np.eye(6), "symmetric": skew, "positive definite": -np.eye(7)}
    for match, matrix in (*refused.items(), ("finite", np.eye(7) * np.nan)):
        with pytest.raises(ConfigurationError, match=match):
            WrenchEstimator(lwr).set_torque_covariance(matrix)


def test_length_of_the_insertion_axis_does_not_matter(lwr):
    for axis in ((0, 0, 1e-200), (0, 0, 1e200)):
        torque = external_torque_of(lwr, MIDDLE, -tip_axis(lwr, MIDDLE))
        estimate = estimator_of(lwr, insertion_axis=axis).estimate(MIDDLE, torque)
        assert estimate.axial == pytest.approx(1.0, abs=2e-3)


def test_only_changes_without_a_force_are_unusual(lwr):
    rows = jacobian_of(lwr, MIDDLE)[:3]
    rng = np.random.default_rng(0)
    stds = rng.uniform(1e-3, 1e-2, 7)
    usual = np.diag(stds**2)
    found = [
        unusual_change(rows, stds * rng.normal(size=7), usual) for _ in range(2000)
    ]

    assert np.mean(found) == pytest.approx(1.0, abs=0.05)
    assert unusual_change(rows, np.array([1.0, -2.0, 0.5]) @ rows, usual) < 1e-6

    aside = np.linalg.svd(rows)[2][-1]  # a torque that no force makes

    assert unusual_change(rows, 0.1 * aside, usual) > 15.0


@pytest.mark.parametrize("mode", MODES)
def test_noise_is_smoothed_and_a_rupture_passes(lwr, mode):
    estimator = estimator_of(lwr, mode=mode)
    estimator.set_torque_covariance(0.02**2 * np.eye(7))
    estimator.compute_gain(MIDDLE)
    state = WrenchFilterState.at_zero(estimator.size)
    torques = np.random.default_rng(0).normal(size=(4000, 7))
    torques *= 0.02
    torques[2000:] += external_torque_of(lwr, MIDDLE, -2.0 * tip_axis(lwr, MIDDLE))
    estimates = []
    for k, torque in enumerate(torques):
        lag = SMOOTHING_LAG if k else 0.0
        estimates.append(estimator.solve(torque, state, lag))
    axial = np.array([estimate.axial for estimate in estimates])
    unsmoothed = np.array([estimate.axial_unsmoothed for estimate in estimates])
    std = estimates[-1].axial_std
    at_rest = slice(500, 2000)

    # A lag of 33 samples leaves 1 / 66 of the variance of white noise; wide steps let
    # more pass.
    assert np.std(axial[at_rest]) < 0.35 * np.std(unsmoothed[at_rest])
    assert np.std(unsmoothed[at_rest]) == pytest.approx(std, rel=0.1)
    assert np.abs(axial[2001:] - 2.0).max() < 2.5 * std


@pytest.mark.parametrize("mode", ["point", "full"])
def test_noise_across_the_needle_is_smoothed_and_hides_no_force(lwr, mode):
    estimator = estimator_of(lwr, mode=mode)
    estimator.set_torque_covariance(0.02**2 * np.eye(7))
    estimator.compute_gain(MIDDLE)
    torques_Nm = 0.02 * np.random.default_rng(0).normal(size=(3000, 7))
    forces_N = []
    deviations_N = []
    # Lags of smoothing and of the observer in samples: none, a long and a short one.
    for smoothing_lag, observer_lag in ((0.0, 0.0), (33.0, 0.0), (10.0, 5.0)):
        state = WrenchFilterState.at_zero(estimator.size)
        estimates = [
            estimator.solve(torque_Nm, state, smoothing_lag, observer_lag)
            for torque_Nm in torques_Nm
        ][500:]
        forces_N.append(np.sqrt(np.mean([e.lateral**2 for e in estimates])))
        deviations_N.append(max(e.lateral_std for e in estimates))
    plain_N, smoothed_N, _ = forces_N

    # Two components are noisy; the deviation is that of the noisier one. A lag of 33
    # leaves 1 / 66 of a variance.
    assert deviations_N[0] < plain_N < np.sqrt(2.0) * deviations_N[0]
    assert smoothed_N < 1.45 * plain_N / np.sqrt(66.0)
    assert deviations_N == pytest.approx(3 * deviations_N[:1])


def test_deviation_covers_what_a_lag_hides(lwr):
    estimator = estimator_of(lwr)
    estimator.set_torque_covariance(0.02**2 * np.eye(7))
    estimator.compute_gain(MIDDLE)
    state = WrenchFilterState.at_zero(estimator.size)
    unit = external_torque_of(lwr, MIDDLE, -tip_axis(lwr, MIDDLE))
    lag = 40
    errors = []
    felt_N = 0.0
    # A heart's 1.3 Hz, in ticks of 1 ms.
    for true_N in np.sin(2.0 * np.pi * 1.3e-3 * np.arange(3000)):
        felt_N += (true_N - felt_N) / (1.0 + lag)
        estimate = estimator.solve(felt_N * unit, state, SMOOTHING_LAG, lag)
        errors.append(abs(estimate.axial - true_N) / estimate.axial_std)

    assert np.mean(np.array(errors[500:]) < 2.0) > 0.9


def test_copies_of_the_tool_are_independent():
    one = ToolKinematics(
        load_lwr(), insertion_axis=(0.1, 0.2, 1.0), offset_m=(0.01, 0.0, 0.02)
    )
    other = deepcopy(one)
    axis = np.array((0.6, 0.0, 0.8))
    dq = np.ones(7)
    other.update(np.full(7, 0.6))
    one.update(np.full(7, 0.3))
    for each in (one, other):
        expected = axis @ each.pose[:3, 3], each.axial_jacobian @ dq
        assert tip_motion(axis, each.needle, dq) == pytest.approx(expected, abs=1e-12)

    assert abs((one.pose - other.pose)[:3, 3]).max() > 0.1
