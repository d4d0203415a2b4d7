"""Membranes, ends of layers, partial ruptures and false alarms, separated as far as they can be."""

import math

import numpy as np
import pytest

from groundtruth import ForceNoise, Layer, Scenario, insert_needle
from groundtruth.layers import Membrane, ShaftFriction
from groundtruth.motion import constant_motion
from identification import MULTILAYER, replay
from identification.layer_model import (
    CUTTING,
    Gaussian,
    add_layer_prior,
    carried_friction,
    no_information,
    smoothed_layer,
)
from identification.membrane import STARTS, best_membrane, fit_membranes, scale_layer
from identification.multilayer_state import initial_multilayer_state
from identification.resampling import MOST_ROWS, NO_ROWS, add_layer_row, merge_rows
from identification.rupture_classifier import (
    ResidualTipForce,
    end_probability,
    fit_line,
    has_recovered,
    release_travel_m,
    residual_tip_force,
)

LENGTH_M = 30e-3
ROW_M = 2.5e-4
SPEED_M_S = 3e-3


def rows_of(force_of_depth, noise_N=0.0, seed=0, speed=None):
    depth = np.arange(0.5 * ROW_M, LENGTH_M, ROW_M)
    rng = np.random.default_rng(seed)
    force = force_of_depth(depth) + noise_N * rng.standard_normal(len(depth))
    speeds = np.full_like(depth, SPEED_M_S) if speed is None else speed(depth)
    ones = np.ones_like(depth)
    return np.column_stack([depth, speeds, force, ones, 16.0 * ones, ROW_M * ones])


def find_membrane(rows, start_m, rupture_m):
    layer = scale_layer(rows, start_m, rupture_m)
    return None if layer is None else best_membrane(layer, fit_membranes(layer, STARTS))


def pushed_in(start_m, puncture_N, hardening, slope_N_per_m):
    def force(depth):
        u = np.maximum(depth - start_m, 0.0) / (LENGTH_M - start_m)
        spring = puncture_N * u * (1.0 + hardening * (u - 1.0))
        return slope_N_per_m * np.minimum(depth, start_m) + spring

    return force


