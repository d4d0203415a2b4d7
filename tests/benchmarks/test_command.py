"""The command: tables, files, exit codes, and one line for every mistake."""

import re
from pathlib import Path

import pytest

from benchmarks import DataError, catalogue
from benchmarks.campaign.runs import run_jobs
from benchmarks.campaign.workers import Workers
from benchmarks.cli import main
from benchmarks.jobs import Benchmark, Job
from benchmarks.results import Figure, read_results, write_results
from tests.benchmarks.benchmark_cases import make_row

HARD_RMSE_N = {"liver-constant": 0.05, "gel-25-constant": 0.2}
"""On the degraded arm the first meets its target, the second misses it."""


def pretend(job, progress):
    """A benchmark that takes no time; of seed 3 it fails."""
    progress(0.5)
    if job.seed == 3:
        raise DataError("the third is broken")
    rmse = HARD_RMSE_N[job.benchmark]
    yield Figure("wrench_rmse_N", rmse)
    yield Figure("wrench_rmse_N", 10.0 * rmse, method="published-one-setting")
    yield Figure("residual_rms_Nm", 1e-9)


@pytest.fixture(autouse=True)
def _pretended(monkeypatch):
    items = [Benchmark(id=name, title=name, run=pretend) for name in HARD_RMSE_N]
    real = Benchmark(
        id="panda-real", title="real", run=pretend, needs=("panda_gaz2019",)
    )
    monkeypatch.setattr(
        catalogue, "BENCHMARKS", {item.id: item for item in (*items, real)}
    )
    monkeypatch.delenv("NEEDLEFORCE_DATA", raising=False)


def run(*arguments):
    return main(["run", "--workers", "1", *arguments])


@pytest.mark.slow
def test_a_run_fails_for_missed_targets_when_strict(
    capsys,
):
    assert run("--plant", "degraded", "--targets") == 0

    out = capsys.readouterr().out
    for words in (
        "liver-constant",
        "met",
        "missed",
        "DIR or NEEDLEFORCE_DATA): panda-real",
    ):
        assert words in out

    assert run("liver-constant", "--plant", "degraded", "--strict") == 0
    assert run("gel-25-constant", "--plant", "degraded", "--strict") == 1
    assert run("gel-25-constant", "--plant", "degraded") == 0


def test_tables_begin_with_the_answer_and_show_targets_only_if_asked(capsys):
    assert run("--plant", "degraded") == 0

    plain = capsys.readouterr().out

    answer = "rms: 0.125 N, by the published method with one setting 1.250 N."

    assert f"joint torques, {answer}" in plain
    assert "ours: this toolkit" in plain
    for words in ("target", "Target", "missed", " met "):
        assert words not in plain

    assert run("--plant", "degraded", "--strict") == 1

    strict = capsys.readouterr().out

    assert re.sub("in . s", "", strict) == re.sub("in . s", "", plain)


@pytest.mark.slow
def test_a_report_is_named_last_and_begins_with_the_answer(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    folder = tmp_path / "report"

    assert run("--plant", "degraded", "--report", str(folder)) == 0

    last = capsys.readouterr().out.splitlines()[-1]
    page = (folder / "index.html").read_text(encoding="utf-8")

    assert last == f"Figures and tables: {folder / 'index.html'}"
    assert page.index("rms: 0.125 N") < page.index("Counterparts of the figures")
    assert "missed" not in page
    assert "missed" not in (folder / "results.md").read_text(encoding="utf-8")


def test_plants_may_be_listed_and_runs_are_repeatable(tmp_path):
    paths = [tmp_path / name for name in ("a.json", "b.json")]
    for path in paths:
        run(
            "--plant",
            "degraded,ideal",
            "--plant",
            "clean",
            "--seeds",
            "2",
            "--json",
            str(path),
        )

    assert paths[0].read_bytes() == paths[1].read_bytes()

    rows = read_results(paths[0])

    assert len(rows) == 36
    assert list(dict.fromkeys(row.plant for row in rows)) == [
        "degraded",
        "ideal",
        "clean",
    ]


def test_a_failing_benchmark_is_named_and_others_run(tmp_path, capsys):
    path = tmp_path / "a.json"

    assert run("liver-constant", "--seeds", "5", "--json", str(path)) == 1
    assert (
        "liver-constant, clean, seed 3: DataError: the third" in capsys.readouterr().out
    )
    assert {row.seed for row in read_results(path)} == {0, 1, 2, 4}


MISTAKES = {
    "nothing": "no benchmark 'nothing'; choose from: liver-constant",
    "--plant soft": "no plant 'soft'; choose from: ideal, clean, fri, degraded",
    "--plant ,": "--plant: expected at least one name",
    "--data /no/such/folder": "no folder of recordings at",
    "panda-real": "panda-real needs recordings. Give the folder",
    "--json /no/such/folder/a.json": "cannot write",
    "--report file": "cannot write to",
    "--report .": "cannot write",
    "--seeds 0": "--seeds. Must be >= 1",
    "--seeds x": "--seeds",
    "--sedes 2": "--sedes",
}


@pytest.mark.parametrize(("arguments", "message"), MISTAKES.items())
def test_a_mistake_is_one_line_and_code_2(
    tmp_path, monkeypatch, capsys, arguments, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    (tmp_path / "index.html").mkdir()

    assert run(*arguments.split()) == 2

    error = capsys.readouterr().err

    assert message in error
    assert error.startswith("error: ")
    assert error.count("\n") == 1


def test_wrong_usage_is_code_2_help_states_durations(capsys):
    assert main([]) == 2
    assert "compare" in capsys.readouterr().out
    assert main(["walk"]) == 2
    assert main(["compare", "a.json"]) == 2
    assert main(["stream", "--format", ".txt"]) == 2
    assert capsys.readouterr().err.count("\n") == 3
    assert main(["list"]) == 0

    out = capsys.readouterr().out

    assert "liver-constant" in out
    assert "ideal, clean, fri, degraded, needle" in out

    for command in ("speed", "faults"):
        assert main([command, "--help"]) == 0
        assert re.search(r"Takes about \d+ s", capsys.readouterr().out)


def test_compare_fails_on_what_is_worse_or_lost(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rows = {
        "old": [0.1, 0.1],
        "new": [0.3, 0.1],
        "lost": [float("nan"), 0.1],
        "one": [0.1],
    }
    for name, values in (rows | {"empty": []}).items():
        write_results(
            Path(name), [make_row(seed=k, value=v) for k, v in enumerate(values)]
        )
    for pair, code, said in (
        ("old new", 1, "1 same, 1 worse"),
        ("new old", 0, "1 better"),
        ("old old", 0, "2 same"),
        ("old one", 1, "missing"),
        ("old lost", 1, "not finite"),
        ("lost lost", 1, "not finite"),
        ("empty empty", 2, "nothing to compare"),
        ("empty none", 2, "cannot read"),
    ):
        assert main(["compare", *pair.split()]) == code
        assert said in "".join(capsys.readouterr())


@pytest.mark.slow
def test_outcomes_stand_in_the_order_of_jobs():
    jobs = [Job(benchmark=f"none-{k}", plant="degraded") for k in range(3)]
    progress = {}
    outcomes = run_jobs(jobs, Workers(workers=2), progress.__setitem__)

    assert [item.job for item in outcomes] == jobs

    for k, item in enumerate(outcomes):
        assert f"no benchmark 'none-{k}'" in (item.failure or "")

    assert set(progress.values()) <= {1.0}
