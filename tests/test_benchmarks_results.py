"""Files, tables and pages of results: equal runs give equal bytes, a bad file is named."""

import json
import math

import pytest
from benchmark_rows import TEMPLATE, make_row

from benchmarks import ResultsError
from benchmarks.cli import main
from benchmarks.rows import METRICS
from benchmarks.results_page import BEGIN, END, HEADLINES, fill, summary_block, summary_table
from benchmarks.rows import read_merged, read_results, to_json, write_results
from benchmarks.tables import TABLES, result_tables, target_table


def test_rows_survive_the_way_through_a_file(tmp_path):
    rows = [make_row(), make_row(seed=1, value=0.25, method="published")]
    write_results(tmp_path / "a.json", rows)
    assert read_results(tmp_path / "a.json") == rows


def test_the_file_is_json_of_the_documented_schema():
    content = json.loads(to_json([make_row()]))
    assert content == {"schema": 1, "rows": [TEMPLATE]}
    assert json.loads(to_json([])) == {"schema": 1, "rows": []}
    assert json.loads(to_json([make_row(value=1.0 / 3.0)]))["rows"][0]["value"] == 0.333333


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_is_null_and_comes_back_as_nan(tmp_path, value):
    write_results(tmp_path / "a.json", [make_row(value=value)])
    assert json.loads((tmp_path / "a.json").read_text())["rows"][0]["value"] is None
    assert math.isnan(read_results(tmp_path / "a.json")[0].value)


def written(path, *changes):
    """A file whose rows differ from the template as said, without going through `Row`."""
    rows = [TEMPLATE | each for each in changes]
    path.write_text(json.dumps({"schema": 1, "rows": rows}))
    return path


def test_a_whole_number_is_a_number(tmp_path):
    assert read_results(written(tmp_path / "a.json", {"value": 1}))[0].value == 1.0


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is not JSON"),
        ('{"schema": 1, "rows": [', "is not JSON"),
        ("[]", "is not a file of results"),
        ('{"schema": 2, "rows": []}', "is not a file of results"),
        ('{"schema": 1}', "no list"),
        ('{"schema": 1, "rows": [7]}', "row 1: expected the fields scenario, plant"),
        (json.dumps({"schema": 1, "rows": [{"scenario": "a"}]}), "expected the fields"),
        (json.dumps({"schema": 1, "rows": [TEMPLATE | {"more": 1}]}), "expected the fields"),
        (json.dumps({"schema": 1, "rows": [TEMPLATE | {"value": "1"}]}), "value is '1'"),
        (json.dumps({"schema": 1, "rows": [TEMPLATE | {"value": True}]}), "value is True"),
        (json.dumps({"schema": 1, "rows": [TEMPLATE | {"seed": 0.5}]}), "seed is 0.5"),
        (json.dumps({"schema": 1, "rows": [TEMPLATE | {"plant": 3}]}), "plant is 3"),
        (json.dumps({"schema": 1, "rows": [TEMPLATE, TEMPLATE]}), "more than one row"),
    ],
)
def test_a_bad_file_is_refused_with_the_reason(tmp_path, content, message):
    path = tmp_path / "a.json"
    path.write_text(content)
    with pytest.raises(ResultsError, match=message):
        read_results(path)


def test_a_file_that_cannot_be_read_or_written_is_named(tmp_path):
    with pytest.raises(ResultsError, match=r"cannot read .*nothing\.json"):
        read_results(tmp_path / "nothing.json")
    with pytest.raises(ResultsError, match="cannot write"):
        write_results(tmp_path / "no" / "a.json", [])


@pytest.mark.parametrize(
    ("field", "old", "today"),
    [
        ("plant", "textbook", "ideal"),
        ("plant", "realistic", "clean"),
        ("plant", "hard", "degraded"),
        ("plant", "needle", "needle"),
        ("method", "paper", "published"),
        ("method", "paper-kv", "published-kv"),
    ],
)
def test_names_of_older_files_become_those_of_today(tmp_path, field, old, today):
    (row,) = read_results(written(tmp_path / "a.json", {field: old}))
    assert getattr(row, field) == today


@pytest.mark.parametrize(
    ("recall", "soft", "is_undefined"),
    [
        (0.0, None, True),
        (0.0, 0.0, True),
        (0.0, 0.5, False),
        (1.0, None, False),
        (None, 1.0, False),
    ],
)
def test_an_older_precision_without_any_alarm_is_undefined(tmp_path, recall, soft, is_undefined):
    rows = [{"metric": "rupture_precision", "value": 1.0}]
    for name, value in (("rupture_recall", recall), ("soft_transition_recall", soft)):
        if value is not None:
            rows.append({"metric": name, "value": value})
    found = read_results(written(tmp_path / "a.json", *rows))
    assert math.isnan(found[0].value) == is_undefined


def test_of_several_runs_the_last_one_of_a_scenario_and_a_plant_counts(tmp_path):
    first = [make_row(), make_row(plant="clean"), make_row(scenario="liver-constant")]
    more = [make_row(plant="clean", value=0.02), make_row(plant="clean", value=0.04, seed=1)]
    write_results(tmp_path / "first.json", first)
    write_results(tmp_path / "more.json", more)
    found = read_merged([tmp_path / "first.json", tmp_path / "more.json"])
    assert found == [first[0], *more, first[2]]


