"""What an insertion tells of the pull-out force: regressions judged on what they have not seen."""

import numpy as np
import pytest

from benchmarks.benchmark import Job
from benchmarks.metrics import METRICS
from benchmarks.recorded.liver_limit import (
    REGRESSIONS,
    Seen,
    gaussian_process,
    left_out,
    level,
    linear,
    liver_features,
    regression_values,
    ridge,
    run_liver_limit,
)

RNG = np.random.default_rng(5)
GROUP = np.repeat(np.arange(20), 2)
FEATURES = RNG.standard_normal((40, 3))


@pytest.mark.parametrize("fit", [linear, ridge, gaussian_process])
def test_a_law_is_learned_and_holds_for_what_was_not_seen(fit):
    target = 2.0 + FEATURES @ [1.0, -0.5, 0.0]
    assert left_out(fit, Seen(FEATURES, target, GROUP)) == pytest.approx(target, abs=0.1)


@pytest.mark.parametrize("fit", [ridge, gaussian_process])
def test_where_there_is_nothing_to_learn_the_mean_is_told(fit):
    features, target = RNG.standard_normal((40, 20)), RNG.standard_normal(40)
    found = left_out(fit, Seen(features, target, GROUP))
    assert np.sqrt(np.mean((found - target) ** 2)) < 1.25 * np.std(target)


def test_a_penalty_is_chosen_without_seeing_the_twin_of_a_row():
    """Rows in pairs: learning a pair by heart foretells its other row, and no other pair."""
    features = np.repeat(RNG.standard_normal((15, 14)), 2, axis=0)
    target = np.repeat(RNG.standard_normal(15), 2)
    seen = Seen(features, target, np.repeat(np.arange(15), 2))
    alone = seen._replace(group=np.arange(30))
    asked = RNG.standard_normal((50, 14))
    assert np.std(ridge(seen, asked)) < 0.5 * np.std(ridge(alone, asked))


def test_a_bent_law_needs_the_process():
    target = np.sin(2.0 * FEATURES[:, 0])
    errors = [
        float(np.std(left_out(fit, Seen(FEATURES[:, :1], target, GROUP)) - target))
        for fit in (linear, gaussian_process)
    ]
    assert errors[1] < 0.5 * errors[0]


def test_a_level_is_that_of_the_same_first_feature_and_nobody_is_seen():
    features = np.array([[1.0], [2.0], [1.0], [2.0], [1.0], [2.0]])
    target = np.array([1.0, 10.0, 2.0, 20.0, 9.0, 90.0])
    found = left_out(level, Seen(features, target, np.repeat(np.arange(3), 2)))
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


# Numbers of the recording alone, to which no identifier contributes: they do not change.
PINNED = {
    "pullout_left_out_depth_median_pct": 10.299,
    "pullout_left_out_depth_p90_pct": 29.983,
    "pullout_left_out_force_median_pct": 10.640,
    "pullout_left_out_few_median_pct": 11.431,
    "pullout_above_insertion_share": 0.3684,
    "pullout_over_insertion_most": 1.3248,
    "pullout_shallower_peak_median_pct": 25.08,
    "pullout_neighbour_median_pct": 16.865,
}


def test_the_study_gives_the_same_numbers_again(recordings_dir):
    """Better regressions are welcome: only what no method can change is held fast."""
    job = Job(benchmark="liver-limit", plant="recording", data=recordings_dir)
    found = {
        item.metric: item.value for item in run_liver_limit(job, lambda share: None).measurements
    }
    assert set(found) <= set(METRICS)
    assert {name: found[name] for name in PINNED} == pytest.approx(PINNED, rel=2e-3)
