"""The figures of the paper: drawn by the runs, and set on a page."""

import re

from benchmarks.report import PUBLISHED, published_number, table_one, write_report
from tests.benchmarks.benchmark_cases import make_results


def test_a_drawing_has_the_number_of_its_figure():
    drawings = [
        *((source, "gel-70-constant") for source in ("force", "ft", "virtual")),
        ("ft", "stack-constant"),
    ]
    assert [published_number(*drawing) for drawing in drawings] == ["5", "8", "11", ""]
    assert {item["number"] for item in PUBLISHED} >= {"2", "3", "10", "14", "I"}


def gels():
    rows = [
        {"scenario": f"gel-{percent}-{speed}", "source": "ft", "plant": "clean"}
        | {"metric": "cumulative_friction_online_Ns_per_m", "value": value}
        for percent, values in {25: (80.0, 90.0), 70: (480.0, 500.0)}.items()
        for speed, value in zip(("constant", "sinusoidal"), values, strict=True)
    ]
    return make_results(*rows)


def test_table_one_has_published_numbers_beside_ours():
    table = table_one(gels()).reset_index().set_index("scenario")

    places = (("25", "mean"), ("70", "std"))
    published = (("25", "published online"), ("70", "published offline_spread"))
    found = [table.at[place] for place in (*places, *published)]
    assert found == [85.0, 14.0, 84, 56]


def test_the_page_shows_what_was_drawn(tmp_path):
    (tmp_path / "figure-8-a.svg").write_text("")
    write_report(tmp_path, gels())
    page = (tmp_path / "index.html").read_text(encoding="utf-8")

    assert re.findall(r"<h2>Figure (\w+)", page) == ["8", "10", "I"]
    assert "figure-8-a.svg" in page
