"""What an insertion tells of the pull-out force: regressions judged on what they have not seen."""

import numpy as np
import pytest

from benchmarks.job import Job
from benchmarks.liver_features import liver_features
from benchmarks.liver_limit import REGRESSIONS, regression_values, run_liver_limit
from benchmarks.metric_catalogue import METRICS
from benchmarks.regression import gaussian_process, left_out, level, linear, ridge

RNG = np.random.default_rng(5)
GROUP = np.repeat(np.arange(20), 2)
FEATURES = RNG.standard_normal((40, 3))


@pytest.mark.parametrize("fit", [linear, ridge, gaussian_process])
def test_a_law_is_learned_and_holds_for_what_was_not_seen(fit):
    target = 2.0 + FEATURES @ [1.0, -0.5, 0.0]
    assert left_out(fit, FEATURES, target, GROUP) == pytest.approx(target, abs=0.1)


@pytest.mark.parametrize("fit", [ridge, gaussian_process])
def test_where_there_is_nothing_to_learn_the_mean_is_told(fit):
    features, target = RNG.standard_normal((40, 20)), RNG.standard_normal(40)
    found = left_out(fit, features, target, GROUP)
    assert np.sqrt(np.mean((found - target) ** 2)) < 1.25 * np.std(target)


def test_a_bent_law_needs_the_process():
    target = np.sin(2.0 * FEATURES[:, 0])
    errors = [
        float(np.std(left_out(fit, FEATURES[:, :1], target, GROUP) - target))
        for fit in (linear, gaussian_process)
    ]
    assert errors[1] < 0.5 * errors[0]


def test_a_level_is_that_of_the_same_first_feature_and_nobody_is_seen():
    features = np.array([[1.0], [2.0], [1.0], [2.0], [1.0], [2.0]])
    target = np.array([1.0, 10.0, 2.0, 20.0, 9.0, 90.0])
    found = left_out(level, features, target, np.repeat(np.arange(3), 2))
    assert found.tolist() == [5.5, 55.0, 5.0, 50.0, 1.5, 15.0]


def test_features_look_no_deeper_than_asked():
    depth = np.linspace(0.0, 0.08, 16_001)
    force = 20.0 * depth + 0.1
    fallen = force - np.where(depth > 0.05, 0.4, 0.0)
    one, two = (liver_features(depth, each, 0.042, 0.5) for each in (force, fallen))
    assert one == two
    assert np.exp(one["force"]) == pytest.approx(0.94, abs=1e-3)
    assert one["usual slope"] == pytest.approx(20.0, rel=1e-6)
    deep = liver_features(depth, fallen, 0.07, 0.5)
    assert deep["falls"] == 1.0
    assert deep["fallen"] == pytest.approx(0.4, abs=0.05)


def test_every_regression_is_judged():
    names = {name for _, wanted in REGRESSIONS.values() for name in wanted}
    features = [
        {name: float(value) for name, value in zip(sorted(names), row, strict=False)}
        for row in RNG.standard_normal((12, len(names)))
    ]
    for k, row in enumerate(features):
        row["depth"] = (0.042, 0.078)[k % 2]
    values = regression_values(features, [0.8, 1.0] * 6)
    assert len(values) == 2 * len(REGRESSIONS)
    assert values["pullout_left_out_depth_median_pct"] == pytest.approx(0.0, abs=1e-9)


def test_no_regression_reaches_the_aim_and_the_yardstick_contradicts_itself(recordings_dir):
    """The argument of docs/limits.md."""
    job = Job(benchmark="liver-limit", plant="recording", data=recordings_dir)
    found = {
        item.metric: item.value for item in run_liver_limit(job, lambda share: None).measurements
    }
    assert set(found) <= set(METRICS)
    medians = [value for name, value in found.items() if "left_out" in name and "median" in name]
    assert min(medians) > 9.0
    assert (
        min(value for name, value in found.items() if "left_out" in name and "p90" in name) > 25.0
    )
    # Knowing nothing of the insertion is as good in the median as knowing all of it.
    assert found["pullout_left_out_depth_median_pct"] < 1.05 * min(medians)
    assert found["pullout_above_insertion_share"] > 0.3
    assert found["pullout_over_insertion_most"] > 1.3
    assert found["pullout_shallower_peak_median_pct"] > 20.0
