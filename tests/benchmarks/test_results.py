"""Results: files, tables, pages, targets, and comparison of two runs."""

import fnmatch
import itertools
import json
import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import ResultsError
from benchmarks.catalogue import BENCHMARKS, Request, make_plan
from benchmarks.cli import main
from benchmarks.judging import (
    GELS,
    GROUPS,
    METRICS,
    TARGETS,
    TISSUE,
    Change,
    Target,
    compare_rows,
    evaluate,
    metric,
)
from benchmarks.report.tables import (
    TABLES,
    ResultTable,
    build_table,
    frame_of,
    new_console,
    result_tables,
    target_table,
)
from benchmarks.results import read_merged, read_results, to_json, write_results
from tests.benchmarks.benchmark_cases import TEMPLATE, by_head, make_row


def test_rows_survive_a_file_of_the_documented_schema(tmp_path):
    rows = [make_row(), make_row(seed=1, value=0.25, method="published-one-setting")]
    write_results(tmp_path / "a.json", rows)

    assert read_results(tmp_path / "a.json") == rows
    assert json.loads(to_json([make_row()])) == {"schema": 1, "rows": [TEMPLATE]}
    assert (
        json.loads(to_json([make_row(value=1.0 / 3.0)]))["rows"][0]["value"] == 0.333333
    )

    (tmp_path / "a.json").write_text(
        json.dumps({"schema": 1, "rows": [TEMPLATE | {"value": 1}]})
    )

    assert read_results(tmp_path / "a.json")[0].value == 1.0

    for value in (math.nan, math.inf, -math.inf):
        write_results(tmp_path / "a.json", [make_row(value=value)])
        assert json.loads((tmp_path / "a.json").read_text())["rows"][0]["value"] is None
        assert math.isnan(read_results(tmp_path / "a.json")[0].value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is not JSON"),
        ('{"schema": 2, "rows": []}', "is not a file of results: Invalid enum value 2"),
        (
            json.dumps({"schema": 1, "rows": [{"scenario": "a"}]}),
            "missing required field `plant`",
        ),
        (
            json.dumps({"schema": 1, "rows": [TEMPLATE | {"value": "1"}]}),
            "got `str` - at .*value",
        ),
        (json.dumps({"schema": 1, "rows": [TEMPLATE, TEMPLATE]}), "more than one row"),
    ],
)
def test_a_bad_or_unreachable_file_is_named(tmp_path, content, message):
    path = tmp_path / "a.json"
    path.write_text(content)

    with pytest.raises(ResultsError, match=message):
        read_results(path)
    with pytest.raises(ResultsError, match=r"cannot read .*nothing\.json"):
        read_results(tmp_path / "nothing.json")
    with pytest.raises(ResultsError, match="cannot write"):
        write_results(tmp_path / "no" / "a.json", [])


def test_the_last_run_of_scenario_and_plant_counts(tmp_path):
    first = [make_row(), make_row(plant="clean"), make_row(scenario="liver-constant")]
    more = [
        make_row(plant="clean", value=0.02),
        make_row(plant="clean", value=0.04, seed=1),
    ]
    write_results(tmp_path / "first.json", first)
    write_results(tmp_path / "more.json", more)
    merged = read_merged([tmp_path / "first.json", tmp_path / "more.json"])

    assert merged == [first[0], *more, first[2]]


def table_of(name, rows):
    return build_table(TABLES[name], frame_of(rows))


@pytest.mark.slow
def test_every_metric_is_shown_in_its_table_only():
    rows = {
        k: make_row(metric=k.name, unit=k.unit, plant="needle", scenario=k.name)
        for k in METRICS.values()
    }

    assert {kind.table for kind in rows} <= {*TABLES, "none"}

    for name in TABLES:
        others = [row for kind, row in rows.items() if kind.table != name]
        assert not table_of(name, others).lines
        mine = [row for kind, row in rows.items() if kind.table == name]
        # A line for each scenario, where the table has such.
        has_all = len(table_of(name, mine).lines) == len(mine)
        assert has_all or all(table_of(name, [row]).lines for row in mine)


def test_fractions_show_mean_and_least_or_a_dash():
    def cell(column, name, *values):
        rows = [
            make_row(metric=name, unit="1", seed=k, value=v)
            for k, v in enumerate(values)
        ]
        (line,) = by_head(table_of("ruptures", rows))
        return line[column]

    assert cell("recall", "rupture_recall", 1.0, 1.0, 0.4) == "0.80 [0.40, 1.00] (0.40)"
    assert cell("precision", "rupture_precision", math.nan) == "–"
    assert cell("precision", "rupture_precision", math.nan, 0.5) == "0.50"
    assert result_tables([]) == []


