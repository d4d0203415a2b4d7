"""Equation (13) and its weighted forms: signs, frames, covariance, singular poses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from residual import PUBLISHED, SensorConfig, WrenchEstimator
from tests.residual.residual_signals import (
    MIDDLE,
    external_torque_of,
    jacobian_of,
    pose_of,
)
from urdf import UrdfError, load_lwr

MODES = ["axial", "point", "full"]
NO_TORQUE = np.zeros(7)


def estimated(robot, torque_Nm, q=MIDDLE, covariance_Nm2=None, **settings):
    estimator = WrenchEstimator(robot, SensorConfig(**settings))
    if covariance_Nm2 is not None:
        estimator.set_torque_covariance(covariance_Nm2)
    return estimator.estimate(q, torque_Nm)


@settings(max_examples=30)
@given(
    mode=st.sampled_from(MODES),
    turn=st.floats(-2.0, 2.0),
    newton=st.floats(-5.0, 5.0),
    axis=st.floats(1e-200, 1e200),
)
def test_a_force_along_the_needle_is_read_alike_in_all_modes_and_axes(
    lwr, mode, turn, newton, axis
):
    """The whole arm may be turned about its base, the axis be of any length."""
    q = MIDDLE + turn * np.eye(1, 7)[0]
    for robot in (lwr, load_lwr()):  # without a needle at its flange
        needle = pose_of(robot, q).rotation[:, 2]
        torque_Nm = external_torque_of(robot, q, newton * needle)
        for axes, along in (("base", needle), ("tool", np.eye(3)[2])):
            kinds = {"mode": mode, "axes": axes, "insertion_axis": (0.0, 0.0, axis)}
            found = estimated(robot, torque_Nm, q, **kinds)

            assert np.r_[found.axial, found.force] == pytest.approx(
                newton * np.r_[-1.0, along], abs=5e-3
            )


def test_force_and_torque_act_at_named_frames(lwr):
    wrench = [1.0, -2.0, 3.0, 0.1, 0.2, -0.3]
    kinds = {"mode": "full", "frame": "flange", "expected_force_N": None}
    found = estimated(lwr, jacobian_of(lwr, MIDDLE, "flange").T @ wrench, **kinds)

    assert np.r_[found.force, found.torque] == pytest.approx(wrench, abs=1e-9)


def test_unweighted_full_mode_is_equation_13(lwr):
    torque = np.random.default_rng(0).normal(size=7)
    estimator = WrenchEstimator(lwr, PUBLISHED)
    estimator.set_torque_covariance(np.diag(np.linspace(0.1, 0.7, 7)))
    found = estimator.estimate(MIDDLE, torque)
    expected = np.linalg.pinv(jacobian_of(lwr, MIDDLE).T) @ torque

    np.testing.assert_allclose(np.r_[found.force, found.torque], expected, rtol=1e-9)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("weighting", ["covariance", "none"])
def test_the_deviation_is_that_of_the_torques_through_a_linear_gain(
    lwr, mode, weighting
):
    std = np.array([0.05, 0.05, 0.03, 0.03, 0.03, 0.011, 0.011])
    kinds = {"covariance_Nm2": np.diag(std**2), "mode": mode, "weighting": weighting}
    found = [estimated(lwr, one, **kinds) for one in np.diag(std)]
    axial_std = np.linalg.norm([one.axial for one in found])

    assert found[0].axial_std == pytest.approx(axial_std, rel=0.01)
    assert estimated(lwr, std, **kinds).axial == pytest.approx(
        sum(one.axial for one in found)
    )


@pytest.mark.parametrize("mode", MODES)
def test_a_singular_pose_gives_finite_numbers_that_say_so(lwr, mode):
    torque = external_torque_of(lwr, NO_TORQUE, [0.0, 0.0, 5.0])
    found = estimated(lwr, torque, q=NO_TORQUE, mode=mode)
    undamped = estimated(lwr, torque, q=NO_TORQUE, mode="full", expected_force_N=None)

    assert np.isfinite(undamped.force).all()
    assert 50.0 < found.axial_std < undamped.axial_std
    assert found.damping_fraction.max() > 0.5


def test_an_unknown_frame_is_refused(lwr):
    with pytest.raises(UrdfError, match="nowhere"):
        WrenchEstimator(lwr, SensorConfig(frame="nowhere"))
