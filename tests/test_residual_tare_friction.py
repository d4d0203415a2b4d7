"""Friction between torque sensor and link, and contact in the motion of a tare."""

from dataclasses import replace

import numpy as np
import pytest
from residual_signals import MIDDLE

from groundtruth.bearing_friction import BearingFriction
from groundtruth.plant_model import CLEAN
from residual import DEFAULT, TareError, WrenchEstimator
from residual.bias_estimator import BiasEstimator

DT_S = 4e-3
REACH_RAD = np.array([0.01, 0.1, 0.02, 0.13, 0.035, 0.22, 0.03])
NOISE_NM = np.array([0.05, 0.05, 0.03, 0.03, 0.03, 0.011, 0.011]) * 0.19
"""Torque noise of the plant `clean` after the observer's low-pass."""


def quintic(s):
    return s**3 * (10.0 + s * (6.0 * s - 15.0))


def place(t_s):
    """A second of rest, three strokes of 4 s, then on at a tenth of their speed, 0 to 1.3."""
    stroke, s = np.divmod(np.clip((t_s - 1.0) / 4.0, 0.0, 3.0), 1.0)
    there = np.where(stroke % 2 == 0, quintic(s), 1.0 - quintic(s))
    return np.where(stroke == 3, 1.0 + 0.03 * (t_s - 13.0), there)


class Arm:
    """Residuals of a simulated arm whose bearings rub; no tissue but what a test adds."""

    def __init__(self, robot, coulomb_Nm, seed):
        rng = self.rng = np.random.default_rng(seed)
        model = replace(
            CLEAN, joint_coulomb=1.0, joint_viscous_Nms_per_rad=(0.3 * coulomb_Nm.max(),) * 7
        )
        self.bearings = BearingFriction(model, coulomb_Nm, rng)
        self.offset = rng.uniform(-0.5, 0.5, 7)
        self.wrench = WrenchEstimator(robot)

    def feed(self, estimator, times, force=lambda _t: 0.0, *, record=True):
        """Feed an estimator; returns error and std of the axial force at every sample."""
        found = []
        for t in times:
            q = MIDDLE + place(t) * REACH_RAD
            dq = (place(t + 1e-4) - place(t - 1e-4)) / 2e-4 * REACH_RAD
            rubbed = self.bearings.step(dq, DT_S)
            self.wrench.kinematics.update(q)
            pushed = -force(t) * self.wrench.kinematics.axial_jacobian
            residual = self.offset + rubbed + pushed
            tau = estimator._basis.gravity_Nm(q) - residual
            estimator.follow(q, tau, DT_S)
            residual = residual + NOISE_NM * self.rng.standard_normal(7)
            if record:
                estimator.record(residual, DT_S)
            elif estimator.memory.renewed_s == estimator.memory.now_s:
                self.wrench.set_torque_covariance(estimator.covariance_Nm2())
                seen = self.wrench.estimate(q, residual - estimator.memory.bias)
                found.append((seen.axial - force(t), seen.axial_std))
        return np.array(found).T


def tare_times(end_s=13.0):
    return np.arange(0.0, end_s, DT_S)


def drawn_friction(seed, factor=1.0):
    """0.02 to 0.1 Nm, equal chance per octave."""
    return factor * 0.02 * 5.0 ** np.random.default_rng([seed, 1]).uniform(size=7)


@pytest.mark.parametrize(("factor", "most_N"), [(1.0, 0.05), (3.0, 0.1)])
@pytest.mark.parametrize("seed", [0, 1])
def test_friction_is_learnt_from_forward_and_back_strokes(lwr, factor, most_N, seed):
    arm, estimator = Arm(lwr, drawn_friction(seed, factor), seed), BiasEstimator(lwr, DEFAULT)
    arm.feed(estimator, tare_times())
    estimator.tare(WrenchEstimator(lwr), ignore_contact=False)
    error, std = arm.feed(estimator, np.arange(13.0, 21.0, DT_S), record=False)
    assert np.sqrt(np.mean(error**2)) < most_N
    assert np.mean(np.abs(error) < 2.0 * std) > 0.85


@pytest.mark.parametrize("since_s", [5.0, 11.0])
@pytest.mark.parametrize("seed", [2, 3])
def test_contact_is_refused_in_spite_of_friction(lwr, since_s, seed):
    arm, estimator = Arm(lwr, drawn_friction(seed), seed), BiasEstimator(lwr, DEFAULT)
    arm.feed(estimator, tare_times(), force=lambda t: 0.5 * min(1.0, max(0.0, t - since_s) / 0.3))
    with pytest.raises(TareError, match="in contact"):
        estimator.tare(WrenchEstimator(lwr), ignore_contact=False)


def test_a_short_tare_says_what_it_does_not_know(lwr):
    """Rest alone shows no friction: the standard deviation grows when the arm moves, and holds."""
    arm, estimator = Arm(lwr, drawn_friction(5), 5), BiasEstimator(lwr, DEFAULT)
    arm.feed(estimator, tare_times(1.0))
    estimator.tare(WrenchEstimator(lwr), ignore_contact=False)
    _, at_rest = arm.feed(estimator, np.arange(0.9, 1.0, DT_S), record=False)
    error, moving = arm.feed(estimator, np.arange(1.0, 3.0, DT_S), record=False)
    assert moving[-1] > 3.0 * at_rest[-1]
    assert np.mean(np.abs(error) < 2.0 * moving) > 0.85