def test_the_force_table_shows_missed_targets_first():
    rows = [
        make_row(scenario="gel-70-constant", plant="clean", value=0.02),
        make_row(
            scenario="gel-70-constant",
            plant="clean",
            value=0.1,
            method="published-one-setting",
        ),
        make_row(scenario="stack-constant", plant="clean", value=math.nan),
        make_row(scenario="free-motion", plant="clean", value=0.01),
    ]
    bad, good, without_target = by_head(table_of("force", rows))

    assert bad["scenario"] == "stack-constant"
    assert bad["ours RMSE, N"] == "not finite"
    assert bad["target"] == "missed"
    assert good["scenario"] == "gel-70-constant"
    assert good["plant"] == "clean"
    assert good["F/T RMSE, N"] == "–"
    assert good["one setting RMSE, N"] == "0.100"
    assert good["best gain RMSE, N"] == "–"
    assert good["ours RMSE, N"] == "0.020"
    assert good["ours / one setting"] == "0.20"
    assert good["ours / best gain"] == "–"
    assert good["real arm N"] == "0.2444"
    assert good["target"] == "met"
    assert without_target["target"] == "–"

    with (console := new_console()).capture() as printed:
        console.print(table_of("force", rows).rich())

    assert "median [its 95 % interval" in " ".join(printed.get().split())

    rows = [make_row(value=0.11), make_row(value=0.12, method="published-one-setting")]
    marks = [line["mark of runs"] for line in by_head(target_table(rows))]

    assert marks == ["missed", "met"]


def clean_rows():
    return [
        make_row(plant="clean", value=0.012),
        make_row(plant="clean", value=0.151, method="published-one-setting"),
        make_row(plant="clean", value=0.08, method="published-best-gain"),
        make_row(plant="clean", value=0.03, seed=1),
        make_row(plant="degraded", value=0.3),
        make_row(plant="fri", metric="rupture_recall", unit="1", value=0.4),
    ]


def test_the_command_writes_the_page(tmp_path, capsys):
    write_results(tmp_path / "a.json", clean_rows())
    page = tmp_path / "results.md"
    paths = ["--page", str(page)]

    assert main(["results", str(tmp_path / "a.json"), "--page", str(page)]) == 0
    assert "missed" not in capsys.readouterr().out
    assert "missed" not in page.read_text(encoding="utf-8")
    assert main(["results", str(tmp_path / "a.json"), *paths, "--targets"]) == 0

    printed = capsys.readouterr().out

    assert "joint torques, rms: 0.030 N, by the published method" in printed
    assert "0.021 [0.012, 0.030]" in printed

    text = page.read_text(encoding="utf-8")

    assert "python -m benchmarks results a.json" in text
    assert str(tmp_path) not in text

    titles = [line[3:] for line in text.splitlines() if line.startswith("## ")]
    force = "Axial force against ground truth"
    ruptures = "Online identification: ruptures"

    assert titles == ["Targets", force, ruptures]
    assert text.index("**missed**") < text.index("| met |")

    none = str(tmp_path / "no" / "p.md")

    assert main(["results", str(tmp_path / "a.json"), "--page", none]) == 2
    assert capsys.readouterr().err.startswith("error: cannot write")
    assert main(["results"]) == 2


def goal(metric="wrench_rmse_N", **limits):
    return Target(what="a goal", metric=metric, plant="degraded", **limits)


LIMIT = goal(at_most=0.12)
RATIO = goal(at_most=0.5, of_published=True)
DELAY = goal("rupture_delay_ms", at_most=0.5, of_published=True, where_reported=True)
VALUES = st.floats(-1e3, 1e3)


def only(rows, target):
    (evaluation,) = evaluate(rows, [target])
    return evaluation


def seeds(values, **changes):
    return [make_row(seed=k, value=value, **changes) for k, value in enumerate(values)]


