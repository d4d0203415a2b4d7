"""A force that is back on its old line was never let go; one that only crosses it was."""

import numpy as np

from identification.rupture_classifier import is_made_good

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
            is_made_good(points_of(force, 0.005, seed), FALL_M, FALL_N, 0.005**2)
            for seed in range(50)
        ]
        for force in (back_on_its_line, fallen, crossing)
    ]
    assert sum(told[0]) >= 47  # chance hides one in a hundred
    assert not any(told[1])
    assert not any(told[2])


def test_where_noise_hides_the_slope_nothing_is_withdrawn():
    points = points_of(back_on_its_line, 0.05)
    assert not is_made_good(points, FALL_M, FALL_N, 0.05**2)


def test_few_points_tell_nothing():
    points = points_of(back_on_its_line, 0.005)
    assert not is_made_good(points[:203], FALL_M, FALL_N, 0.005**2)
    assert not is_made_good(points[205:], FALL_M, FALL_N, 0.005**2)
