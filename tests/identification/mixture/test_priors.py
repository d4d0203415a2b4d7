"""Priors of a layer: what stays of them once the growth of the force is known."""

import numpy as np
import pytest

from foundation.arrays import WrittenMatrix, WrittenVector
from foundation.jit import compiled
from foundation.linear_algebra import dot
from identification.mixture.force_model import (
    LAYER_COULOMB,
    LAYER_VISCOUS,
    STIFFNESS,
    UNKNOWNS,
)
from identification.mixture.kalman import times, update
from identification.mixture.priors import (
    add_friction_prior,
    add_stiffness_prior,
    use_friction_fraction,
)

SPEED_MM_S = 3.0  # friction is half of the growth there, with a deviation of 0.2


@compiled
def learn_growth(
    mean: WrittenVector,
    covariance: WrittenMatrix,
    growth: float,
    prior_speed: float,
    speed: float,
) -> bool:
    add_stiffness_prior(mean, covariance, prior_speed)
    add_friction_prior(mean, covariance, prior_speed)
    row = np.zeros(UNKNOWNS)
    row[STIFFNESS] = 1.0
    row[LAYER_COULOMB] = 1.0
    row[LAYER_VISCOUS] = speed
    cross_covariance = times(covariance, row)
    variance = dot(row, cross_covariance) + (1e-3 * growth) ** 2
    innovation = growth - dot(row, mean)
    update(mean, covariance, cross_covariance, innovation, variance)
    return use_friction_fraction(mean, covariance, speed, prior_speed, False)


@pytest.mark.parametrize("growth_N_per_mm", [0.01, 0.05, 0.27])
def test_friction_is_as_uncertain_a_part_of_every_growth(growth_N_per_mm):
    mean = np.zeros(UNKNOWNS)
    covariance = np.zeros((UNKNOWNS, UNKNOWNS))

    assert learn_growth(mean, covariance, growth_N_per_mm, SPEED_MM_S, SPEED_MM_S)

    stiffness_std = np.sqrt(covariance[STIFFNESS, STIFFNESS])
    assert mean[STIFFNESS] / growth_N_per_mm == pytest.approx(0.5, abs=0.02)
    assert stiffness_std / growth_N_per_mm == pytest.approx(0.2, abs=0.01)


def test_a_prior_of_another_speed_leaves_a_covariance():
    mean = np.zeros(UNKNOWNS)
    covariance = np.zeros((UNKNOWNS, UNKNOWNS))

    assert learn_growth(mean, covariance, 0.1, 1.0, 30.0)

    kept = np.ix_([STIFFNESS, LAYER_COULOMB, LAYER_VISCOUS], [0, 1, 2])[0]
    assert (np.linalg.eigvalsh(covariance[kept, kept.T]) > 0.0).all()
    assert 0.05 < mean[STIFFNESS] / 0.1 < 0.3  # 0.15 at 30 mm/s
