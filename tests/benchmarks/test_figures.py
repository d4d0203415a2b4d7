"""The figures of README.md and docs/reference/results.md come from one campaign."""

import json
import math

import pandas as pd
import pytest

from benchmarks.figures import (
    STORED,
    Part,
    RowSpec,
    fill_figures,
    fill_line,
    fill_pages,
    read_specs,
    summarize_part,
)
from tests.benchmarks.benchmark_cases import make_seeds

TABLE = read_specs()[0]
DELAY = RowSpec(
    what="delay",
    plant="fri",
    parts=(Part("rupture_delay_ms", "median", ".0f", " ms"),),
)


def delays(*values, **changes):
    return make_seeds(values, plant="fri", metric="rupture_delay_ms", **changes)


def test_the_pages_show_the_figures_of_the_campaign():
    figures = json.loads(STORED.read_bytes())
    for page, filled in fill_pages(figures).items():
        assert page.read_text(encoding="utf-8") == filled, page.name


@pytest.mark.parametrize(
    ("statistic", "value"),
    [("median", 3.0), ("mean", 4.0), ("worst", 9.0), ("deviation", 3.0), ("sum", 20.0)],
)
def test_a_part_is_a_statistic_of_all_runs(statistic, value):
    part = Part("rupture_delay_ms", statistic, ".0f")
    values = pd.Series([3.0, 1.0, 9.0, 4.0, 3.0])

    assert summarize_part(values, part) == pytest.approx(value)
    assert math.isnan(summarize_part(pd.Series([0.1, math.nan]), part))


BOTH = RowSpec(
    what="both",
    plant="fri",
    parts=(*DELAY.parts, Part("rupture_recall", "mean", ".0f", " %", 100.0)),
)
HALF = make_seeds((0.5,), plant="fri", metric="rupture_recall")
PAST = RowSpec(
    what="past",
    plant="fri",
    scenarios=("control-autonomous/*-20",),
    parts=(Part("travel_past_rupture_mm", "worst", ".1f", " mm"),),
)
TRAVELS = make_seeds(
    (0.4, 22.0),
    plant="fri",
    metric="travel_past_rupture_mm",
    scenario="control-autonomous/I-20",
)


@pytest.mark.parametrize(
    ("results", "spec", "line"),
    [
        (delays(79.9), DELAY, ["delay", "–", "–", "80 ms", "80 ms", "met"]),
        (delays(80.1), DELAY, ["delay", "–", "–", "80 ms", "80 ms", "**missed**"]),
        # Of two parts, the one that is missed is named.
        (
            pd.concat([delays(70.0), HALF]),
            BOTH,
            ["70 ms; 50 %", "80 ms; 97 %", "**missed** (second)"],
        ),
        # A closed loop is judged on every plant of the table.
        (TRAVELS, PAST, ["22.0 mm", "1.0 mm", "**missed**"]),
    ],
)
def test_our_figure_is_judged_by_the_target_of_its_plant(results, spec, line):
    assert fill_line(results, TABLE, spec)[-len(line) :] == line


def test_what_was_not_measured_is_said():
    figures = fill_figures(delays(70.0, 72.0), "abc")
    lines = figures["tables"]["headline"]
    said = (lines[0][-1], lines[2][-1], figures["runs"])

    assert said == ("not measured", "met", {"fri": 2})
