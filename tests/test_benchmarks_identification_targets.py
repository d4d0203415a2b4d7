"""Targets and tables of identification: the figures asked for, and where they are shown."""

import math

import pytest
from benchmark_rows import make_row

from benchmarks.catalogue import BENCHMARKS
from benchmarks.metric_catalogue import (
    BOUNDS,
    IDENTIFICATION,
    METRICS,
    OFFLINE,
    REAL_TISSUE,
    TABLE_I,
)
from benchmarks.tables import (
    bound_table,
    friction_table,
    number_table,
    offline_table,
    rupture_table,
    table_one_table,
    tissue_table,
)
from benchmarks.targets import GELS, IDENTIFICATION_TARGETS, STACKS, Target, verdicts

SHARE = Target(
    what="delay",
    metric="rupture_delay_ms",
    plant="degraded",
    at_most=0.5,
    of_published=True,
    where_paper_tells=True,
)


def delay(**changes):
    return make_row(metric="rupture_delay_ms", unit="ms", **changes)


def test_every_target_names_metrics_and_benchmarks_that_exist():
    for target in IDENTIFICATION_TARGETS:
        assert target.metric in METRICS
        assert set(target.scenarios or ()) <= set(BENCHMARKS)
        assert math.isfinite(target.at_most) or math.isfinite(target.at_least)
    assert (len(GELS), len(STACKS)) == (6, 4)


@pytest.mark.parametrize(
    ("source", "plant", "expected"),
    [
        ("ft", "needle", (5.0, 10.0, 5.0, 40.0, 6.0)),
        ("ft", "clean", (5.0, 10.0, 5.0, 40.0, 6.0)),
        ("virtual", "clean", (10.0, 20.0, 10.0, 80.0, 12.0)),
    ],
)
def test_upper_limits_are_those_asked_for(source, plant, expected):
    """So that nobody eases one unseen."""
    limits = [
        item.at_most
        for item in IDENTIFICATION_TARGETS
        if (item.source, item.plant) == (source, plant)
        and math.isfinite(item.at_most)
        and not item.of_published
        and item.metric != "friction_coverage_online_2sigma"
    ]
    assert tuple(limits) == expected


@pytest.mark.parametrize(
    ("source", "expected"), [("ft", (1.0, 1.0, 0.98, 0.98)), ("virtual", (0.98, 0.98, 0.95, 0.95))]
)
def test_lower_limits_are_those_asked_for(source, expected):
    limits = [
        item.at_least
        for item in IDENTIFICATION_TARGETS
        if (item.source, item.plant) == (source, "clean")
        and item.metric in ("rupture_recall", "rupture_precision")
    ]
    assert tuple(limits) == expected


def test_a_run_in_which_the_papers_method_is_silent_is_not_compared():
    rows = [delay(value=20.0), delay(seed=1, value=30.0), delay(value=50.0, method="published")]
    (verdict,) = verdicts(rows, [SHARE])
    assert (verdict.runs, verdict.value) == (1, pytest.approx(0.4))
    assert verdicts([delay(value=20.0)], [SHARE]) == []


@pytest.mark.parametrize("kind", [*IDENTIFICATION, *BOUNDS, *TABLE_I, *OFFLINE, *REAL_TISSUE])
def test_every_metric_is_shown_in_its_own_table_or_is_a_detail(kind):
    rows = [make_row(metric=kind.name, unit=kind.unit)]
    assert number_table(rows) is None
    tables = (
        friction_table,
        rupture_table,
        bound_table,
        table_one_table,
        offline_table,
        tissue_table,
    )
    shown = [table(rows) for table in tables]
    # Beside the worst layer online, these stand in the results only.
    apart = {
        "friction_error_mean_pct",
        "friction_error_online_mean_pct",
        "friction_coverage_2sigma",
    }
    assert sum(table is not None for table in shown) == (kind.name not in apart)


def test_a_share_shows_its_mean_and_its_least():
    rows = [
        make_row(metric="rupture_recall", unit="1", seed=k, value=value)
        for k, value in enumerate((1.0, 1.0, 0.4))
    ]
    table = rupture_table(rows)
    assert table is not None
    assert list(table.columns[3].cells) == ["0.80 (0.40)"]
