"""Ends of layers and tears within tissue, told apart as far as they can be."""

import math

import numpy as np
import pytest

from identification.layer_fit import add_layer_prior
from identification.layer_model import CUTTING, no_information
from identification.multilayer_config import MULTILAYER
from identification.multilayer_state import initial_default_state
from identification.rupture_classifier import (
    NO_RESIDUAL_FORCE,
    ResidualTipForce,
    end_probability,
    held_force,
    release_travel_m,
)

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
    assert held_force(1.0, 1.0, MULTILAYER) == pytest.approx((0.0, 0.0))
    mean, variance = held_force(1.0, 0.0, MULTILAYER)
    assert mean == pytest.approx(0.2)
    assert math.sqrt(variance) == pytest.approx(MULTILAYER.tear_share_std)
    assert held_force(-1.0, 0.3, MULTILAYER) == (0.0, 0.0)
    # Not to know is worse than either.
    assert held_force(1.0, 0.5, MULTILAYER).variance > 0.5 * variance


def test_a_layer_begins_with_nothing_held():
    state = initial_default_state(MULTILAYER)
    assert state.layer.held == NO_RESIDUAL_FORCE == ResidualTipForce(0.0, 0.0)


def test_what_is_held_is_expected_at_the_tip_of_the_next_layer():
    rows = [
        add_layer_prior(no_information(), 0.5, 10e-3, 3e-3, MULTILAYER, held)
        for held in (NO_RESIDUAL_FORCE, ResidualTipForce(0.3, 0.01))
    ]
    assert rows[0].vector[CUTTING] == 0.0
    assert rows[1].vector[CUTTING] > 0.0
    assert rows[1].matrix[CUTTING, CUTTING] < rows[0].matrix[CUTTING, CUTTING]
