"""The pages on recordings and bags hold: their examples run, their tables are the
code's."""

import doctest
import re
from pathlib import Path

import numpy as np
import pytest

from needleforce import recordings
from needleforce.recordings import CHANNELS, ColumnMapping, read_log
from needleforce.recordings.bags.message_types import standard_types
from needleforce.recordings.bags.written_topics import bag_topics
from needleforce.recordings.csv_file import CSV_SUFFIXES
from needleforce.recordings.mapping import parse_column_spec
from needleforce.recordings.table import HEAD_ROWS, TableLabels

DOCS = Path(__file__).parents[3] / "docs"
PAGES = [DOCS / "reference" / "recordings.md", DOCS / "how-to" / "bags.md"]
TEXT = PAGES[0].read_text(encoding="utf-8")
BAGS = PAGES[1].read_text(encoding="utf-8")
FILES = dict(
    re.findall(r"^```(?:csv|toml)\n# (\S+)\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
)


@pytest.fixture(autouse=True)
def _files_of_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, content in FILES.items():
        # With the name as a comment, so that lines are counted as on the page.
        (tmp_path / name).write_text(f"# {name}\n{content}", encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_sessions_give_what_the_pages_show(page):
    text = page.read_text(encoding="utf-8")
    session = doctest.DocTestParser().get_doctest(text, {}, page.name, str(page), 0)

    assert len(session.examples) > 5

    differences = []
    doctest.DocTestRunner(verbose=False).run(session, out=differences.append)

    assert "".join(differences) == ""


def test_the_pages_options_equal_its_mapping():
    (line,) = re.findall(r"^needleforce identify robot.csv (.*)$", TEXT, re.MULTILINE)
    options = re.findall(r"--(\w+) (\S+)", line)
    specs = {name: parse_column_spec(text, CHANNELS[name]) for name, text in options}
    log = read_log(
        "robot.csv", ColumnMapping(channels=specs), required=["depth", "force"]
    )

    assert log["force_N"].tolist() == [2.5, 2.5]
    assert log["depth_m"].tolist() == [0.09, 0.09]
    assert log.t_s[0] == 0.001


def test_the_pages_names_and_units_are_complete():
    rows = re.findall(
        r"^\| `(\w+)` \| `(\w+)` \| (.*?) \| (.*?) \|$", TEXT, re.MULTILINE
    )
    written = {
        name: (
            key,
            tuple(re.findall("`(.*?)`", names)),
            tuple(re.findall("`(.*?)`", units)),
        )
        for name, key, names, units in rows
    }

    assert written == {
        name: (channel.key, channel.spellings, tuple(channel.units))
        for name, channel in CHANNELS.items()
    }


def test_every_suffix_and_error_named_is_the_codes():
    formats = TEXT.split("## Formats")[1].split("\n\n")[1]
    suffixes = set(re.findall(r"`(\.[\w.]+)`", formats))

    assert suffixes == {*CSV_SUFFIXES, ".npz", ".parquet", ".feather"}

    for name in set(re.findall(r"`(\w+Error)`", TEXT + BAGS)):
        assert issubclass(getattr(recordings, name), recordings.RecordingError)

    assert f"decided from the first {HEAD_ROWS} rows" in TEXT


def test_the_table_of_topics_is_the_codes():
    rows = np.zeros(1)
    columns = {
        "t_s": rows,
        **dict.fromkeys(("q_rad", "dq_rad_s", "tau_Nm"), np.zeros((1, 7))),
        **dict.fromkeys(("ft_force_N", "ft_torque_Nm"), np.zeros((1, 3))),
        **{f"force_{xyz}_in_base_N": rows for xyz in "xyz"},
        **{f"torque_{xyz}_in_base_Nm": rows for xyz in "xyz"},
        "axial_N": rows,
    }
    table = BAGS.split("## What is written")[1].split("## When")[0]
    for name, kind, _ in bag_topics(columns, TableLabels(), [0]):
        (row,) = [line for line in table.splitlines() if f"| `{name}`" in line]
        assert f"`{kind.replace('/msg', '')}`" in row

    for kind in re.findall(r"`(\w+_msgs/\w+)`", BAGS):
        package, name = kind.split("/")
        assert f"{package}/msg/{name}" in standard_types().types
