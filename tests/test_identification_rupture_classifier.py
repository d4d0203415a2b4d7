"""Ends of layers, partial ruptures and false alarms, separated as far as they can be."""

import math

import numpy as np
import pytest

from identification.config import MULTILAYER
from identification.layer_fit import add_layer_prior
from identification.layer_model import CUTTING, no_information
from identification.multilayer_state import initial_multilayer_state
from identification.rupture_classifier import (
    NO_RESIDUAL_FORCE,
    ResidualTipForce,
    end_probability,
    fit_line,
    has_recovered,
    release_travel_m,
    residual_tip_force,
)

FALL_M = 20e-3
FALL_N = 0.3
STEP_M = 2e-5


def points_of(late_force_N, noise_N, seed=0):
    """Track points from 4 mm before the fall to 3 mm after it; 60 N/m before."""
    depth = np.arange(FALL_M - 4e-3, FALL_M + 3e-3, STEP_M)
    reach = depth - FALL_M
    force = np.where(reach < 0.0, 60.0 * depth, late_force_N(depth))
    force = force + noise_N * np.random.default_rng(seed).standard_normal(len(depth))
    ones = np.ones_like(depth)
    return np.column_stack([depth, 3e-3 * ones, force, ones, ones, STEP_M * ones])


def back_on_its_line(depth):
    dent = np.clip((depth - FALL_M) / 2e-4, 0.0, 1.0) * (depth < FALL_M + 1e-3)
    return 60.0 * depth - FALL_N * dent


def fallen(depth):
    return 60.0 * depth - FALL_N * np.clip((depth - FALL_M) / 2e-4, 0.0, 1.0)


def crossing(depth):
    """A stiffer layer whose force meets the old line 2.5 mm on."""
    return 60.0 * FALL_M - FALL_N + (60.0 + FALL_N / 2.5e-3) * (depth - FALL_M)


def test_a_dent_is_made_good_and_a_rupture_is_not():
    told = [
        [
            has_recovered(points_of(force, 0.005, seed), FALL_M, FALL_N, 0.005**2)
            for seed in range(50)
        ]
        for force in (back_on_its_line, fallen, crossing)
    ]
    assert sum(told[0]) >= 47  # chance hides one in a hundred
    assert not any(told[1])
    assert not any(told[2])


def test_where_noise_hides_the_slope_nothing_is_withdrawn():
    points = points_of(back_on_its_line, 0.05)
    assert not has_recovered(points, FALL_M, FALL_N, 0.05**2)


def test_few_points_tell_nothing():
    points = points_of(back_on_its_line, 0.005)
    assert not has_recovered(points[:203], FALL_M, FALL_N, 0.005**2)
    assert not has_recovered(points[205:], FALL_M, FALL_N, 0.005**2)


FALL_M = 20e-3


def points(travel_m, drop_N=0.5, noise_N=0.0, slope_N_per_m=10.0):
    """A force that grows, falls by `drop_N` over `travel_m`, and grows on."""
    depth = np.arange(FALL_M - 3e-3, FALL_M + 3e-3, 2e-5)
    fallen = drop_N * np.clip((depth - FALL_M) / travel_m, 0.0, 1.0)
    rng = np.random.default_rng(1)
    force = 1.0 + slope_N_per_m * (depth - FALL_M) - fallen
    force = force + noise_N * rng.standard_normal(len(depth))
    return np.column_stack([depth, np.full_like(depth, 3e-3), force, *np.ones((3, len(depth)))])


@pytest.mark.parametrize("travel_m", [0.2e-3, 0.5e-3, 1.5e-3])
@pytest.mark.parametrize("noise_N", [0.0, 0.01])
def test_the_travel_of_a_fall_is_measured(travel_m, noise_N):
    found = release_travel_m(points(travel_m, noise_N=noise_N), FALL_M, 0.5)
    assert found == pytest.approx(0.7 * travel_m, rel=0.25, abs=6e-5)


