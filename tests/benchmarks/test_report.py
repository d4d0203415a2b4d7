"""The figures of the paper: drawn by the runs, and set on a page."""

import re

from benchmarks.report import published_number, write_report
from tests.benchmarks.benchmark_cases import make_results


def test_a_drawing_has_the_number_of_its_figure():
    drawings = [
        *((source, "gel-70-constant") for source in ("force", "ft", "virtual")),
        ("ft", "stack-constant"),
    ]
    assert [published_number(*drawing) for drawing in drawings] == ["5", "8", "11", ""]


def test_the_page_shows_what_was_drawn(tmp_path):
    (tmp_path / "figure-8-a.svg").write_text("")
    write_report(tmp_path, make_results({}))
    page = (tmp_path / "index.html").read_text(encoding="utf-8")

    assert re.findall(r"<h2>Figure (\w+)", page) == ["8"]
    assert "figure-8-a.svg" in page