def test_the_statistic_decides_and_limits_may_be_touched():
    evaluation = only(seeds((0.1, 0.2, 0.11)), LIMIT)

    assert (evaluation.value, evaluation.worst.seed, evaluation.runs) == (0.2, 1, 3)
    assert not evaluation.is_met
    assert only([make_row(value=0.12)], LIMIT).is_met

    name = "wrench_coverage_2sigma"
    for statistic, expected in (("mean", 0.95), ("median", 0.98)):
        target = goal(name, at_least=0.9, at_most=0.99, statistic=statistic)
        evaluation = only(seeds((0.87, 0.98, 1.0), metric=name), target)
        assert evaluation.value == pytest.approx(expected)
        assert evaluation.is_met
        assert evaluation.worst.seed == 0


def test_the_worst_tenth_of_the_runs_may_miss():
    target = goal(at_most=0.12, statistic="p90")

    assert only(seeds((*[0.1] * 9, 0.3)), target).is_met
    assert not only(seeds((*[0.1] * 8, 0.3, 0.3)), target).is_met
    assert not only(seeds((*[0.1] * 8, 0.3)), target).is_met


def test_a_target_of_any_source_judges_them_all():
    rows = [make_row(value=0.1), make_row(value=0.2, source="a scan")]

    assert only(rows, goal(source="any", at_most=0.12)).runs == 2
    assert only(rows, goal(at_most=0.12)).runs == 1


def test_a_pattern_names_scenarios():
    rows = [make_row(scenario=name) for name in ("study/one-S", "study/one-I")]
    target = goal(scenarios=("study/*-S",), at_most=1.0)

    assert only(rows, target).worst.scenario == "study/one-S"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("statistic", ["worst", "mean", "median", "p90"])
def test_a_value_not_finite_misses_the_target(bad, statistic):
    target = goal(at_most=0.12, statistic=statistic)
    assert not only(seeds((0.1, bad, 0.1)), target).is_met


def test_undefined_precision_counts_only_without_any_alarm():
    target = goal("rupture_precision", at_least=1.0)
    some = only(seeds((1.0, math.nan), metric="rupture_precision"), target)

    assert (some.runs, some.is_met) == (1, True)
    assert not only(
        seeds((math.nan, math.nan), metric="rupture_precision"), target
    ).is_met


def test_ratios_are_to_the_same_runs_published_value():
    rows = [*seeds((0.1, 0.1)), *seeds((0.4, 0.125), method="published-one-setting")]
    evaluation = only(rows, RATIO)

    assert evaluation.value == pytest.approx(0.8)
    assert evaluation.worst.seed == 1

    # One to nothing is missed, or left out where the published method reports nothing.
    for published in ([], [make_row(value=0.0, method="published-one-setting")]):
        assert not only([make_row(), *published], RATIO).is_met
    rows = seeds((20.0, 30.0), metric="rupture_delay_ms")
    rows += seeds((50.0,), metric="rupture_delay_ms", method="published-one-setting")
    evaluation = only(rows, DELAY)

    assert (evaluation.runs, evaluation.value) == (1, pytest.approx(0.4))
    assert evaluate(rows[:1], [DELAY]) == []


def test_every_target_names_metrics_and_benchmarks_that_exist():
    ids = ("control", "anatomy", "faults", "faults-guard")
    studied = {job.scenario for job in make_plan(Request(ids=ids)).jobs}
    known = {*BENCHMARKS, *studied}
    for target in TARGETS:
        assert target.metric in METRICS
        for pattern in target.scenarios:
            assert any(fnmatch.fnmatchcase(name, pattern) for name in known), pattern
        assert math.isfinite(target.at_most) or math.isfinite(target.at_least)

    assert (len(GELS), len(GROUPS["stacks"])) == (6, 4)
    assert "free-motion" not in TISSUE


