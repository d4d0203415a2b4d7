"""Cost of updates: subjects take turns, neighbours are compared."""

from itertools import groupby

import numpy as np
import pytest

from benchmarks.performance import ticks


def timing(*medians):
    return np.repeat([medians], 3, axis=0).T


TIMES = {
    "dynamics of the sensor": timing(2.0, 2.0),
    "sensor": timing(5.2, 5.2),
    "chain": np.array([[10.0, 11.0, 80.0], [10.0, 40.0, 10.0]]),
}


def numbers(figures):
    return {item.metric: item.value for item in figures}


def test_ratios_compare_neighbours():
    # A slow machine cancels.
    ratio = ticks.cost_ratio(timing(2.0, 20.0, 2.0), timing(1.0, 10.0, 1.0))
    found = numbers(ticks.describe_ticks("sensor", TIMES["sensor"], TIMES))

    assert (ratio, found["tick_ratio"]) == pytest.approx((2.0, 2.6))


def test_subjects_take_turns_and_what_warms_them_up_does_not_count():
    asked = []
    subjects = {
        name: lambda k, name=name: asked.append((name, k)) for name in ("a", "b")
    }
    times = ticks.time_side_by_side(subjects, 3, 450)

    assert [
        (name, len(list(run))) for name, run in groupby(asked, lambda pair: pair[0])
    ] == [("a", 3), ("b", 3), ("a", 200), ("b", 200), ("a", 200), ("b", 200)]
    assert [k for name, k in asked if name == "a"] == list(range(403))
    assert times["a"].shape == (2, 200)
