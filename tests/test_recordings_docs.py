"""The page on recordings says what the code does: its examples run, its tables are the code's."""

import re
import shlex
from argparse import ArgumentParser
from pathlib import Path

import pytest
from page_sessions import session_failures

from needleforce import recordings
from needleforce.recordings import CHANNELS, load_mapping, mapping_arguments, mapping_from_arguments, read_log
from recordings.read_log import _READERS
from needleforce.recordings.csv_file import HEAD_ROWS

PAGE = Path(__file__).parents[1] / "docs" / "recordings.md"
TEXT = PAGE.read_text(encoding="utf-8")
FILES = dict(re.findall(r"^```(?:csv|toml)\n# (\S+)\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE))


@pytest.fixture(autouse=True)
def _files_of_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, content in FILES.items():
        # With the name as a comment, so that lines are counted as on the page.
        (tmp_path / name).write_text(f"# {name}\n{content}", encoding="utf-8")


def test_the_page_has_the_files_it_speaks_of():
    assert set(FILES) == {"insertion.csv", "robot.csv", "robot.toml", "broken.csv"}


def test_the_sessions_give_what_the_page_shows():
    assert session_failures(PAGE) == ""


def test_the_command_line_gives_the_mapping_that_the_page_describes():
    (line,) = re.findall(r"^python -m identification (.*)$", TEXT, re.MULTILINE)
    parser = ArgumentParser()
    parser.add_argument("log")
    mapping_arguments(parser, ["depth", "speed", "force"])
    arguments = parser.parse_args(shlex.split(line))
    log = read_log(arguments.log, mapping_from_arguments(arguments), required=["depth", "force"])
    assert log["force_N"].tolist() == [2.5, 2.5]
    assert log["depth_m"].tolist() == [0.09, 0.09]
    assert log.t_s[0] == 0.001


def test_the_patterns_named_beside_the_mapping_mean_the_same():
    toml = Path("robot.toml").read_text(encoding="utf-8")
    expected = read_log("robot.csv", load_mapping("robot.toml"))["q_rad"].tolist()
    for other in ('"axis*"', '["axis1", "axis2"]', '"axis"'):
        Path("other.toml").write_text(toml.replace('"axis{1..2}"', other), encoding="utf-8")
        assert read_log("robot.csv", load_mapping("other.toml"))["q_rad"].tolist() == expected


def test_the_table_of_names_and_units_is_the_codes():
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| (.*) \| (.*) \|$", TEXT, re.MULTILINE)
    written = {
        name: (key, tuple(re.findall("`(.*?)`", names)), tuple(re.findall("`(.*?)`", units)))
        for name, key, names, units in rows
    }
    assert written == {
        name: (channel.key, channel.spellings, tuple(channel.units))
        for name, channel in CHANNELS.items()
    }


def test_every_suffix_and_error_named_is_the_codes():
    formats = TEXT.split("## Formats")[1].split("\n\n")[1]
    assert set(re.findall(r"`(\.[\w.]+)`", formats)) == set(_READERS)
    for name in set(re.findall(r"`(\w+Error)`", TEXT)):
        assert issubclass(getattr(recordings, name), recordings.RecordingError)


def test_the_table_of_faults_holds_for_a_header_alone():
    Path("header.csv").write_text("t,f\n", encoding="utf-8")
    with pytest.raises(recordings.FormatError):
        read_log("header.csv")


def test_so_many_rows_decide_as_the_page_says():
    assert f"decided from the first {HEAD_ROWS} rows" in TEXT