def test_the_limits_are_those_asked_for():
    limits = {
        "ft": [5.0, 10.0, 5.0, 40.0, 6.0],
        "virtual": [10.0, 20.0, 10.0, 80.0, 12.0],
    }
    further = {"ft": [40.0, 12.0], "virtual": [80.0, 18.0]}
    plants = {"clean": limits, "fri": further, "degraded": further}
    for plant, source in itertools.product(plants, limits):
        assert plants[plant][source] == [
            item.at_most
            for item in TARGETS
            if (item.source, item.plant) == (source, plant)
            and METRICS[item.metric].table not in ("control", "warnings")
            and math.isfinite(item.at_most)
            and not (
                item.of_published
                or "wrench" in item.metric
                or "coverage" in item.metric
            )
        ]
    plain = {
        (item.metric, item.plant, item.statistic): item.at_most
        for item in TARGETS
        if item.metric.startswith(("wrench_", "residual_rms_Nm"))
        and not item.of_published
    }

    assert plain == {
        ("residual_rms_Nm", "ideal", "worst"): 1e-4,
        ("wrench_rmse_N", "clean", "worst"): 0.05,
        ("wrench_coverage_2sigma", "clean", "mean"): 0.99,
        ("wrench_rmse_N", "fri", "median"): 0.06,
        ("wrench_rmse_N", "fri", "worst"): 0.1,
        ("wrench_coverage_2sigma", "fri", "mean"): 0.99,
        ("wrench_rmse_N", "degraded", "worst"): 0.12,
    }
    assert {item.at_most for item in TARGETS if item.of_published} == {0.5}

    joints = [
        item.at_most for item in TARGETS if item.metric.startswith("residual_rms_J")
    ]

    assert joints == pytest.approx([0.38, 0.77, 0.38, 0.40, 0.15, 0.11, 0.07])


def change(old, new, name="wrench_rmse_N"):
    (comparison,) = compare_rows(
        [make_row(value=old, metric=name)], [make_row(value=new, metric=name)]
    )
    return comparison.change


@given(old=VALUES, new=VALUES, name=st.sampled_from(sorted(METRICS)))
def test_worse_one_way_is_not_worse_the_other(old, new, name):
    assert not change(old, new, name) is change(new, old, name) is Change.WORSE
    assert change(old, old, name) is Change.SAME


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("wrench_rmse_N", 0.10, 0.12, Change.WORSE),
        ("wrench_rmse_N", 0.12, 0.10, Change.BETTER),
        ("wrench_rmse_N", 0.100, 0.101, Change.SAME),
        ("wrench_bias_N", -0.01, 0.05, Change.WORSE),
        ("wrench_coverage_2sigma", 0.95, 0.80, Change.WORSE),
        ("wrench_coverage_2sigma", 0.95, 1.00, Change.WORSE),
        ("wrench_coverage_2sigma", 0.80, 0.94, Change.BETTER),
        ("a metric nobody knows", 1.0, 0.999, Change.WORSE),
        ("wrench_rmse_N", math.nan, 0.1, Change.BETTER),
        ("rupture_precision", math.nan, math.nan, Change.SAME),
        ("rupture_precision", math.nan, math.inf, Change.NOT_FINITE),
        ("rupture_precision", 1.0, math.nan, Change.NOT_FINITE),
    ],
)
def test_direction_and_tolerance_are_those_of_the_metric(name, old, new, expected):
    assert change(old, new, name) is expected


def test_a_missing_row_fails_a_new_passes():
    gone, come = compare_rows([make_row(seed=0)], [make_row(seed=1)])

    assert (gone.change, gone.is_failure) == (Change.MISSING, True)
    assert (come.change, come.is_failure) == (Change.NEW, False)

    for field in ("scenario", "plant", "source", "method", "metric"):
        changes = compare_rows([make_row()], [make_row(**{field: "other"})])
        assert [item.change for item in changes] == [Change.MISSING, Change.NEW]


def test_a_metric_has_its_names_unit_and_tolerance():
    bare = [item.name for item in METRICS.values() if item.unit == "1"]

    assert [
        name for name in bare if re.search(r"_(N|Nm|Ns|s|ms|m|mm|pct|hz)(_|$)", name)
    ] == []
    assert metric("friction_bound_pct").relative_tolerance == 1.0
    assert (metric("rupture_recall").tolerance, metric("rupture_recall").best) == (
        1e-3,
        1.0,
    )
    assert (metric("wrench_rmse_N").tolerance, metric("force_up_loaded_N").best) == (
        1e-3,
        -27.5,
    )


def test_a_table_without_targets_loses_their_columns_and_caption_only():
    table = ResultTable(
        title="a",
        heads=("what", "ratio", "target", "mean", ""),
        align="LrLrL",
        lines=(("x", "1", "≤ 2 met", "3", "y"),),
        caption="Plain.",
        target_caption="Missed first.",
    )
    plain = table.choose_targets(are_shown=False)

    assert plain.heads == ("what", "ratio", "mean", "")
    assert plain.align == "LrrL"
    assert plain.lines == (("x", "1", "3", "y"),)
    assert plain.caption == "Plain."

    full = table.choose_targets(are_shown=True)

    assert full.lines == table.lines
    assert full.caption == "Plain. Missed first."
