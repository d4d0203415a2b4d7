"""The table of advice: what an error says to callers becomes what a user can do."""

import csv
import re
from importlib.resources import files
from pathlib import Path

import pytest

from needleforce.cli.advice import advise, describe_error
from needleforce.recordings.errors import ColumnError
from residual import TareError

ROOT = Path(__file__).parents[3]
PACKAGES = ("groundtruth", "identification", "needleforce", "residual", "urdf")


def joined_strings():
    """All source text of the product, adjacent strings joined."""
    text = "\n".join(
        path.read_text()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if path.name != "advice.py"
    )
    return re.sub(r'"\s*f?"', "", text)


def test_every_row_is_an_advice_that_some_error_gives():
    source = joined_strings()
    table = files("needleforce.cli").joinpath("advice.csv").read_text("utf-8")

    for row in csv.DictReader(table.splitlines()):
        fixed = max(re.split(r"\{\w+\}", row["library"]), key=len)
        assert fixed in source, row["library"]


@pytest.mark.parametrize(
    ("advice", "expected"),
    [
        ("Give `depth_m` in metres.", "Give the unit, as in --depth z:mm"),
        ("Call a friend.", "Call a friend"),
        (
            "Name it under `dq` in the `mapping`: `ColumnMapping(channels=...)`.",
            "Name it with --dq, or under dq in the file of --mapping; --print-config "
            "prints such a file",
        ),
    ],
)
def test_an_advice_of_the_library_names_the_option(advice, expected):
    assert advise(advice) == expected


def test_commands_that_tare_by_themselves_say_what_comes_next():
    error = TareError("the sensor reads 1 N")

    assert "--tare START:END" in describe_error(error)
    assert describe_error(error, is_watching=True) == (
        "the sensor reads 1 N. Keep the needle free; the next attempt follows by itself"
    )


def test_an_error_without_advice_is_its_message():
    assert describe_error(ColumnError("two columns are q")) != ""
