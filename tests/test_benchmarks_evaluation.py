"""Judging numbers: targets, and comparison of two runs."""

import math
import re

import pytest
from benchmark_rows import make_row
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import UnknownMetricError
from benchmarks.catalogue import BENCHMARKS
from benchmarks.targets import Change, compare_rows, evaluate
from benchmarks.rows import METRICS, metric
from benchmarks.targets import GELS, STACKS, TARGETS, TISSUE, Target

LIMIT = Target(what="force", metric="wrench_rmse_N", plant="degraded", at_most=0.12)
RATIO = Target(
    what="ratio", metric="wrench_rmse_N", plant="degraded", at_most=0.5, of_published=True
)
DELAY = Target(
    what="delay",
    metric="rupture_delay_ms",
    plant="degraded",
    at_most=0.5,
    of_published=True,
    where_reported=True,
)
VALUES = st.floats(-1e3, 1e3)


def only(rows, target):
    (found,) = evaluate(rows, [target])
    return found


def seeds(values, **changes):
    return [make_row(seed=k, value=value, **changes) for k, value in enumerate(values)]


# Targets.


def test_the_worst_run_decides():
    found = only(seeds((0.1, 0.2, 0.11)), LIMIT)
    assert (found.value, found.worst.seed, found.runs) == (0.2, 1, 3)
    assert not found.is_met


def test_a_limit_may_be_touched():
    assert only([make_row(value=0.12)], LIMIT).is_met


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("statistic", ["worst", "mean", "median"])
def test_one_value_that_is_not_finite_misses_the_target(bad, statistic):
    target = Target(
        what="force", metric="wrench_rmse_N", plant="degraded", at_most=0.12, statistic=statistic
    )
    assert not only(seeds((0.1, bad, 0.1)), target).is_met


@pytest.mark.parametrize(("statistic", "expected"), [("mean", 0.95), ("median", 0.98)])
def test_a_statistic_of_all_runs_can_be_judged(statistic, expected):
    target = Target(
        what="coverage",
        metric="wrench_coverage_2sigma",
        plant="degraded",
        at_least=0.9,
        at_most=0.99,
        statistic=statistic,
    )
    found = only(seeds((0.87, 0.98, 1.0), metric="wrench_coverage_2sigma"), target)
    assert found.value == pytest.approx(expected)
    assert found.is_met
    assert found.worst.seed == 0


def test_undefined_precision_does_not_count_unless_nothing_was_ever_detected():
    target = Target(what="precision", metric="rupture_precision", plant="degraded", at_least=1.0)
    some = only(seeds((1.0, math.nan), metric="rupture_precision"), target)
    assert (some.runs, some.is_met) == (1, True)
    assert not only(seeds((math.nan, math.nan), metric="rupture_precision"), target).is_met


def test_a_ratio_is_to_the_published_value_of_the_same_run():
    rows = [*seeds((0.1, 0.1)), *seeds((0.4, 0.125), method="published")]
    found = only(rows, RATIO)
    assert found.value == pytest.approx(0.8)
    assert found.worst.seed == 1


@pytest.mark.parametrize("published", [[], [make_row(value=0.0, method="published")]])
def test_a_ratio_to_nothing_is_missed(published):
    assert not only([make_row(), *published], RATIO).is_met


def test_a_run_in_which_the_published_method_reports_nothing_can_be_left_out():
    rows = seeds((20.0, 30.0), metric="rupture_delay_ms")
    rows += seeds((50.0,), metric="rupture_delay_ms", method="published")
    found = only(rows, DELAY)
    assert (found.runs, found.value) == (1, pytest.approx(0.4))
    assert evaluate(rows[:1], [DELAY]) == []


@pytest.mark.parametrize(
    "other",
    [{"plant": "clean"}, {"source": "ft"}, {"method": "published"}, {"metric": "wrench_bias_N"}],
)
def test_rows_of_other_kinds_are_not_judged(other):
    assert evaluate([make_row(**other)], [LIMIT]) == []


def test_every_target_names_metrics_and_benchmarks_that_exist():
    assert len(TARGETS) == 56
    for target in TARGETS:
        assert target.metric in METRICS
        assert set(target.scenarios) <= set(BENCHMARKS)
        assert math.isfinite(target.at_most) or math.isfinite(target.at_least)
    assert (len(GELS), len(STACKS)) == (6, 4)
    assert "free-motion" not in TISSUE


def limits(side, source, plant):
    """Limits of plain targets on one source and plant, in order."""
    return [
        getattr(item, side)
        for item in TARGETS
        if (item.source, item.plant) == (source, plant)
        and math.isfinite(getattr(item, side))
        and not item.of_published
        and not item.metric.startswith("wrench_")
        and "coverage" not in item.metric
    ]


def test_the_limits_of_the_force_are_those_asked_for():
    """So that nobody eases one unseen."""
    plain = {
        (item.metric, item.plant): (item.at_most, item.statistic)
        for item in TARGETS
        if item.metric.startswith(("wrench_", "residual_rms_Nm")) and not item.of_published
    }
    assert plain == {
        ("residual_rms_Nm", "ideal"): (1e-4, "worst"),
        ("wrench_rmse_N", "clean"): (0.05, "worst"),
        ("wrench_coverage_2sigma", "clean"): (0.99, "mean"),
        ("wrench_rmse_N", "degraded"): (0.12, "worst"),
    }
    assert {item.at_most for item in TARGETS if item.of_published} == {0.5}
    joints = [item.at_most for item in TARGETS if item.metric.startswith("residual_rms_J")]
    assert joints == pytest.approx([0.38, 0.77, 0.38, 0.40, 0.15, 0.11, 0.07])


