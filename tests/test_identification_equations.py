"""Every online equation of the paper, one by one, the rupture states and the re-run by windows."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.estimate import RuptureState as S
from identification.estimate import next_rupture_state
from identification.published_identifier import (
    RlsState,
    cusum_constants,
    drop_interval_s,
    force_drop_N,
    force_ratios,
    reset_covariance,
    reweighted_friction_variance,
)
from identification.published_update import (
    NO_WINDOWS,
    WindowSums,
    add_neighbours,
    add_sample,
    append_window,
    cusum_step,
    derivative_step,
    less_viscous_force,
    less_viscous_windows,
    rerun_windows,
    rls_step,
    window_step,
)

number = st.floats(-2.0, 2.0)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(number, number, number), min_size=1, max_size=30))
def test_rls_equals_ridge_regression(rows):
    """(7)(8) with lambda = 1 from covariance Psi_0 is a ridge regression."""
    state = (0.0, 0.0, 4.0, 0.0, 9.0)
    for x, y, f in rows:
        state, _ = rls_step(state, (x, y), f, 1.0)
    table = np.array(rows)
    phi, f = table[:, :2], table[:, 2]
    information = np.diag([1 / 4.0, 1 / 9.0]) + phi.T @ phi
    expected = np.linalg.solve(information, phi.T @ f)
    assert np.allclose(state[:2], expected, atol=1e-8)
    covariance = np.linalg.inv(information)
    assert np.allclose(state[2:], [covariance[0, 0], covariance[0, 1], covariance[1, 1]], atol=1e-8)


def test_rls_error_is_the_innovation():
    _, error = rls_step((2.0, 3.0, 1.0, 0.0, 1.0), (0.5, 0.25), 4.0, 1.0)
    assert error == pytest.approx(4.0 - 2.0 * 0.5 - 3.0 * 0.25)


def test_covariance_reset_keeps_the_estimate():
    state = reset_covariance(RlsState(2.0, 3.0, 0.1, 0.05, 0.1), 7.0, 8.0)
    assert state == RlsState(2.0, 3.0, 7.0, 0.0, 8.0)


def test_cusum_constants_are_those_of_equation_9():
    drift, threshold = cusum_constants(0.01, 0.08)
    assert drift == pytest.approx((0.08**2 + 0.01**2) / 2)
    assert threshold == pytest.approx((0.08**2 - 0.01**2) / 2)


def test_cusum_stays_at_zero_in_the_standard_case_and_grows_in_the_other():
    drift, _ = cusum_constants(0.01, 0.08)
    assert cusum_step(0.0, 0.01, drift) == 0.0
    assert cusum_step(0.5, 0.08, drift) == pytest.approx(0.5 + 0.08**2 - drift)


@given(st.floats(1e-3, 1.0), st.floats(1e-3, 1.0))
def test_derivative_of_a_ramp_needs_no_particular_step(first_s, second_s):
    """Two steps over a ramp equal one over both."""
    slope = 3.0
    twice = derivative_step(1.0, slope * first_s, first_s, 0.2)
    twice = derivative_step(twice, slope * second_s, second_s, 0.2)
    once = derivative_step(1.0, slope * (first_s + second_s), first_s + second_s, 0.2)
    assert twice == pytest.approx(once)


def test_force_drop_and_ratios():
    assert drop_interval_s(1e-3, 2.3e-3) == pytest.approx(0.4348, abs=1e-4)
    assert force_drop_N(2.6, 1.2) == pytest.approx(1.4)
    assert force_ratios(1.4, 2.6, 0.0, 2.3e-3) == pytest.approx((1.4 / 2.6, 1.2 / 2.6))
    elastic, _ = force_ratios(1.0, 3.0, 400.0, 2.5e-3)
    assert elastic == pytest.approx(1.0 / 2.0)


@given(number, st.floats(-1.0, 3.0))
def test_ratios_stay_physical_whatever_was_measured(drop, force):
    elastic, friction = force_ratios(drop, force, 100.0, 2e-3)
    assert 0.0 < elastic < 1.0
    assert elastic + friction == pytest.approx(1.0)


def test_reweighting_is_equation_12_and_shares_the_force_by_the_ratios():
    """Collinear columns: RLS from Psi'_0 splits the force as r_K : r_B."""
    speed, share = 2.3e-3, 0.4
    variance = reweighted_friction_variance(1e6, 1 - share, share, speed)
    assert variance == pytest.approx(1e6 * share / (1 - share) / speed**2)
    state = (0.0, 0.0, 1e6, 0.0, variance)
    for depth in np.linspace(1e-4, 0.03, 200):
        state, _ = rls_step(state, (depth, depth * speed), 80.0 * depth, 1.0)
    assert state[1] * speed / 80.0 == pytest.approx(share, rel=1e-3)


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    length=st.integers(1, 120),
    window=st.integers(1, 30),
    ratio=st.floats(0.01, 100.0),
    is_constant=st.booleans(),
)
def test_rerun_from_sums_equals_the_rerun_over_samples(seed, length, window, ratio, is_constant):
    rng = np.random.default_rng(seed)
    speed = np.full(length, 2.3e-3) if is_constant else 2e-3 + 1e-3 * np.sin(np.arange(length) / 9)
    depth = 1e-3 + np.cumsum(speed) * 1e-3
    force = 30.0 * depth + 8000.0 * depth * speed + 0.01 * rng.standard_normal(length)
    variances = (1e6, 1e6 * ratio / 2.3e-3**2)
    state = (0.0, 0.0, variances[0], 0.0, variances[1])
    sums, history = tuple(WindowSums()), NO_WINDOWS
    for k in range(length):
        if k and k % window == 0:
            state = tuple(reset_covariance(RlsState(*state), *variances))
            history = append_window(history, WindowSums(*sums), 4096)
            sums = tuple(WindowSums())
        phi = (depth[k], depth[k] * speed[k])
        state, _ = rls_step(state, phi, force[k], 1.0)
        sums = add_sample(sums, phi, force[k], speed[k])
    history = append_window(history, WindowSums(*sums), 4096)
    scale = np.abs(state[:2]) + np.sqrt(variances) * 1e-6
    gap = np.abs(np.array(rerun_windows(history, variances, (0.0, 0.0))) - state[:2])
    assert np.all(gap < 1e-6 * scale)


