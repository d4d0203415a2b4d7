"""The gate of headline figures: what is worse is named, and nothing passes by luck."""

import json
import math

import pytest

from benchmarks import headline
from benchmarks.cli import main
from benchmarks.headline import (
    HeadlineFile,
    compare_figures,
    headline_table,
    insertion_figures,
    keep_number,
    read_headline,
    take_fastest,
    write_headline,
)
from benchmarks.jobs import Job, Outcome
from benchmarks.judging import KEPT_FIGURES, metric
from benchmarks.performance import kdl
from benchmarks.performance.kdl import KdlAbsentError
from tests.benchmarks.benchmark_cases import by_head, make_row

KINDS = {
    "delay": {"best": 0.0, "tolerance": 5.0, "relative_tolerance": 0.0},
    "recall": {"best": 1.0, "tolerance": 0.0, "relative_tolerance": 0.0},
    "error": {"best": 0.0, "tolerance": 0.0, "relative_tolerance": 0.03},
    "coverage": {"best": 0.95, "tolerance": 0.01, "relative_tolerance": 0.0},
    "sigma": {"best": 1.0, "tolerance": 0.03, "relative_tolerance": 0.03},
    "time": {"best": 0.0, "tolerance": 0.0, "relative_tolerance": 0.15},
}


def figure(kind, value, unit="1"):
    return keep_number(kind, value, unit, **KINDS[kind])


def change(kind, old, new):
    (item,) = compare_figures([figure(kind, old)], [figure(kind, new)])
    return str(item.change), item.is_failure


@pytest.mark.parametrize(
    ("kind", "old", "just_below", "just_above"),
    [
        ("delay", 80.0, 85.0, 85.01),
        ("recall", 0.9, 0.9, 0.899),
        ("error", 0.2, 0.206, 0.2061),
        ("coverage", 0.9, 0.89, 0.889),
        ("coverage", 0.96, 0.97, 0.971),
        ("sigma", 1.5, 1.53, 1.54),
        ("sigma", 0.8, 0.77, 0.76),
        ("time", 8.0, 9.2, 9.21),
    ],
)
def test_a_figure_is_worse_only_beyond_its_tolerance(kind, old, just_below, just_above):
    assert change(kind, old, just_below) == ("same", False)
    assert change(kind, old, just_above) == ("worse", True)


def test_what_is_better_beyond_tolerance_is_said_and_passes():
    assert change("delay", 80.0, 76.0) == ("same", False)
    assert change("delay", 325.0, 80.0) == ("better", False)
    assert change("coverage", 1.0, 0.95) == ("better", False)
    assert change("sigma", 3.0, 1.1) == ("better", False)
    assert change("recall", 0.9, 1.0) == ("better", False)


def test_deviations_that_are_too_wide_are_worse():
    assert change("sigma", 1.0, 2.0) == ("worse", True)
    assert change("coverage", 0.95, 1.0) == ("worse", True)


def test_rounding_to_the_digits_of_the_file_is_no_change():
    assert change("recall", 2.0 / 3.0, 0.666667) == ("same", False)
    assert change("recall", 0.666667, 2.0 / 3.0) == ("same", False)


def test_numbers_that_are_not_to_be_had_are_failures_whatever_was_before():
    assert change("delay", 80.0, math.nan) == ("not finite", True)
    assert change("delay", math.nan, math.nan) == ("not finite", True)
    assert change("delay", 80.0, math.inf) == ("not finite", True)
    assert change("delay", math.nan, 80.0) == ("better", False)

    (item,) = compare_figures([figure("delay", 80.0)], [])

    assert (str(item.change), item.is_failure) == ("missing", True)
    assert item.old == 80.0
    assert math.isnan(item.new)

    (item,) = compare_figures([], [figure("delay", 80.0)])

    assert (str(item.change), item.is_failure) == ("new", False)


def test_the_tolerance_of_the_file_counts():
    strict = keep_number(
        "delay", 80.0, "ms", best=0.0, tolerance=1.0, relative_tolerance=0.0
    )
    (item,) = compare_figures([strict], [figure("delay", 82.0)])

    assert item.is_failure


def test_figures_beside_an_absent_library_are_left_out():
    old = [figure("time", 0.7, headline.OF_KDL), figure("delay", 80.0)]

    assert [item.is_failure for item in compare_figures(old, old[1:])] == [True, False]
    assert len(compare_figures(old, old[1:], {headline.OF_KDL})) == 1


def test_the_table_shows_before_after_and_what_is_allowed():
    changes = compare_figures([figure("time", 8.0)], [figure("time", 45.0)])
    (line,) = by_head(headline_table(changes))

    assert line["old"] == "8"
    assert line["new"] == "45"
    assert line["may be worse by"] == "1.2"
    assert list(line.values())[-1] == "worse"


def rows_of(**changed):
    """What the four insertions on both plants give, every number the best."""
    for plant in ("clean", "fri"):
        for scenario in headline.SCENARIOS:
            for line in KEPT_FIGURES:
                for source in line.sources:
                    yield make_row(
                        scenario=scenario,
                        plant=plant,
                        seed=1000,
                        source=source,
                        metric=line.metric,
                        value=changed.get(
                            f"{plant} {source} {scenario} {line.metric}",
                            metric(line.metric).best,
                        ),
                    )


def changed_figures(rows):
    changes = compare_figures(insertion_figures(rows_of()), insertion_figures(rows))
    return {item.name: item for item in changes if str(item.change) != "same"}


