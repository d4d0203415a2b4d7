"""The report of a run: every figure, the published numbers beside ours, nothing passed off."""

import json
import re

import pytest
from chromium import DESK, PHONE, logged, measured, needs_chromium, printed

from benchmarks.benchmark import Drawing, Fact, Job
from benchmarks.cli import main
from benchmarks.published_figures import ENHANCED_FIGURES, NEEDED, PUBLISHED_FIGURES
from benchmarks.report import (
    chosen,
    friction_chart,
    further_sections,
    gel_friction,
    gel_table,
    missing_section,
    page_table,
    published_sections,
    write_report,
)
from benchmarks.rows import Row
from benchmarks.tables import ResultTable
from benchmarks.targets import GELS, TABLE_ONE_Ns_per_m
from groundtruth import SCENARIOS
from needleforce.plots import PageFigure

pytest.importorskip("matplotlib")

DOT = b'<svg xmlns="http://www.w3.org/2000/svg" width="90" height="90"><circle r="40"/></svg>'
NUMBERS = ("2", "3", "5", "8", "9", "10", "I", "11", "12", "13", "14")


@pytest.fixture
def dot(tmp_path):
    path = tmp_path / "dot.svg"
    path.write_bytes(DOT)
    return path


def drawing(path, figure="", scenario="gel-70-constant", plant="clean", **more):
    fact = Fact(what="RMSE [N]", published="0.2444", here=(("ours, here", "0.0190"),))
    return Drawing(
        figure=figure,
        job=Job(benchmark=scenario, plant=plant),
        shown=PageFigure(path=path, alt="a chart", caption=f"What to see in {figure}."),
        facts=(fact,) if figure == "5" else (),
        **more,
    )


def test_the_page_says_where_to_look_and_not_what_a_run_will_have_found():
    for item in PUBLISHED_FIGURES:
        assert not re.search(r"\d+ ms|late by|not detected|follows the reading", item.see), item


def rows(plant="clean", scenarios=GELS, seeds=(0,)):
    """Friction of gels: true 100, offline 110, online 104, more with the seed."""
    values = {"true": 100.0, "offline": 110.0, "online": 104.0}
    return [
        Row(
            scenario=scenario,
            plant=plant,
            seed=seed,
            source=source,
            method=method,
            metric=f"cumulative_friction_{kind}_Ns_per_m",
            value=value + seed + off,
            unit="Ns/m",
        )
        for scenario in scenarios
        for seed in seeds
        for source in ("ft", "virtual")
        for method, off in (("published", 0.0), ("published-as-run", -2.0), ("default", 0.0))
        for kind, value in values.items()
    ]


def everything(path):
    """A drawing of every figure from every run that it needs."""
    return [
        drawing(path, item.number, scenario)
        for item in PUBLISHED_FIGURES
        if item.number not in ("10", "I")
        for scenario in item.scenarios
    ]


def test_the_figures_are_the_published_ones_and_their_runs_exist():
    assert tuple(item.number for item in PUBLISHED_FIGURES) == NUMBERS
    assert set(NEEDED) <= set(SCENARIOS)
    for (scenario, _), item in ENHANCED_FIGURES.items():
        assert item.scenarios == (scenario,)
        assert item.ruptures
        assert item.remaining


def test_all_runs_give_all_figures_and_nothing_is_missing(dot, tmp_path):
    page = write_report(tmp_path, rows(), everything(dot)).read_text(encoding="utf-8")
    for number in NUMBERS:
        anchor = f"table-{number}" if number == "I" else f"figure-{number}"
        assert f'<section id="{anchor}">' in page
    assert 'id="missing"' not in page
    assert "Not among these runs" not in page
    assert "0.2444" in page
    assert "534 ± 56" in page


def test_what_is_missing_stands_there_with_the_command_that_draws_it(dot):
    sections = published_sections([drawing(dot, "11"), drawing(dot, "5")], [])
    half, whole = sections
    assert [section.anchor for section in sections] == ["figure-5", "figure-11"]
    assert "stack-glove-constant" in half.notices[0]
    command = "python -m benchmarks run gel-70-constant stack-glove-constant --report DIR"
    assert (half.command, whole.command) == (command, "")
    missing = missing_section(sections)
    assert missing is not None
    (table,) = missing.tables
    commands = {row[0].split(":")[0]: row[1] for row in table.rows}
    assert commands["Figure 13"] == "`python -m benchmarks run liver-constant --report DIR`"
    assert "Figure 11" not in commands
    assert len(commands) == len(NUMBERS) - 2


