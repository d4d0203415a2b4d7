"""The command: runs, their file, comparison, mistakes."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import ResultsError, campaign, catalogue, judging
from benchmarks.campaign import read_merged, read_results, run_jobs, write_results
from benchmarks.cli import main
from benchmarks.jobs import Figure, Job
from benchmarks.judging import Target
from tests.benchmarks.benchmark_cases import make_results, make_seeds


def measure(job):
    """Numbers that grow with the seed; one case fails, another has a typing error."""
    if job.case == "broken S":
        raise ValueError("no arm")
    yield Figure("rcm_error_max_mm", job.seed - 999.0)
    yield Figure(
        "rcm_error_max_mm" if job.case == "usual S" else "rcm_eror_mm", 7.0, "ft"
    )


@pytest.fixture
def study(monkeypatch):
    """A study that takes no time."""
    module = SimpleNamespace(CASES=("usual S", "broken S", "wrong S"), run=measure)
    monkeypatch.setitem(sys.modules, "pretended", module)
    benchmark = catalogue.Benchmark(
        title="a study",
        module="pretended",
        group="control",
        has_cases=True,
        first_seed=1000,
    )
    monkeypatch.setitem(catalogue.BENCHMARKS, "study", benchmark)
    return module


def run(*arguments):
    return main(["run", "study", "--workers", "1", *map(str, arguments)])


def test_a_run_writes_its_numbers_and_names_what_failed(study, tmp_path, capsys):
    path = tmp_path / "a.parquet"

    assert run("--out", path, "--seeds", "2") == 1

    printed = capsys.readouterr().out
    results = read_results(path)
    kinds = set(zip(results["scenario"], results["unit"], strict=True))

    assert "ValueError: no arm" in printed
    assert "rcm_eror_mm" in printed
    assert kinds == {("study/usual-S", "mm")}
    assert results.groupby("seed")["value"].agg(list).to_dict() == {
        1000: [7.0, 1.0],
        1001: [7.0, 2.0],
    }
    assert results.attrs["commit"] == campaign.find_commit()


def test_a_run_goes_on_with_the_jobs_whose_numbers_are_missing(study, tmp_path):
    path = tmp_path / "a.parquet"
    study.CASES = study.CASES[:1]
    done = []
    study.run = lambda job: [done.append(job.seed), Figure("rcm_error_max_mm", 1.0)][1:]

    more = ("--out", path, "--seeds", "3", "--resume")
    assert [run("--out", path), run(*more), run("--resume")] == [0, 0, 2]
    assert [done, sorted(read_results(path)["seed"])] == [[1000, 1001, 1002]] * 2


def test_what_was_measured_is_kept_when_a_run_is_interrupted(study, tmp_path):
    def interrupt(job):
        if job.seed == 1001:
            raise KeyboardInterrupt
        yield Figure("rcm_error_max_mm", 1.0)

    study.run = interrupt
    path = tmp_path / "a.parquet"
    jobs = [Job(benchmark="study", plant="clean", seed=seed) for seed in (1000, 1001)]

    with pytest.raises(KeyboardInterrupt):
        run_jobs(jobs, path, workers=1)

    assert read_results(path)["seed"].tolist() == [1000]


def test_a_missed_target_fails_a_strict_run(study, monkeypatch):
    study.run = lambda job: [Figure("rcm_error_max_mm", 9.0)]
    target = Target(
        what="a goal", metric="rcm_error_max_mm", plant="clean", at_most=1.0
    )
    monkeypatch.setattr(judging.evaluate, "__defaults__", ((target,),))
    study.CASES = ("usual S",)

    assert [run(), run("--strict", "--targets")] == [0, 1]


def test_compare_fails_on_what_is_worse(tmp_path, capsys):
    old, new = (str(tmp_path / f"{name}.parquet") for name in ("old", "new"))
    write_results(Path(old), [make_seeds((0.1, 0.1))])
    write_results(Path(new), [make_seeds((0.2, 0.1))])

    assert main(["compare", old, new]) == 1
    assert "1 worse" in capsys.readouterr().out
    assert [main(["compare", new, old]), main(["results", old])] == [0, 0]
    assert "wrench_rmse_N" in capsys.readouterr().out


def test_the_last_file_of_a_scenario_on_a_plant_counts(tmp_path):
    paths = [tmp_path / "first.parquet", tmp_path / "more.parquet"]
    write_results(paths[0], [make_results({}, {"plant": "clean", "seed": 7})])
    write_results(paths[1], [make_results({"plant": "clean", "value": 0.02})])
    merged = read_merged(paths)

    assert sorted(zip(merged["plant"], merged["value"], strict=True)) == [
        ("clean", 0.02),
        ("degraded", 0.1),
    ]


def test_a_file_that_is_none_is_refused(tmp_path):
    path = tmp_path / "a.parquet"
    path.write_text("no table")
    for bad in (path, tmp_path / "none.parquet"):
        with pytest.raises(ResultsError, match=bad.name):
            read_results(bad)
    make_seeds((1.0,)).drop(columns="unit").to_parquet(path)
    with pytest.raises(ResultsError, match="unit"):
        read_results(path)
    with pytest.raises(ResultsError, match="folder"):
        run_jobs([], tmp_path / "none" / "a.parquet")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["run", "gel-26-constant"], "gel-26-constant"),
        (["run", "gel-25-constant", "--plant", "magic"], "magic"),
        (["run", "free-motion", "--plant", "needle"], "needle"),
        (["run", "liver-real", "--data", "none"], "recordings"),
        (["run", "--seeds", "0"], "seeds"),
        (["run", "--cluster", "tcp://127.0.0.1:1", "gel-25-constant"], "scheduler"),
        (["figures", "none.parquet"], "none.parquet"),
    ],
)
def test_a_mistake_is_one_line_and_code_2(arguments, word, capsys):
    assert main(arguments) == 2
    assert word in capsys.readouterr().err


def test_figures_come_from_a_clean_commit(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(campaign, "find_commit", lambda: "abc-dirty")
    path = tmp_path / "a.parquet"
    write_results(path, [make_seeds((1.0,))])

    assert main(["figures", str(path)]) == 2
    assert "abc-dirty" in capsys.readouterr().err
