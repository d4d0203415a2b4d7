"""Targets, and the comparison of two runs."""

import fnmatch
import math

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.catalogue import BENCHMARKS, GROUPS, make_jobs
from benchmarks.judging import (
    FAILURES,
    METRICS,
    TARGETS,
    Target,
    compare_results,
    evaluate,
    expand_groups,
    unit_of,
)
from tests.benchmarks.benchmark_cases import make_results, make_seeds

PUBLISHED = {"method": "published-one-setting"}
VALUES = st.floats(-1e3, 1e3)


def goal(metric="wrench_rmse_N", **limits):
    return Target(what="a goal", metric=metric, plant="degraded", **limits)


def judge(results, target):
    """The one row that a target gets."""
    (row,) = evaluate(results, [target]).to_dict("records")
    return row


def change(old, new, metric="wrench_rmse_N"):
    (found,) = compare_results(
        make_results({"value": old, "metric": metric}),
        make_results({"value": new, "metric": metric}),
    )["change"]
    return found


@pytest.mark.parametrize(
    ("statistic", "value", "is_met"),
    [("worst", 0.87, False), ("mean", 0.95, True), ("median", 0.98, True)],
)
def test_a_statistic_of_all_runs_is_judged(statistic, value, is_met):
    target = goal(
        "wrench_coverage_2sigma", at_least=0.9, at_most=0.99, statistic=statistic
    )
    row = judge(make_seeds((0.87, 0.98, 1.0), metric="wrench_coverage_2sigma"), target)

    assert [row[name] for name in ("value", "met", "runs", "worst")] == [
        pytest.approx(value),
        is_met,
        3,
        "gel-25-constant, seed 0",
    ]


TENTH = {"at_most": 0.12, "statistic": "p90"}


@pytest.mark.parametrize(
    ("values", "limits", "is_met"),
    [
        ((0.12,), {"at_most": 0.12}, True),
        ((0.12,), {"at_least": 0.12}, True),
        ((0.1201,), {"at_most": 0.12}, False),
        ((0.1199,), {"at_least": 0.12}, False),
        ((*[0.1] * 9, 0.3), TENTH, True),
        ((*[0.1] * 8, 0.3, 0.3), TENTH, False),
        ((0.1, 0.3), TENTH, False),
    ],
)
def test_limits_may_be_touched_and_a_tenth_of_the_runs_may_miss(values, limits, is_met):
    assert judge(make_seeds(values), goal(**limits))["met"] == is_met


def test_a_target_looks_at_its_source_scenarios_and_plant_only():
    results = make_results(
        {"scenario": "study/one-S"},
        {"scenario": "study/one-I", "source": "a scan"},
        {"scenario": "study/one-S", "plant": "clean"},
        {"scenario": "study/one-S", "method": "published"},
    )

    some = judge(results, goal(at_most=1.0, source="any", scenarios=("study/*-I",)))
    every = judge(results, goal(at_most=1.0, source="any"))
    found = (judge(results, goal(at_most=1.0))["runs"], every["runs"], some["worst"])

    assert found == (1, 2, "study/one-I, seed 0")
    assert evaluate(results, [goal(scenarios=("tissue",), at_most=1.0)]).empty


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("statistic", ["worst", "mean", "median", "p90"])
def test_a_value_that_is_not_finite_misses_the_target(bad, statistic):
    row = judge(make_seeds((0.1, bad, 0.1)), goal(at_most=0.12, statistic=statistic))

    assert (row["met"], row["worst"]) == (False, "gel-25-constant, seed 1")


def test_precision_without_any_alarm_counts_only_where_there_is_no_other():
    target = goal("rupture_precision", at_least=1.0)
    some = judge(make_seeds((1.0, math.nan), metric="rupture_precision"), target)

    none = make_seeds((math.nan, math.nan), metric="rupture_precision")

    assert (some["runs"], some["met"]) == (1, True)
    assert not judge(none, target)["met"]


def test_ratios_are_to_the_published_value_of_the_same_run():
    target = goal(at_most=0.5, of_published=True)
    results = pd.concat([make_seeds((0.1, 0.1)), make_seeds((0.4, 0.125), **PUBLISHED)])
    row = judge(results, target)
    ours = make_seeds((0.1,))
    zero = pd.concat([ours, make_seeds((0.0,), **PUBLISHED)])

    place = (row["value"], row["worst"])
    assert place == (pytest.approx(0.8), "gel-25-constant, seed 1")
    # One to nothing is missed, or left out where that is allowed.
    assert [bool(judge(one, target)["met"]) for one in (ours, zero)] == [False, False]
    reported = goal(at_most=0.5, of_published=True, where_reported=True)
    assert evaluate(make_seeds((0.1,)), [reported]).empty


def test_every_target_names_metrics_and_benchmarks_that_exist():
    groups = [name for name in GROUPS if name != "recordings"]
    known = {job.scenario for job in make_jobs(groups)} | set(BENCHMARKS)
    for target in TARGETS:
        assert target.metric in METRICS
        assert math.isfinite(target.at_most) or math.isfinite(target.at_least)
        for pattern in expand_groups(target.scenarios):
            assert fnmatch.filter(known, pattern), pattern


@pytest.mark.parametrize(
    ("metric", "unit"),
    [
        ("friction_Ns_per_m", "Ns/m"),
        ("wrench_rmse_N", "N"),
        ("residual_rms_Nm", "Nm"),
        ("delay_ms", "ms"),
        ("rupture_recall", "1"),
    ],
)
def test_a_metric_names_its_unit(metric, unit):
    assert unit_of(metric) == unit


@settings(max_examples=15)
@given(old=VALUES, new=VALUES, metric=st.sampled_from(sorted(METRICS)))
def test_what_is_worse_one_way_is_not_worse_the_other(old, new, metric):
    assert not change(old, new, metric) == change(new, old, metric) == "worse"
    assert change(old, old, metric) == "same"


@pytest.mark.parametrize(
    ("metric", "old", "new", "expected"),
    [
        ("wrench_rmse_N", 0.10, 0.12, "worse"),
        ("wrench_rmse_N", 0.12, 0.10, "better"),
        ("wrench_rmse_N", 0.100, 0.1049, "same"),
        ("wrench_rmse_N", 0.010, 0.0109, "same"),
        ("wrench_bias_N", -0.01, 0.05, "worse"),
        ("wrench_coverage_2sigma", 0.95, 0.80, "worse"),
        ("wrench_coverage_2sigma", 0.95, 1.00, "worse"),
        ("wrench_coverage_2sigma", 0.80, 0.94, "better"),
        ("a metric nobody knows", 1.0, 0.999, "worse"),
        ("a metric nobody knows", 1.0, 1.0, "same"),
        ("wrench_rmse_N", math.nan, 0.1, "better"),
        ("wrench_rmse_N", math.nan, math.nan, "not finite"),
        ("wrench_rmse_N", 0.1, math.inf, "not finite"),
        ("rupture_precision", math.nan, math.nan, "same"),
        ("rupture_precision", math.nan, math.inf, "not finite"),
        ("rupture_precision", 1.0, math.nan, "not finite"),
    ],
)
def test_direction_and_tolerance_are_those_of_the_metric(metric, old, new, expected):
    assert change(old, new, metric) == expected


@pytest.mark.parametrize("field", ["scenario", "plant", "source", "method", "metric"])
def test_a_missing_row_fails_and_a_new_one_passes(field):
    changes = compare_results(make_results({}), make_results({field: "other"}))

    assert sorted(changes["change"]) == ["missing", "new"]
    assert ["missing" in FAILURES, "new" in FAILURES] == [True, False]
