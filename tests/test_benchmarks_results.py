"""Files of results: equal runs give equal bytes, and a bad file is named, never guessed at."""

import json
import math

import pytest
from benchmark_rows import TEMPLATE, make_row

from benchmarks.errors import ResultsError
from benchmarks.rows import read_results, to_json, write_results


def test_rows_survive_the_way_through_a_file(tmp_path):
    rows = [make_row(), make_row(seed=1, value=0.25, method="published")]
    write_results(tmp_path / "a.json", rows)
    assert read_results(tmp_path / "a.json") == rows


def test_the_file_is_json_of_the_published_schema():
    content = json.loads(to_json([make_row()]))
    assert content == {"schema": 1, "rows": [TEMPLATE]}


def test_no_rows_are_valid_json_too():
    assert json.loads(to_json([])) == {"schema": 1, "rows": []}


def test_values_keep_six_digits_only():
    assert json.loads(to_json([make_row(value=1.0 / 3.0)]))["rows"][0]["value"] == 0.333333


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_is_null_and_comes_back_as_nan(tmp_path, value):
    write_results(tmp_path / "a.json", [make_row(value=value)])
    assert json.loads((tmp_path / "a.json").read_text())["rows"][0]["value"] is None
    assert math.isnan(read_results(tmp_path / "a.json")[0].value)


def test_a_whole_number_is_a_number(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"schema": 1, "rows": [TEMPLATE | {"value": 1}]}))
    assert read_results(path)[0].value == 1.0


@pytest.mark.parametrize(
    ("content", "told"),
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
def test_a_bad_file_is_refused_with_the_reason(tmp_path, content, told):
    path = tmp_path / "a.json"
    path.write_text(content)
    with pytest.raises(ResultsError, match=told):
        read_results(path)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ResultsError, match=r"cannot read .*nothing\.json"):
        read_results(tmp_path / "nothing.json")


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(ResultsError, match="cannot write"):
        write_results(tmp_path / "no" / "a.json", [])
