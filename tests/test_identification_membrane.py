"""A membrane is found where it began to be pushed in, and only where there is one."""

import numpy as np
import pytest

from groundtruth import ForceNoise, Layer, Scenario, insert_needle
from groundtruth.layers import Membrane, ShaftFriction
from groundtruth.motion import constant_motion
from identification import Identifier
from identification.layer_model import Gaussian, carried_friction, smoothed_layer
from identification.membrane import STARTS, best_membrane, fit_membranes, scale_layer
from identification.resampling import MOST_ROWS, NO_ROWS, add_layer_row, merge_rows

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


def test_few_rows_tell_nothing():
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


def test_hindsight_equals_all_data_at_once():
    """Smoothed belief about a layer = posterior of layer and later measurement, jointly."""
    rng = np.random.default_rng(3)
    root = rng.standard_normal((6, 6))
    belief = Gaussian(rng.standard_normal(6), root @ root.T + np.eye(6))
    thickness_m, value, variance = 12e-3, 0.7, 0.04
    prior = carried_friction(belief, thickness_m)
    row = np.array([1.0, 3.0])
    gain = prior.covariance @ row / (row @ prior.covariance @ row + variance)
    later = Gaussian(
        prior.values + gain * (value - row @ prior.values),
        prior.covariance - np.outer(gain, row @ prior.covariance),
    )
    smoothed = smoothed_layer(belief, thickness_m, later)
    carry = np.zeros((2, 6))
    carry[0, 0], carry[0, 4], carry[1, 1], carry[1, 5] = 1.0, 12.0, 1.0, 12.0
    direct = row @ carry
    gain = belief.covariance @ direct / (direct @ belief.covariance @ direct + variance)
    joint = belief.values + gain * (value - direct @ belief.values)
    spread = belief.covariance - np.outer(gain, direct @ belief.covariance)
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


def test_the_next_rupture_tells_what_the_membrane_hid():
    """Slippery behind rough: half of the slope, the prior, would be a bad guess of the friction."""
    membrane = Membrane(puncture_N=1.0, indentation_m=6e-3, hardening=0.6, release_m=0.3e-3)
    layers = (layer_of("slippery", 6.0), layer_of("rough", 35.0, membrane))
    motion = constant_motion(speed_m_s=SPEED_M_S, depth_m=63e-3, standoff_m=5e-3)
    needle = insert_needle(
        Scenario(id="hidden", title="hidden", layers=layers, motion=motion), seed=1, noise="mini45"
    )
    identifier, told = Identifier(), []
    for k in range(int(np.searchsorted(needle.t_s, needle.tare_end_s)), len(needle.t_s)):
        estimate = identifier.update(
            float(needle.depth_m[k]), float(needle.speed_m_s[k]), float(needle.force_N[k]), 1e-3
        )
        told += [estimate.identified_layer] if estimate.identified_layer else []
    truth = [rupture.layer_friction_N for rupture in needle.truth.ruptures]
    now = identifier.layers
    assert [layer.friction_N for layer in now] == pytest.approx(truth, rel=0.15)
    first = next(layer for layer in reversed(told) if layer.layer == 1)
    assert now[0].friction_std_N < 0.5 * first.friction_std_N
    assert abs(now[0].friction_N - truth[0]) < 2.0 * now[0].friction_std_N


@pytest.mark.parametrize("seed", [0, 1])
def test_a_missed_transition_is_not_taken_for_a_membrane(seed):
    """Fat to muscle drowns in this noise: their friction is found together, the liver's alone."""
    noise = ForceNoise(white_std_N=0.06, drift_std_N_per_s=0.0, step_N=1.0 / 256.0)
    needle = insert_needle("abdomen-sinusoidal", seed=seed, noise=noise)
    identifier = Identifier()
    for k in range(int(np.searchsorted(needle.t_s, needle.tare_end_s)), len(needle.t_s)):
        identifier.update(
            float(needle.depth_m[k]), float(needle.speed_m_s[k]), float(needle.force_N[k]), 1e-3
        )
    fat, muscle, liver = (rupture.layer_friction_N for rupture in needle.truth.ruptures)
    both, last = identifier.layers
    assert both.thickness_m == pytest.approx(40e-3, abs=4e-3)
    assert both.friction_N == pytest.approx(fat + muscle, rel=0.25)
    assert last.friction_N == pytest.approx(liver, rel=0.2)
