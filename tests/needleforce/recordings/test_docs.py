"""The page on recordings holds: its examples run."""

import doctest
import re
from pathlib import Path

import pytest

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