# Tables.


@pytest.mark.parametrize("kind", METRICS.values(), ids=METRICS)
def test_every_metric_is_shown_in_its_own_table_or_stands_in_the_results_only(kind):
    rows = [make_row(metric=kind.name, unit=kind.unit, plant="needle", source="virtual")]
    shown = [name for name, make in TABLES.items() if make(rows).lines]
    assert shown == ([] if kind.table == "none" else [kind.table])


def test_fractions_show_their_mean_and_their_least():
    rows = [
        make_row(metric="rupture_recall", unit="1", seed=k, value=value)
        for k, value in enumerate((1.0, 1.0, 0.4))
    ]
    assert TABLES["ruptures"](rows).lines[0][4] == "0.80 (0.40)"


def test_precision_is_a_dash_where_nothing_was_detected():
    def precision(*values):
        rows = [
            make_row(metric="rupture_precision", unit="1", seed=k, value=value)
            for k, value in enumerate(values)
        ]
        return TABLES["ruptures"](rows).lines[0][5]

    assert precision(math.nan) == "–"
    assert precision(math.nan, 0.5) == "0.50"


def test_the_force_table_shows_ratio_published_figure_and_targets_the_missed_first():
    rows = [
        make_row(scenario="gel-70-constant", plant="clean", value=0.02),
        make_row(scenario="gel-70-constant", plant="clean", value=0.1, method="published"),
        make_row(scenario="stack-constant", plant="clean", value=math.nan),
        make_row(scenario="free-motion", plant="clean", value=0.01),
    ]
    bad, *good = TABLES["force"](rows).lines
    assert (bad[0], bad[4], bad[-1]) == ("stack-constant", "not finite", "missed")
    assert good[0][:7] == ("gel-70-constant", "clean", "–", "0.100", "0.020", "0.20", "0.2444")
    assert [line[-1] for line in good] == ["met", "–"]


def test_missed_targets_come_first_in_the_table_of_targets():
    rows = [make_row(value=0.11), make_row(value=0.12, method="published")]
    assert [line[4] for line in target_table(rows).lines] == ["missed", "met"]


def test_rows_without_numbers_give_no_table():
    assert result_tables([]) == []


# Pages.


def clean_rows():
    return [
        make_row(plant="clean", value=0.012),
        make_row(plant="clean", value=0.151, method="published"),
        make_row(plant="clean", value=0.03, seed=1),
        make_row(plant="degraded", value=0.3),
        make_row(plant="clean", metric="rupture_precision", unit="1", value=math.nan),
    ]


def test_the_summary_has_at_most_eight_lines_the_bad_ones_first():
    assert len(HEADLINES) <= 8
    table = summary_table(clean_rows())
    precision, degraded, force = table.lines
    assert precision == ("alarms that are true, fraction", "tissue, clean", "–", "–", "1", "missed")
    assert degraded == (
        "axial force, rms error, N",
        "tissue, degraded",
        "–",
        "0.300",
        "1",
        "missed",
    )
    assert force[1:] == ("tissue, clean", "0.151", "0.021 (0.030)", "2", "met")


def test_the_command_writes_the_page_and_the_readme(tmp_path, capsys):
    write_results(tmp_path / "a.json", clean_rows())
    page, readme = tmp_path / "results.md", tmp_path / "README.md"
    readme.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    paths = ["--page", str(page), "--readme", str(readme)]
    assert main(["results", str(tmp_path / "a.json"), *paths]) == 0
    assert "0.021 (0.030)" in capsys.readouterr().out
    block = summary_block(read_results(tmp_path / "a.json"), "python -m benchmarks results a.json")
    assert readme.read_text(encoding="utf-8") == f"before\n{BEGIN}\n{block}{END}\nafter\n"
    assert "python -m benchmarks results a.json" in block
    text = page.read_text(encoding="utf-8")
    assert str(tmp_path) not in text
    titles = [line[3:] for line in text.splitlines() if line.startswith("## ")]
    assert titles == [
        "Targets",
        "Axial force against the true one",
        "Online identification: ruptures",
    ]
    assert text.index("**missed**") < text.index("| met |")


@pytest.mark.parametrize("text", ["none", f"{END} {BEGIN}", f"{BEGIN} {END} {BEGIN}", BEGIN])
def test_a_page_without_its_marks_is_refused_and_stays(text, tmp_path, capsys):
    with pytest.raises(ResultsError, match="results:begin"):
        fill(text, "block")
    write_results(tmp_path / "a.json", [make_row()])
    page = tmp_path / "page.md"
    page.write_text(text, encoding="utf-8")
    assert main(["results", str(tmp_path / "a.json"), "--readme", str(page)]) == 2
    assert "results:begin" in capsys.readouterr().err
    assert page.read_text(encoding="utf-8") == text


def test_a_page_that_cannot_be_written_is_one_line(tmp_path, capsys):
    write_results(tmp_path / "a.json", [make_row()])
    assert main(["results", str(tmp_path / "a.json"), "--page", str(tmp_path / "no" / "p.md")]) == 2
    assert capsys.readouterr().err.startswith("error: cannot read or write")
    assert main(["results"]) == 2