def test_sums_follow_a_later_friction():
    rows = [(0.01, 2e-5, 0.5, 2e-3), (0.02, 5e-5, 0.9, 2.5e-3)]
    late = early = tuple(WindowSums())
    for x, y, f, v in rows:
        late = add_sample(late, (x, y), f, v)
        early = add_sample(early, (x, y), f - 100.0 * v, v)
    assert less_viscous_force(WindowSums(*late), 100.0) == pytest.approx(early)


def test_the_published_path_goes_through_all_states():
    assert next_rupture_state(S.NO_RUPTURE, is_expected=True) is S.EXPECTED
    assert next_rupture_state(S.EXPECTED, is_alarm=True, is_expected=True) is S.DETECTED
    assert next_rupture_state(S.DETECTED) is S.FORCE_DROP_MEASURING
    assert next_rupture_state(S.FORCE_DROP_MEASURING) is S.FORCE_DROP_MEASURING
    assert next_rupture_state(S.FORCE_DROP_MEASURING, is_measured=True) is S.FRICTION_IDENTIFIED
    assert next_rupture_state(S.FRICTION_IDENTIFIED) is S.NO_RUPTURE


def test_alarm_alone_is_enough_and_expectation_may_pass():
    assert next_rupture_state(S.NO_RUPTURE, is_alarm=True) is S.DETECTED
    assert next_rupture_state(S.EXPECTED) is S.NO_RUPTURE


def test_no_alarm_interrupts_a_measurement():
    for alarm, expected in product((False, True), repeat=2):
        flags = {"is_alarm": alarm, "is_expected": expected}
        assert next_rupture_state(S.FORCE_DROP_MEASURING, **flags) is S.FORCE_DROP_MEASURING
        assert (
            next_rupture_state(S.FRICTION_IDENTIFIED, is_settled=False, **flags)
            is S.FRICTION_IDENTIFIED
        )


def windows(count, *, noise=1e-4):
    """Windows of a needle at nearly constant speed: columns are nearly collinear."""
    rng = np.random.default_rng(count)
    found = []
    for k in range(count):
        sums = tuple(WindowSums())
        for j in range(25):
            depth = 2.3e-6 * (25 * k + j + 1)
            speed = 2.3e-3 + noise * rng.standard_normal()
            force = 60.0 * depth + 9000.0 * depth * speed + 0.01 * rng.standard_normal()
            sums = add_sample(sums, (depth, depth * speed), force, speed)
        found.append(WindowSums(*sums))
    return tuple(found)


def history_of(found, most=4096):
    history = NO_WINDOWS
    for sums in found:
        history = append_window(history, sums, most)
    return history


@pytest.mark.parametrize("count", [0, 1, 5, 64, 400, 1001])
@pytest.mark.parametrize("friction_variance", [1e6, 1e10, 1e2])
def test_the_rerun_is_that_of_window_by_window(count, friction_variance):
    found = windows(count)
    variances = (1e6, friction_variance)
    ours = rerun_windows(history_of(found), variances, (1.0, 2.0))
    theta = (1.0, 2.0)
    for sums in found:
        theta = window_step(theta, sums, variances)
    assert ours == pytest.approx(theta, rel=1e-6)


def test_friction_is_taken_out_of_every_window():
    found = windows(130)
    expected = np.array([less_viscous_force(sums, 3.0) for sums in found])
    np.testing.assert_allclose(less_viscous_windows(history_of(found), 3.0), expected)
    assert len(less_viscous_windows(NO_WINDOWS, 3.0)) == 0


def test_memory_is_bounded_by_adding_neighbours():
    found = windows(144)
    history = history_of(found, most=128)
    pairs = np.array(found).reshape(72, 2, 7)
    np.testing.assert_allclose(history, pairs.sum(axis=1))
    for sums in found:
        history = append_window(history, sums, 128)
    assert len(history) <= 128 + 16


@pytest.mark.parametrize("count", [0, 1, 5, 6])
def test_adding_neighbours_keeps_their_sum(count):
    rows = np.outer(np.arange(count), np.ones(7))
    halved = add_neighbours(rows)
    assert len(halved) == -(-count // 2)
    np.testing.assert_array_equal(halved.sum(axis=0), rows.sum(axis=0))


def test_an_older_history_stays_what_it_was():
    older = history_of(windows(100))
    before = older.copy()
    append_window(older, windows(1)[0], 4096)
    np.testing.assert_array_equal(older, before)
