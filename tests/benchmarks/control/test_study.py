"""The closed loop as a study: its parts, its table, its file, its targets."""

import math
import sys
from types import SimpleNamespace

import pytest

from benchmarks import UnknownIdError, catalogue, judging
from benchmarks.catalogue import Request, make_plan
from benchmarks.cli import main
from benchmarks.judging import Target
from benchmarks.report.tables import TABLES, build_table, frame_of
from benchmarks.results import Figure, read_results
from tests.benchmarks.benchmark_cases import by_head


def measure(job, progress):
    """Numbers that grow with the seed; one case fails."""
    if job.case == "broken S":
        raise ValueError("no arm")
    factor = 10.0 if job.plant == "fri" else 1.0
    yield Figure("rcm_error_max_mm", factor * (job.seed - 999))
    yield Figure("membrane_contrast_shown", 0.9 + 0.01 * (job.seed - 1000))
    yield Figure("leading_force_N", math.nan if job.seed == 1001 else 1.0)
    yield Figure("rcm_error_max_mm", 7.0, method="published")


GOALS = tuple(
    Target(what=metric, metric=metric, plant="clean", **limits)
    for metric, limits in (
        ("rcm_error_max_mm", {"at_most": 2.0}),
        ("membrane_contrast_shown", {"at_least": 0.85}),
        ("leading_force_N", {"at_most": 1.0}),
    )
)


@pytest.fixture
def part(monkeypatch):
    """A part of the study that takes no time."""
    module = SimpleNamespace(CASES=("usual S", "broken S"), run=measure)
    monkeypatch.setitem(sys.modules, "benchmarks.control.priority", module)
    monkeypatch.setattr(judging, "TARGETS", GOALS)
    name = "control-priority"
    monkeypatch.setattr(catalogue, "BENCHMARKS", {name: catalogue.BENCHMARKS[name]})


def run(path, *arguments):
    options = ["--workers", "1", "--seeds", "3", "--json", str(path)]
    return main(["run", "control-priority", *options, *arguments])


def test_a_study_writes_rows_like_any_other_benchmark(part, tmp_path, capsys):
    path = tmp_path / "control.json"

    assert run(path) == 1  # a case fails
    assert "ValueError: no arm" in capsys.readouterr().out

    rows = read_results(path)

    assert {row.scenario for row in rows} == {"control-priority/usual-S"}
    assert [row.seed for row in rows[::4]] == [1000, 1001, 1002]
    assert main(["compare", str(path), str(path)]) == 1  # a number is not finite


def test_a_study_goes_on_after_an_interruption(part, tmp_path):
    path = tmp_path / "control.json"
    run(path)
    written = path.read_bytes()
    run(path, "--resume")

    assert path.read_bytes() == written


def test_the_table_shows_misses_first_and_the_limits(part, tmp_path):
    path = tmp_path / "control.json"
    run(path)
    lines = by_head(build_table(TABLES["control"], frame_of(read_results(path))))
    by_metric = {(line["method"], line["what"]): line for line in lines}
    error = by_metric["ours", "distance of the true axis from the remote centre, max"]

    assert error["clean"] == "2 (3)"
    assert error["fri"] == "–"
    assert error["target"] == "≤ 2 mm missed"
    assert error["unit"] == "mm"

    force = by_metric["ours", "force at the hub at 100 mm/s"]

    assert force["clean"] == "not finite"
    assert force["target"] == "≤ 1 N missed"

    is_missed = ["missed" in line["target"] for line in lines]

    assert is_missed == sorted(is_missed, reverse=True)


def test_control_names_all_parts_on_both_plants():
    plan = make_plan(Request(ids=("control",)))

    parts = {job.benchmark.removeprefix("control-") for job in plan.jobs}

    assert parts == {
        "priority",
        "limits",
        "constraints",
        "guidance",
        "teleoperation",
        "autonomous",
        "pulls",
        "faults",
    }

    plants = {job.plant for job in plan.jobs if job.benchmark == "control-guidance"}

    assert plants == {"clean", "fri"}
    assert {job.seed for job in plan.jobs} == {1000}

    scenarios = [(job.scenario, job.plant) for job in plan.jobs]

    assert len(set(scenarios)) == len(scenarios)
    with pytest.raises(UnknownIdError, match="control-constraints"):
        make_plan(Request(ids=("control-magic",)))