def test_a_figure_shows_one_plant_in_order_and_says_where_it_comes_from(dot, tmp_path):
    other = tmp_path / "other.svg"
    other.write_bytes(DOT)
    both = [drawing(other, "8", plant="degraded"), drawing(dot, "8", plant="clean")]
    assert [item.job.plant for item in chosen(both, "8")] == ["clean"]
    assert [item.job.plant for item in chosen(both[:1], "8")] == ["degraded"]
    (further,) = further_sections(both)
    assert "degraded plant" in further.heading
    shuffled = [drawing(dot, "2", panel=panel) for panel in "cadb"]
    assert [item.panel for item in chosen(shuffled, "2")] == ["a", "b", "c", "d"]
    (section,) = published_sections([drawing(dot, "9", "gel-70-sinusoidal")], [])
    assert section.figures[0].caption.endswith("From `gel-70-sinusoidal`, clean plant, seed 0.")
    assert drawing(dot, plant="needle").job.where == "needle without an arm, seed 0"
    assert drawing(dot, plant="recording").job.where == "recording 0"


def test_table_one_has_the_published_numbers_beside_ours():
    gels = gel_friction(rows(seeds=(0, 2)))
    assert gels is not None
    table = gel_table(gels)
    first = dict(zip(table.head, table.rows[0], strict=True))
    assert first["published\noffline"] == "113 ± 14"
    assert first["published\nonline"] == "84 ± 10 (-26 %)"
    assert first["here\ntrue"] == "101 ± 1"
    assert first["here online\nours, F/T"] == "105 ± 1 (-5 %)"
    assert first["here online\npublished, tuned, F/T"] == "103 ± 1 (-7 %)"
    assert [row[0] for row in table.rows] == [f"{percent} %" for percent in TABLE_ONE_Ns_per_m]


def test_gels_are_those_of_the_best_arm_and_points_stand_at_them():
    found = gel_friction([*rows("needle"), *rows("degraded"), *rows("clean")])
    assert found is not None
    assert found.plant == "clean"
    assert gel_friction(rows(scenarios=("stack-constant",))) is None
    gels = gel_friction(rows(scenarios=("gel-50-constant",)))
    assert gels is not None
    chart = friction_chart("a", gels)
    points = {curve.label: curve for curve in chart.panels[0].curves}
    assert list(points["published, offline"].y) == [113.0, 283.0, 534.0]
    ours = points["ours, F/T, constant"]
    assert ours.y[1] == 104.0
    assert round(ours.x[1]) == 1
    assert "ours, F/T, sinusoidal" not in points
    assert [text for _, text in chart.x_ticks] == ["25 %", "50 %", "70 %"]


def test_tables_of_the_terminal_lose_nothing_but_their_colours():
    table = ResultTable(
        title="Targets",
        heads=("what", "reached\nN"),
        align="lr",
        lines=(("a [b]", "met"),),
        caption="A note.",
    )
    converted = page_table(table)
    assert (converted.caption, converted.note) == ("Targets", "A note.")
    assert converted.head == ("what", "reached\nN")
    assert converted.rows[0] == ("a [b]", "met")
    assert converted.numeric == {1}


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """A real one, of what needs no arm."""
    folder = tmp_path_factory.mktemp("report")
    ids = ["gel-70-constant", "gel-70-sinusoidal", "stack-glove-constant"]
    arguments = ["run", *ids, "--plant", "needle", "--jobs", "1", "--report", str(folder)]
    assert main(arguments) == 0
    return folder


def narrow_figures(folder):
    """Those of a phone; one that stands alone is there in a wide form as well."""
    return [path for path in folder.glob("*.svg") if not path.stem.endswith("-wide")]


def test_the_command_writes_page_drawings_and_numbers(report):
    page = (report / "index.html").read_text(encoding="utf-8")
    for anchor in ("figure-2", "figure-3", "figure-8", "figure-9", "figure-10", "table-I"):
        assert f'<section id="{anchor}">' in page
    assert "python -m benchmarks run liver-constant --report DIR" in page
    assert len(narrow_figures(report)) == page.count("<figcaption>")
    assert json.loads((report / "results.json").read_text())["rows"]


@needs_chromium
def test_the_report_opens_without_a_complaint(report):
    assert logged(report / "index.html") == []


@needs_chromium
@pytest.mark.parametrize("size", [PHONE, DESK], ids=["phone", "desk"])
def test_every_figure_of_the_report_is_seen_and_nothing_sticks_out(report, size):
    found = measured(report / "index.html", size)
    assert found["content"] <= size[0]
    assert found["wide"] == []
    assert len(found["images"]) == len(narrow_figures(report))
    for image in found["images"]:
        assert image["natural"] > 0, image["alt"]
        assert image["height"] > 150, image["alt"]
    assert found["letters"] >= 14.0


@needs_chromium
def test_the_report_prints(report, tmp_path):
    assert printed(report / "index.html", tmp_path / "a.pdf") >= 3