def test_figures_sum_up_insertions_by_plant_and_force():
    stack = "fri virtual stack-constant"
    worse = {f"{stack} rupture_delay_worst_ms": 325.0, f"{stack} rupture_recall": 0.5}
    changes = changed_figures(rows_of(**worse))

    assert {name: item.new for name, item in changes.items()} == {
        "fri, virtual: delay of the alarm, worst": 325.0,
        "fri, virtual: ruptures found": 0.875,
    }
    assert all(item.is_failure for item in changes.values())


def test_an_insertion_without_a_number_leaves_its_figure_without_one():
    rows = [
        row
        for row in rows_of()
        if (row.plant, row.source, row.scenario, row.metric)
        != ("fri", "virtual", "gel-25-constant", "rupture_delay_ms")
    ]
    (item,) = changed_figures(rows).values()

    assert item.name == "fri, virtual: delay of the alarm, median"
    assert math.isnan(item.new)
    assert str(item.change) == "not finite"
    assert len(changed_figures([])) == len(insertion_figures([])) == 56


def test_the_fastest_of_three_passes_counts():
    passes = iter([[3.0, 1.0], [2.0, 9.0], [5.0, 4.0]])
    times = take_fastest(lambda: {"chain": next(passes)})

    assert times["chain"].tolist() == [2.0, 1.0]


def make_file(*figures):
    return HeadlineFile(
        commit="6efe1c774be4", versions={"numba": "0.0.1"}, figures=figures
    )


def test_a_file_is_read_as_written_one_figure_a_line(tmp_path):
    path = tmp_path / "headline.json"
    written = make_file(figure("delay", 80.123456789), figure("time", math.nan))
    write_headline(path, written)

    assert read_headline(path) == written
    assert written.figures[0].value == 80.1235

    lines = path.read_text(encoding="utf-8").splitlines()

    assert json.loads(lines[2].strip(" ,"))["name"] == "delay"
    assert '"value":null' in lines[3]


def test_the_file_in_the_repository_has_every_figure():
    stored = read_headline(headline.HEADLINE_FILE)
    names = [item.name for item in stored.figures]

    assert len(names) == len(set(names))
    assert {item.name for item in insertion_figures([])} < set(names)
    assert None not in [item.value for item in stored.figures]
    assert set(stored.versions) == {"numpy", "pin", "numba"}
    # What may change on the same seeds; so that nobody eases one unseen.
    tolerances = {
        (item.tolerance, item.relative_tolerance)
        for item in stored.figures
        if item.name.startswith("time: ")
    }
    assert tolerances == {(0.0, 0.15)}
    for item in stored.figures:
        assert item.relative_tolerance <= 0.15
        if "delay" in item.name:
            assert item.tolerance == 5.0
        if "found" in item.name:
            assert item.tolerance == item.relative_tolerance == 0.0
        if "within 2 sigma" in item.name:
            assert (item.best, item.tolerance) == (0.95, 0.01)
        if "rms error" in item.name:
            assert (item.tolerance, item.relative_tolerance) == (0.0, 0.03)


@pytest.fixture
def measured(monkeypatch):
    """Figures that the command measures in no time, to be changed."""
    figures = [figure("delay", 325.0, "ms"), figure("time", 45.0, "x Pinocchio")]
    job = Job(benchmark="gel-25-constant", plant="fri", seed=1000)
    monkeypatch.setattr(
        "benchmarks.cli.run_jobs_shown",
        lambda *arguments: [Outcome(job=job, failure="it broke")],
    )
    monkeypatch.setattr(headline, "insertion_figures", lambda rows: figures[:1])
    monkeypatch.setattr(
        headline, "measure_times", lambda progress, library: figures[1:]
    )
    monkeypatch.setattr(kdl, "kdl_library", no_kdl)
    return figures


def no_kdl():
    raise KdlAbsentError("no comparison with KDL", "Install KDL")


def test_the_command_names_what_is_worse_and_fails(tmp_path, measured, capsys):
    path = tmp_path / "headline.json"
    arguments = ["headline", "--file", str(path)]
    write_headline(path, make_file(*measured))

    assert main(arguments) == 0
    assert "Against 6efe1c774be4: 2 same" in capsys.readouterr().out

    old = [figure("delay", 80.0, "ms"), figure("time", 8.0, "x Pinocchio")]
    write_headline(path, make_file(*old))

    assert main(arguments) == 1

    captured = capsys.readouterr()

    assert "worse: delay: 80 -> 325 ms" in captured.out
    assert "worse: time: 8 -> 45 x Pinocchio" in captured.out
    assert "failed: gel-25-constant, fri, seed 1000: it broke" in captured.out
    assert "measured with numba 0.0.1, now" in captured.out
    assert "skipped: no comparison with KDL" in captured.err


def test_the_command_writes_only_whole_files(tmp_path, measured, monkeypatch, capsys):
    path = tmp_path / "headline.json"
    arguments = ["headline", "--write", "--file", str(path)]

    assert main(arguments) == 2
    assert "Install KDL" in capsys.readouterr().err
    assert not path.exists()

    monkeypatch.setattr(kdl, "kdl_library", object)

    assert main(arguments) == 0
    assert list(read_headline(path).figures) == measured
    assert main(["headline", "--file", str(tmp_path / "none.json")]) == 2
    assert "python -m benchmarks headline --write" in capsys.readouterr().err

    path.write_text('{"schema": 2}', encoding="utf-8")

    assert main(["headline", "--file", str(path)]) == 2
    assert "is not a file of figures" in capsys.readouterr().err


def test_of_a_time_measured_twice_the_lesser_counts():
    first = [figure("time", 9.0), figure("error", math.nan)]
    second = [figure("time", 8.0), figure("error", 0.1)]

    assert [item.value for item in headline.keep_lesser(first, second)] == [8.0, None]
    assert headline.keep_lesser(first, [])[0].value == 9.0
