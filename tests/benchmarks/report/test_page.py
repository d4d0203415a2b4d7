"""The report of a run: every figure, the published numbers beside ours, nothing
passed off."""

from itertools import product

import pytest

from benchmarks.cli import main
from benchmarks.jobs import Drawing, Job
from benchmarks.judging import GELS
from benchmarks.report.page import (
    friction_chart,
    gel_friction,
    published_sections,
    write_report,
)
from benchmarks.report.published_figures import PUBLISHED_FIGURES
from benchmarks.report.tables import TABLES, build_table
from benchmarks.results import read_results
from needleforce.plots import PageFigure
from tests.benchmarks.benchmark_cases import by_head, make_row

pytest.importorskip("matplotlib")

NUMBERS = ("2", "3", "5", "8", "9", "10", "I", "11", "12", "13", "14")


def drawing(path, figure="", scenario="gel-70-constant", plant="clean", **more):
    fact = {"": "RMSE [N]", "published": "0.2444", "ours, here": "0.0190"}
    return Drawing(
        figure=figure,
        job=Job(benchmark=scenario, plant=plant),
        shown=PageFigure(path=path, alt="a chart", caption=f"What to see in {figure}."),
        facts=(fact,) if figure == "5" else (),
        **more,
    )


def rows(plant="clean", scenarios=GELS, seeds=(0,)):
    """Friction of gels: true 100, offline 110, online 104, more with the seed."""
    values = {"true": 100.0, "offline": 110.0, "online": 104.0}
    keys = ("scenario", "plant", "seed", "source", "method")
    offsets = {
        "published-one-setting": 0.0,
        "published-as-authors-ran": -2.0,
        "ours": 0.0,
    }
    all_rows = []
    for names in product(scenarios, [plant], seeds, ("ft", "virtual"), offsets):
        key = dict(zip(keys, names, strict=True))
        for kind, value in values.items():
            metric = f"cumulative_friction_{kind}_Ns_per_m"
            value += key["seed"] + offsets[key["method"]]
            all_rows.append(make_row(**key, metric=metric, value=value, unit="Ns/m"))
    return all_rows


@pytest.mark.slow
def test_all_runs_give_all_figures(dot, tmp_path):
    figures = [item for item in PUBLISHED_FIGURES if item.number not in ("10", "I")]
    drawn = [
        drawing(dot, item.number, name) for item in figures for name in item.scenarios
    ]
    page = write_report(tmp_path, rows(), drawn).read_text(encoding="utf-8")
    for number in NUMBERS:
        anchor = f"table-{number}" if number == "I" else f"figure-{number}"
        assert f'<section id="{anchor}">' in page

    assert "Not among these runs" not in page
    assert "0.2444" in page
    assert "534 ± 56" in page


def test_missing_panels_are_named_with_their_command(dot):
    sections = published_sections([drawing(dot, "11"), drawing(dot, "5")], [])
    half, whole = sections

    assert [section.anchor for section in sections] == ["figure-5", "figure-11"]
    assert "stack-glove-constant" in half.notices[0]

    command = (
        "python -m benchmarks run gel-70-constant stack-glove-constant --report DIR"
    )

    assert (half.command, whole.command) == (command, "")


def test_table_one_has_published_numbers_beside_ours(dot):
    gels = gel_friction(rows(seeds=(0, 2)))

    assert gels is not None

    lines = by_head(build_table(TABLES["table I"], gels))
    by_method = {
        (line["scenario"], line["force"], line["method"]): line for line in lines
    }
    first = by_method["gel-25-constant", "ft", "ours"]

    assert first["published offline"] == "113 ± 14"
    assert first["published online"] == "84 ± 10"
    assert first["true"] == "101 (102)"
    assert first["online"] == "105 (106)"
    assert first["published %"] == "-26"

    tuned = by_method["gel-25-constant", "ft", "published-as-authors-ran"]

    assert tuned["online"] == "103 (104)"

    points = {
        curve.label: curve for curve in friction_chart("a", gels).panels[0].curves
    }

    assert list(points["published, offline"].y) == [113.0, 283.0, 534.0]
    assert points["ours, F/T, constant"].y[1] == 105.0


@pytest.mark.slow
def test_the_command_writes_page_drawings_and_numbers(tmp_path, capsys):
    folder = tmp_path / "deep" / "report"
    written = tmp_path / "a.json"
    options = ["--plant", "needle", "--workers", "1", "--json", str(written)]

    assert main(["run", "gel-70-constant", *options, "--report", str(folder)]) == 0
    assert "index.html" in capsys.readouterr().out

    page = (folder / "index.html").read_text(encoding="utf-8")
    for anchor in ("figure-2", "figure-8", "figure-10", "table-I"):
        assert f'<section id="{anchor}">' in page

    assert "<caption>Online identification: ruptures" in page

    # A figure that stands alone is there in a wide form as well.
    narrow = [path for path in folder.glob("*.svg") if not path.stem.endswith("-wide")]

    assert len(narrow) == page.count("<figcaption>")
    assert read_results(folder / "results.json") == read_results(written) != []
