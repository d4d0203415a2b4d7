"""Comparison of two runs: what is worse, missing or not a number is found, and nothing else."""

import math
import re

import pytest
from benchmark_rows import make_row
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.comparison import Change, compare_rows
from benchmarks.errors import UnknownMetricError
from benchmarks.metric_catalogue import METRICS, metric

VALUES = st.floats(-1e3, 1e3)


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
    ],
)
def test_direction_and_tolerance_are_those_of_the_metric(name, old, new, expected):
    assert change(old, new, name) is expected


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("old", [0.1, math.nan, math.inf])
def test_a_value_that_is_not_finite_fails_whatever_it_was_before(old, bad):
    (found,) = compare_rows([make_row(value=old)], [make_row(value=bad)])
    assert found.change is Change.NOT_FINITE
    assert found.is_failure


def test_a_value_that_has_become_finite_is_better():
    assert change(math.nan, 0.1) is Change.BETTER


def test_a_missing_row_fails_and_a_new_one_does_not():
    gone, come = compare_rows([make_row(seed=0)], [make_row(seed=1)])
    assert (gone.change, gone.is_failure) == (Change.MISSING, True)
    assert (come.change, come.is_failure) == (Change.NEW, False)


def test_a_new_row_that_is_not_finite_fails():
    (found,) = compare_rows([], [make_row(value=math.nan)])
    assert found.is_failure


@pytest.mark.parametrize("field", ["scenario", "plant", "source", "method", "metric"])
def test_rows_are_matched_by_everything_that_names_them(field):
    found = compare_rows([make_row()], [make_row(**{field: "other"})])
    assert [item.change for item in found] == [Change.MISSING, Change.NEW]


def test_an_unknown_metric_is_refused_with_the_known_ones():
    with pytest.raises(UnknownMetricError, match="no metric 'x'; known: wrench_rmse_N"):
        metric("x")


def test_a_metric_has_the_unit_that_its_name_ends_with():
    units = {
        "wrench_rmse_N": "N",
        "wrench_lag_ms": "ms",
        "rupture_overshoot_mm": "mm",
        "residual_rms_J1_Nm": "Nm",
        "weight_error_pct": "%",
        "cumulative_friction_true_Ns_per_m": "Ns/m",
        "rupture_recall": "1",
        "wrench_coverage_2sigma": "1",
    }
    assert {name: metric(name).unit for name in units} == units
    bare = [item.name for item in METRICS.values() if item.unit == "1"]
    assert [name for name in bare if re.search(r"_(N|Nm|Ns|s|ms|m|mm|pct|hz)(_|$)", name)] == []
