"""What the force at a stop says of tip force and friction."""

import numpy as np
import pytest

from identification import replay
from tests.identification.worlds import insertion, noisy, rows_of, run, values_of


@pytest.mark.parametrize("kept_friction", [1.0, 0.7, 0.5])
def test_friction_at_a_stop_is_within_its_deviation(kept_friction):
    """A needle stops, with Coulomb and viscous friction of 20 N/m; a part remains."""
    t_s = np.arange(0.0, 20.0, 4e-3)
    depth_m = np.clip(3e-3 * (t_s - 2.0), 0.0, 40e-3)
    is_rest = depth_m == 40e-3
    friction_N = 20.0 * depth_m * np.where(is_rest, kept_friction, 1.0)
    tip_N = np.where(depth_m > 0.0, 0.3, 0.0)
    found = replay(t_s, depth_m, noisy(friction_N + tip_N, 5e-3, 0)).estimates
    shown_N = np.array([e.shaft_friction_N for e in found])
    std_N = np.array([e.shaft_friction_std_N for e in found])

    assert np.mean((np.abs(shown_N - friction_N) <= 2.0 * std_N)[is_rest]) > 0.95


def test_a_force_that_a_long_rest_leaves_is_split_as_before():
    t_s = np.arange(0.0, 40.0, 8e-3)
    depth_m = np.clip(3e-3 * (t_s - 2.0), 0.0, 40e-3)
    force_N = 20.0 * depth_m + np.where(depth_m > 0.0, 0.6, 0.0)
    found = replay(t_s, depth_m, noisy(force_N, 5e-3, 0)).estimates
    advancing = found[int(np.argmax(depth_m == 40e-3)) - 25]

    assert found[-1].tip_force_N == pytest.approx(advancing.tip_force_N, abs=0.1)


def test_friction_may_let_go_at_rest():
    _, estimates = run(insertion([(12e-3, 3.0), (0.0, 1.5)], seed=5))
    resting = estimates[4400]

    assert resting.shaft_friction_N < 0.95 * estimates[3100].shaft_friction_N
    assert abs(resting.shaft_friction_N - 0.1) < 2.0 * resting.shaft_friction_std_N


def test_a_rupture_after_a_reversal_is_found_by_a_needle_that_speeds_up():
    """Friction at 10 mm/s makes the force higher than it was before the rupture."""
    moves = [(19e-3, 4.75), (-0.1e-3, 0.2), (0.6e-3, 0.5), (15e-3, 1.5)]
    _, estimates = run(insertion(moves))
    (rupture,) = values_of(estimates, "rupture")

    assert rupture.depth_m == pytest.approx(15e-3, abs=0.1e-3)


def kept_at_second_stop(kept):
    """Friction, over that before the stop, at the second stop that keeps a fraction."""
    speed_m_s = np.tile(np.repeat([3e-3, 0.0], [1_000, 250]), 2)
    depth_m = 4e-3 * np.cumsum(speed_m_s) - 2e-3
    friction_N = 40.0 * np.maximum(depth_m, 0.0) * np.where(speed_m_s, 1.0, kept)
    _, estimates = run(rows_of(depth_m, speed_m_s, noisy(friction_N, 4e-3, 3), 4e-3))
    return estimates[2_260].predicted_force_N / estimates[2_245].predicted_force_N


def test_what_a_stop_has_shown_is_expected_at_the_next():
    assert kept_at_second_stop(0.9) > kept_at_second_stop(0.55) + 0.1


@pytest.mark.parametrize("speed_m_s", [2.7e-3, 2.9e-3])
def test_the_tip_force_does_not_jump_where_the_needle_begins_to_brake(speed_m_s):
    rows = insertion([(30e-3, 10.0)], seed=1)[:9_000]
    identifier, estimates = run(rows)
    last = estimates[-1]
    braking = identifier.update(*rows[-1]._replace(speed_m_s=speed_m_s))

    assert abs(braking.tip_force_N - last.tip_force_N) < 2.0 * last.tip_force_std_N


def test_a_tip_without_force_has_a_deviation_that_covers_it_at_rest():
    """Behind the last layer all of the force is friction, of which half stays."""
    _, estimates = run(insertion([(46e-3, 11.5), (0.0, 1.0)]))
    for last in estimates[-800::100]:
        assert last.tip_force_std_N > 1e-3
        assert 0.0 <= last.tip_force_N <= 2.0 * last.tip_force_std_N
        assert abs(last.shaft_friction_N - 0.59) <= 2.0 * last.shaft_friction_std_N
