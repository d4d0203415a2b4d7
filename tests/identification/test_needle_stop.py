"""What the force at a stop says of tip force and friction."""

import numpy as np
import pytest

from identification import replay
from tests.identification.worlds import insertion, noisy, rows_of, run


def stopped(kept_friction, kept_tip, seed=0, speed_m_s=3e-3, stop_m=40e-3):
    """A needle that stops at a depth, with Coulomb and viscous friction of 20 N/m.

    At rest fractions of friction and tip force remain; then it goes on.

    Returns:
        Its rest and true friction there, and the result of a replay.
    """
    t_s = np.arange(0.0, 20.0, 4e-3)
    depth_m = np.clip(speed_m_s * (t_s - 2.0), 0.0, stop_m)
    friction_N = 20.0 * depth_m
    tip_N = np.where(depth_m > 0.0, 0.3, 0.0)
    is_rest = (depth_m >= stop_m) & (t_s > 2.0)
    force_N = np.where(
        is_rest, kept_friction * friction_N + kept_tip * tip_N, friction_N + tip_N
    )
    result = replay(t_s, depth_m, noisy(force_N, 5e-3, seed))
    return is_rest, kept_friction * friction_N, result


@pytest.mark.parametrize("kept_friction", [1.0, 0.7, 0.5])
def test_friction_at_a_stop_is_within_its_deviation(kept_friction):
    is_rest, friction_N, result = stopped(kept_friction, 1.0)
    rest = [e for e, held in zip(result.estimates, is_rest, strict=True) if held]
    error_N = np.array([e.shaft_friction_N for e in rest]) - friction_N[is_rest]
    std_N = np.array([e.shaft_friction_std_N for e in rest])

    assert np.mean(np.abs(error_N) <= 2.0 * std_N) > 0.95


def test_friction_may_let_go_at_rest():
    _, estimates = run(insertion([(12e-3, 3.0), (0.0, 1.5)], seed=5))
    moving = estimates[3100]
    resting = estimates[4400]
    error_N = abs(resting.shaft_friction_N - 0.1)

    assert resting.shaft_friction_N < 0.95 * moving.shaft_friction_N
    assert error_N < 2.0 * resting.shaft_friction_std_N


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
    last = rows[-1]
    braking = identifier.update(last.depth_m, speed_m_s, last.force_N, 1e-3)

    change_N = abs(braking.tip_force_N - estimates[-1].tip_force_N)
    assert change_N < 2.0 * estimates[-1].tip_force_std_N


def test_a_tip_without_force_has_a_deviation_that_covers_it_at_rest():
    """Behind the last layer all of the force is friction, of which half stays."""
    rows = insertion([(46e-3, 11.5), (0.0, 1.0)])
    _, estimates = run(rows)
    for last in estimates[-800::100]:
        assert last.tip_force_std_N > 1e-3
        assert 0.0 <= last.tip_force_N <= 2.0 * last.tip_force_std_N
        assert abs(last.shaft_friction_N - 0.59) <= 2.0 * last.shaft_friction_std_N
