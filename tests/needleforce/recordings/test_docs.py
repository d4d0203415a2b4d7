"""The page on recordings holds: its examples run, its options are its mapping."""

import doctest
import re
from pathlib import Path

import pytest

from needleforce.recordings import CHANNELS, ColumnMapping, parse_column_spec, read_log

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "recordings.md"
TEXT = PAGE.read_text(encoding="utf-8")
FILES = dict(
    re.findall(r"^```(?:csv|toml)\n# (\S+)\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
)


@pytest.fixture(autouse=True)
def _files_of_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, content in FILES.items():
        # With the name as a comment, so that lines are counted as on the page.
        (tmp_path / name).write_text(f"# {name}\n{content}", encoding="utf-8")


def test_the_sessions_give_what_the_page_shows():
    session = doctest.DocTestParser().get_doctest(TEXT, {}, PAGE.name, str(PAGE), 0)

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