@pytest.mark.parametrize(
    ("source", "plant", "most", "least"),
    [
        ("ft", "needle", [5.0, 10.0, 5.0, 40.0, 6.0], [1.0, 1.0, 0.98, 0.98]),
        ("ft", "clean", [5.0, 10.0, 5.0, 40.0, 6.0], [1.0, 1.0, 0.98, 0.98]),
        ("virtual", "clean", [10.0, 20.0, 10.0, 80.0, 12.0], [0.98, 0.98, 0.95, 0.95]),
        ("ft", "recording", [14.0, 42.0, 8.0, 25.0, 0.0, 0.0, 1.0], []),
    ],
)
def test_the_limits_of_identification_are_those_asked_for(source, plant, most, least):
    assert limits("at_most", source, plant) == most
    assert limits("at_least", source, plant) == least


# Comparison of two runs.


def change(old, new, name="wrench_rmse_N"):
    (found,) = compare_rows([make_row(value=old, metric=name)], [make_row(value=new, metric=name)])
    return found.change


@given(value=VALUES, name=st.sampled_from(sorted(METRICS)))
def test_equal_values_are_the_same(value, name):
    assert change(value, value, name) is Change.SAME


@given(old=VALUES, new=VALUES, name=st.sampled_from(sorted(METRICS)))
def test_what_is_worse_one_way_is_not_worse_the_other(old, new, name):
    assert not change(old, new, name) is change(new, old, name) is Change.WORSE


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("wrench_rmse_N", 0.10, 0.12, Change.WORSE),
        ("wrench_rmse_N", 0.12, 0.10, Change.BETTER),
        ("wrench_rmse_N", 0.100, 0.101, Change.SAME),
        ("wrench_bias_N", -0.01, 0.05, Change.WORSE),
        ("wrench_bias_N", 0.05, -0.01, Change.BETTER),
        ("wrench_coverage_2sigma", 0.95, 0.80, Change.WORSE),
        ("wrench_coverage_2sigma", 0.95, 1.00, Change.WORSE),
        ("wrench_coverage_2sigma", 0.80, 0.94, Change.BETTER),
        ("a metric nobody knows", 1.0, 1.0, Change.SAME),
        ("a metric nobody knows", 1.0, 0.999, Change.WORSE),
        ("wrench_rmse_N", math.nan, 0.1, Change.BETTER),
        ("rupture_precision", math.nan, math.nan, Change.SAME),
        ("rupture_precision", math.nan, math.inf, Change.NOT_FINITE),
        ("rupture_precision", 1.0, math.nan, Change.NOT_FINITE),
    ],
)
def test_direction_and_tolerance_are_those_of_the_metric(name, old, new, expected):
    assert change(old, new, name) is expected


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("old", [0.1, math.nan, math.inf, None])
def test_a_value_that_is_not_finite_fails_whatever_it_was_before(old, bad):
    before = [] if old is None else [make_row(value=old)]
    (found,) = compare_rows(before, [make_row(value=bad)])
    assert found.change is Change.NOT_FINITE
    assert found.is_failure


def test_a_missing_row_fails_and_a_new_one_does_not():
    gone, come = compare_rows([make_row(seed=0)], [make_row(seed=1)])
    assert (gone.change, gone.is_failure) == (Change.MISSING, True)
    assert (come.change, come.is_failure) == (Change.NEW, False)


@pytest.mark.parametrize("field", ["scenario", "plant", "source", "method", "metric"])
def test_rows_are_matched_by_everything_that_names_them(field):
    found = compare_rows([make_row()], [make_row(**{field: "other"})])
    assert [item.change for item in found] == [Change.MISSING, Change.NEW]


# Metrics.


def test_an_unknown_metric_is_refused_with_the_known_ones():
    with pytest.raises(UnknownMetricError, match="no metric 'x'; known: wrench_rmse_N"):
        metric("x")


def test_a_metric_has_the_unit_that_its_name_ends_with():
    units = {
        "wrench_rmse_N": "N",
        "wrench_lag_ms": "ms",
        "detection_depth_error_mm": "mm",
        "residual_rms_J1_Nm": "Nm",
        "weight_error_pct": "%",
        "cumulative_friction_true_Ns_per_m": "Ns/m",
        "rupture_recall": "1",
        "wrench_coverage_2sigma": "1",
    }
    assert {name: metric(name).unit for name in units} == units
    bare = [item.name for item in METRICS.values() if item.unit == "1"]
    assert [name for name in bare if re.search(r"_(N|Nm|Ns|s|ms|m|mm|pct|hz)(_|$)", name)] == []


def test_tolerances_are_those_of_the_catalogue():
    """A number shown for reference may double; a recall may not fall at all."""
    assert metric("friction_bound_pct").relative_tolerance == 1.0
    assert (metric("rupture_recall").tolerance, metric("rupture_recall").best) == (1e-3, 1.0)
    assert metric("wrench_rmse_N").tolerance == 1e-3
    assert metric("force_up_loaded_N").best == -27.5
