"""Windows kept as arrays: the same re-run as window by window."""

import numpy as np
import pytest

from identification.published_update import add_sample
from identification.rls_windows import (
    WindowHistory,
    WindowSums,
    add_neighbours,
    append_window,
    follow_windows,
    less_viscous_force,
    less_viscous_rows,
    rerun_history,
    solve_windows,
    window_rows,
    window_step,
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
    history = WindowHistory()
    for sums in found:
        history = append_window(history, sums, most)
    return history


@pytest.mark.parametrize("count", [0, 1, 5, 64, 400, 1001])
@pytest.mark.parametrize("friction_variance", [1e6, 1e10, 1e2])
def test_the_rerun_is_that_of_window_by_window(count, friction_variance):
    found = windows(count)
    variances = (1e6, friction_variance)
    ours = rerun_history(history_of(found), variances, (1.0, 2.0))
    theta = (1.0, 2.0)
    for sums in found:
        theta = window_step(theta, sums, variances)
    assert ours == pytest.approx(theta, rel=1e-6)


@pytest.mark.parametrize("count", [0, 1, 400])
def test_the_windows_may_be_followed_one_by_one_or_solved_at_once(count):
    columns = np.ascontiguousarray(window_rows(history_of(windows(count))).T)
    for function in (follow_windows, getattr(follow_windows, "py_func", follow_windows)):
        one_by_one = function(columns, (1e6, 1e10), (1.0, 2.0))
        assert one_by_one == pytest.approx(
            solve_windows(columns, (1e6, 1e10), (1.0, 2.0)), rel=1e-9
        )


def test_friction_is_taken_out_of_every_window():
    found = windows(130)
    expected = np.array([less_viscous_force(sums, 3.0) for sums in found])
    np.testing.assert_allclose(window_rows(less_viscous_rows(history_of(found), 3.0)), expected)
    assert less_viscous_rows(WindowHistory(), 3.0) == WindowHistory()


def test_memory_is_bounded_by_adding_neighbours():
    found = windows(144)
    history = history_of(found, most=128)
    pairs = np.array(found).reshape(72, 2, 7)
    np.testing.assert_allclose(window_rows(history), pairs.sum(axis=1))
    for sums in found:
        history = append_window(history, sums, 128)
    assert len(window_rows(history)) <= 128 + 16


@pytest.mark.parametrize("count", [0, 1, 5, 6])
def test_adding_neighbours_keeps_their_sum(count):
    rows = np.outer(np.arange(count), np.ones(7))
    halved = add_neighbours(rows)
    assert len(halved) == -(-count // 2)
    np.testing.assert_array_equal(halved.sum(axis=0), rows.sum(axis=0))


def test_an_older_history_stays_what_it_was():
    older = history_of(windows(100))
    before = window_rows(older)
    append_window(older, windows(1)[0], 4096)
    np.testing.assert_array_equal(window_rows(older), before)
