"""The figures of README.md and docs/reference/results.md come from one campaign."""

import math

import pytest

from benchmarks.report.figures import (
    Part,
    RowSpec,
    fill_figures,
    fill_line,
    fill_pages,
    read_figures,
    read_specs,
    summarize_part,
)
from benchmarks.results import METHOD_NAMES, Row

TABLE = read_specs()[0]


def rows_of(metric, values, *, method="ours", plant="fri", scenario="gel-25-constant"):
    """One row a seed."""
    return [
        Row(
            scenario=scenario,
            plant=plant,
            seed=1000 + seed,
            source="virtual",
            method=method,
            metric=metric,
            value=value,
            unit="",
        )
        for seed, value in enumerate(values)
    ]


DELAY = RowSpec(
    what="delay",
    plant="fri",
    parts=(Part("rupture_delay_ms", "median", ".0f", " ms"),),
)


def test_the_pages_show_the_figures_of_the_campaign():
    for page, filled in fill_pages(read_figures()).items():
        assert page.read_text(encoding="utf-8") == filled, page.name


def test_every_column_is_a_method_with_a_name_for_people():
    assert {name for table in read_specs() for name in table.methods} <= set(
        METHOD_NAMES
    )


@pytest.mark.parametrize(
    ("statistic", "value"),
    [("median", 3.0), ("mean", 4.0), ("worst", 9.0), ("deviation", 3.1623)],
)
def test_a_part_is_a_statistic_of_all_runs(statistic, value):
    part = Part("rupture_delay_ms", statistic, ".0f")

    assert summarize_part([3.0, 1.0, 9.0, 4.0, 3.0], part) == pytest.approx(
        value, abs=0.2
    )


def test_one_value_that_is_no_number_leaves_no_figure():
    part = Part("wrench_rmse_N", "median", ".3f")

    assert math.isnan(summarize_part([0.1, math.nan], part))


@pytest.mark.parametrize(("delay_ms", "mark"), [(79.9, "met"), (80.1, "**missed**")])
def test_our_figure_is_judged_by_the_target_of_its_plant(delay_ms, mark):
    line = fill_line(rows_of("rupture_delay_ms", [delay_ms]), TABLE, DELAY)

    assert line == ["delay", "–", "–", f"{delay_ms:.0f} ms", "80 ms", mark]


def test_a_closed_loop_is_judged_on_every_plant_of_the_table():
    spec = RowSpec(
        what="past",
        plant="fri",
        scenarios=("control-autonomous/*-20",),
        parts=(Part("travel_past_rupture_mm", "worst", ".1f", " mm"),),
    )
    rows = rows_of(
        "travel_past_rupture_mm", [0.4, 22.0], scenario="control-autonomous/I-20"
    )

    assert fill_line(rows, TABLE, spec)[-3:] == ["22.0 mm", "1.0 mm", "**missed**"]


def test_what_was_not_measured_is_said():
    line = fill_figures(rows_of("rupture_delay_ms", [70.0]), "abc").tables["headline"]

    assert line[0][-1] == "not measured"
    assert line[2][-1] == "met"