@pytest.mark.parametrize("hardening", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("slope_N_per_m", [15.0, 60.0])
@pytest.mark.parametrize("start_m", [15e-3, 24e-3])
def test_a_membrane_is_found_where_it_began(hardening, slope_N_per_m, start_m):
    rows = rows_of(pushed_in(start_m, 1.5, hardening, slope_N_per_m), noise_N=0.005)
    found = find_membrane(rows, 1e-3, LENGTH_M)
    assert found is not None
    assert abs(found.depth_m - start_m) < max(4.0 * found.std_m, 3e-4)
    assert found.std_m < 1.5e-3
    assert found.force_N == pytest.approx(slope_N_per_m * start_m, abs=0.1)


@pytest.mark.parametrize("seed", range(20))
def test_no_membrane_is_seen_in_a_layer_that_stiffens_or_changes_speed(seed):
    def force(depth):
        u = depth / LENGTH_M
        return 1.2 * u * (1.0 + 0.3 * u) / 1.3 + 100.0 * speed(depth)

    def speed(depth):
        return SPEED_M_S * np.sin(np.pi * (0.2 + 0.7 * depth / LENGTH_M))

    assert find_membrane(rows_of(force, 0.01, seed, speed), 1e-3, LENGTH_M) is None


def test_a_single_spring_has_no_boundary_in_it():
    def capsule(depth):
        u = depth / LENGTH_M
        return 1.4 * u * (0.2 + 0.8 * u)

    assert find_membrane(rows_of(capsule, 0.005), 0.0, LENGTH_M) is None


def test_few_rows_show_no_membrane():
    assert find_membrane(rows_of(pushed_in(15e-3, 1.5, 0.5, 30.0))[:10], 0.0, LENGTH_M) is None
    assert find_membrane(NO_ROWS, 0.0, LENGTH_M) is None


def test_rows_are_bounded_and_keep_what_they_stand_for():
    rows = NO_ROWS
    for k in range(1000):
        rows = add_layer_row(rows, np.array([k, 1.0, 2.0 * k, 1.0, 2.0, 1e-4]))
        assert len(rows) <= MOST_ROWS
    assert np.allclose(rows[:, 2], 2.0 * rows[:, 0])
    assert rows[-1, 0] == 999.0
    merged = merge_rows(rows, 3)
    assert merged[:, 4].sum() == rows[len(rows) % 3 :, 4].sum()


def test_smoothing_equals_all_data_at_once():
    """The smoothed posterior of a layer is that of the layer and the later measurement, jointly."""
    rng = np.random.default_rng(3)
    root = rng.standard_normal((6, 6))
    layer = Gaussian(rng.standard_normal(6), root @ root.T + np.eye(6))
    thickness_m, value, variance = 12e-3, 0.7, 0.04
    prior = carried_friction(layer, thickness_m)
    row = np.array([1.0, 3.0])
    gain = prior.covariance @ row / (row @ prior.covariance @ row + variance)
    later = Gaussian(
        prior.values + gain * (value - row @ prior.values),
        prior.covariance - np.outer(gain, row @ prior.covariance),
    )
    smoothed = smoothed_layer(layer, thickness_m, later)
    carry = np.zeros((2, 6))
    carry[0, 0], carry[0, 4], carry[1, 1], carry[1, 5] = 1.0, 12.0, 1.0, 12.0
    direct = row @ carry
    gain = layer.covariance @ direct / (direct @ layer.covariance @ direct + variance)
    joint = layer.values + gain * (value - direct @ layer.values)
    spread = layer.covariance - np.outer(gain, direct @ layer.covariance)
    assert np.allclose(smoothed.values, joint)
    assert np.allclose(smoothed.covariance, spread)


def layer_of(name, friction_N_per_m, membrane=None):
    friction = ShaftFriction.calibrated(
        force_N_per_m=friction_N_per_m,
        reference_speed_m_s=SPEED_M_S,
        coulomb_fraction=0.5,
        presliding_m=0.2e-3,
    )
    return Layer(
        name=name,
        thickness_m=25e-3,
        exit_force_N=1.0,
        cutting_fraction=0.05,
        stiffening=0.1,
        release_m=0.3e-3,
        relaxed_fraction=0.2,
        friction=friction,
        membrane=membrane,
    )


def identified(scenario, seed, noise):
    """A recording of the needle through the identifier, and the true friction of each layer."""
    needle = insert_needle(scenario, seed=seed, noise=noise)
    first = int(np.searchsorted(needle.t_s, needle.tare_end_s))
    columns = (needle.t_s, needle.depth_m, needle.force_N, needle.speed_m_s)
    truth = [rupture.layer_friction_N for rupture in needle.truth.ruptures]
    return replay(*(column[first:] for column in columns)), truth


def test_the_next_rupture_reveals_what_the_membrane_hid():
    """Slippery behind rough: half of the slope, the prior, would be a bad guess of the friction."""
    membrane = Membrane(puncture_N=1.0, indentation_m=6e-3, hardening=0.6, release_m=0.3e-3)
    layers = (layer_of("slippery", 6.0), layer_of("rough", 35.0, membrane))
    motion = constant_motion(speed_m_s=SPEED_M_S, depth_m=63e-3, standoff_m=5e-3)
    scenario = Scenario(id="hidden", title="hidden", layers=layers, motion=motion)
    result, truth = identified(scenario, 1, "mini45")
    now, then = result.layers, [e.identified_layer for e in result.estimates if e.identified_layer]
    assert [layer.friction_N for layer in now] == pytest.approx(truth, rel=0.15)
    first = next(layer for layer in reversed(then) if layer.layer == 1)
    assert now[0].friction_std_N < 0.5 * first.friction_std_N
    assert abs(now[0].friction_N - truth[0]) < 2.0 * now[0].friction_std_N


@pytest.mark.parametrize("seed", [0, 1])
def test_a_missed_transition_is_not_taken_for_a_membrane(seed):
    """Fat to muscle drowns in this noise: their friction is found together, the liver's alone."""
    noise = ForceNoise(white_std_N=0.06, drift_std_N_per_s=0.0, step_N=1.0 / 256.0)
    result, (fat, muscle, liver) = identified("abdomen-sinusoidal", seed, noise)
    both, last = result.layers
    assert both.thickness_m == pytest.approx(40e-3, abs=4e-3)
    assert both.friction_N == pytest.approx(fat + muscle, rel=0.25)
    assert last.friction_N == pytest.approx(liver, rel=0.2)


# What a rupture was.


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


def recoveries(force, noise_N, seeds=range(50)):
    given = (points_of(force, noise_N, seed) for seed in seeds)
    return [has_recovered(points, FALL_M, FALL_N, noise_N**2) for points in given]


def test_a_dent_has_recovered_and_a_rupture_has_not():
    assert sum(recoveries(back_on_its_line, 0.005)) >= 47  # chance hides one in a hundred
    assert not any(recoveries(fallen, 0.005))
    assert not any(recoveries(crossing, 0.005))
    # Where noise hides the slope nothing is retracted.
    assert not any(recoveries(back_on_its_line, 0.05, [0]))


def test_few_points_show_no_recovery():
    points = points_of(back_on_its_line, 0.005)
    assert not has_recovered(points[:203], FALL_M, FALL_N, 0.005**2)
    assert not has_recovered(points[205:], FALL_M, FALL_N, 0.005**2)


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


def test_a_travel_needs_points_on_both_sides_and_a_fall():
    noisy = points(0.2e-3, drop_N=0.15, noise_N=0.02, slope_N_per_m=0.0)
    assert release_travel_m(noisy, FALL_M, 0.85) < 0.35e-3  # noise after it is no slow fall
    assert math.isnan(release_travel_m(points(1e-3)[:4], FALL_M, 0.5))
    assert math.isnan(release_travel_m(points(1e-3)[:140], FALL_M, 0.5))
    assert release_travel_m(points(1e-3, drop_N=0.0), FALL_M, 2.0) >= 0.0


def test_a_short_release_of_much_force_is_an_end_and_a_long_one_of_little_a_partial_rupture():
    assert end_probability(0.2e-3, 0.5, (), MULTILAYER) > 0.98
    assert end_probability(1e-3, 0.15, (), MULTILAYER) < 0.05
    chances = [end_probability(travel, 0.4, (), MULTILAYER) for travel in (0.2e-3, 0.5e-3, 1e-3)]
    assert chances == sorted(chances, reverse=True)
    assert end_probability(math.nan, 0.5, (), MULTILAYER) > 0.98


def test_tissue_that_has_ruptured_partially_is_expected_to_do_so_again():
    plain = end_probability(0.35e-3, 0.3, (), MULTILAYER)
    assert end_probability(0.35e-3, 0.3, (0.0, 0.1), MULTILAYER) < plain
    assert end_probability(0.35e-3, 0.3, (1.0, 0.9), MULTILAYER) > plain


@pytest.mark.parametrize("drop_fraction", [-0.5, 0.0, 1.0, 5.0])
@pytest.mark.parametrize("travel", [0.0, 1e-3, 1e3])
def test_a_probability_is_one_whatever_comes(travel, drop_fraction):
    assert 0.0 < end_probability(travel, drop_fraction, (), MULTILAYER) < 1.0


def test_no_tip_force_remains_after_an_end_and_a_fifth_of_the_force_after_a_partial_rupture():
    assert residual_tip_force(1.0, 1.0, MULTILAYER) == pytest.approx((0.0, 0.0))
    mean, variance = residual_tip_force(1.0, 0.0, MULTILAYER)
    assert mean == pytest.approx(0.2)
    assert math.sqrt(variance) == pytest.approx(MULTILAYER.partial_rupture_friction_fraction_std)
    assert residual_tip_force(-1.0, 0.3, MULTILAYER) == (0.0, 0.0)
    # Not to know is worse than either.
    assert residual_tip_force(1.0, 0.5, MULTILAYER).variance > 0.5 * variance


def test_the_tip_force_that_remains_is_expected_at_the_tip_of_the_next_layer():
    assert initial_multilayer_state(MULTILAYER).layer.residual == (0.0, 0.0)
    rows = [
        add_layer_prior(no_information(), 0.5, 10e-3, 3e-3, MULTILAYER, residual)
        for residual in (ResidualTipForce(), ResidualTipForce(0.3, 0.01))
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
    found = fit_line(offset, value, weight)
    spread = [covariance[0, 0], covariance[0, 1], covariance[1, 1]]
    assert found == pytest.approx((level, slope, *spread))