def test_noise_after_a_small_fall_is_no_slow_fall():
    noisy = points(0.2e-3, drop_N=0.15, noise_N=0.02, slope_N_per_m=0.0)
    assert release_travel_m(noisy, FALL_M, 0.85) < 0.35e-3


def test_a_travel_needs_points_on_both_sides():
    assert math.isnan(release_travel_m(points(1e-3)[:4], FALL_M, 0.5))
    assert math.isnan(release_travel_m(points(1e-3)[:140], FALL_M, 0.5))


def test_a_rising_force_has_no_travel():
    rising = points(1e-3, drop_N=0.0)
    assert release_travel_m(rising, FALL_M, 2.0) >= 0.0


def test_a_short_release_of_much_force_is_an_end_and_a_long_one_of_little_a_tear():
    assert end_probability(0.2e-3, 0.5, (), MULTILAYER) > 0.98
    assert end_probability(1e-3, 0.15, (), MULTILAYER) < 0.05
    shares = [end_probability(travel, 0.4, (), MULTILAYER) for travel in (0.2e-3, 0.5e-3, 1e-3)]
    assert shares == sorted(shares, reverse=True)
    assert end_probability(math.nan, 0.5, (), MULTILAYER) > 0.98


def test_tissue_that_has_torn_is_believed_to_tear_again():
    plain = end_probability(0.35e-3, 0.3, (), MULTILAYER)
    assert end_probability(0.35e-3, 0.3, (0.0, 0.1), MULTILAYER) < plain
    assert end_probability(0.35e-3, 0.3, (1.0, 0.9), MULTILAYER) > plain


@pytest.mark.parametrize("share", [-0.5, 0.0, 1.0, 5.0])
@pytest.mark.parametrize("travel", [0.0, 1e-3, 1e3])
def test_a_probability_is_one_whatever_comes(travel, share):
    assert 0.0 < end_probability(travel, share, (), MULTILAYER) < 1.0


def test_nothing_is_held_after_an_end_and_a_fifth_of_the_force_after_a_tear():
    assert residual_tip_force(1.0, 1.0, MULTILAYER) == pytest.approx((0.0, 0.0))
    mean, variance = residual_tip_force(1.0, 0.0, MULTILAYER)
    assert mean == pytest.approx(0.2)
    assert math.sqrt(variance) == pytest.approx(MULTILAYER.partial_rupture_friction_fraction_std)
    assert residual_tip_force(-1.0, 0.3, MULTILAYER) == (0.0, 0.0)
    # Not to know is worse than either.
    assert residual_tip_force(1.0, 0.5, MULTILAYER).variance > 0.5 * variance


def test_a_layer_begins_with_nothing_held():
    state = initial_multilayer_state(MULTILAYER)
    assert state.layer.residual == NO_RESIDUAL_FORCE == ResidualTipForce(0.0, 0.0)


def test_what_is_held_is_expected_at_the_tip_of_the_next_layer():
    rows = [
        add_layer_prior(no_information(), 0.5, 10e-3, 3e-3, MULTILAYER, held)
        for held in (NO_RESIDUAL_FORCE, ResidualTipForce(0.3, 0.01))
    ]
    assert rows[0].vector[CUTTING] == 0.0
    assert rows[1].vector[CUTTING] > 0.0
    assert rows[1].matrix[CUTTING, CUTTING] < rows[0].matrix[CUTTING, CUTTING]


def test_level_slope_and_covariance_are_those_of_weighted_least_squares():
    rng = np.random.default_rng(5)
    offset, weight = rng.uniform(-1.0, 2.0, 40), rng.uniform(1.0, 9.0, 40)
    value = 0.7 - 0.2 * offset + 0.1 * rng.standard_normal(40)
    columns = np.column_stack([np.ones(40), offset])
    covariance = np.linalg.inv(columns.T @ (columns * weight[:, None]))
    level, slope = covariance @ (columns.T @ (weight * value))
    line = fit_line(offset, value, weight)
    assert (line.level, line.slope) == pytest.approx((level, slope))
    found = [[line.level_var, line.both], [line.both, line.slope_var]]
    np.testing.assert_allclose(found, covariance)
