"""From names to jobs."""

import pytest

from benchmarks import BenchmarkError, DataError
from benchmarks.catalogue import BENCHMARKS, GROUPS, make_jobs
from benchmarks.insertion.perturbations import MIXED, PERTURBATIONS
from benchmarks.insertion.robustness import SCENARIOS as ROBUST
from groundtruth import SCENARIOS


def names(jobs):
    return list(dict.fromkeys(job.benchmark for job in jobs))


def test_groups_name_what_they_say():
    tissue = [name for name, item in SCENARIOS.items() if item.layers]

    assert names(make_jobs(["free-motion", "tissue"])) == ["free-motion", *tissue]
    assert names(make_jobs()) == list(GROUPS["quick"])
    assert all(name in BENCHMARKS for group in GROUPS.values() for name in group)


def test_each_benchmark_runs_once_per_case_plant_and_seed(tmp_path):
    jobs = make_jobs(
        ["liver-constant", "liver-constant"],
        ["degraded", "degraded", "ideal"],
        seeds=2,
        first_seed=5,
        report=tmp_path,
    )

    control = make_jobs(["control"])

    assert [(job.plant, job.seed, job.report) for job in jobs] == [
        (plant, seed, tmp_path if seed == 5 else None)
        for plant in ("degraded", "ideal")
        for seed in (5, 6)
    ]
    assert len({(job.scenario, job.plant) for job in control}) == len(control)


def test_a_recording_knows_no_plants_and_no_more_seeds_than_it_has(tmp_path):
    asked = ["panda-real", "panda-liver"]
    jobs = make_jobs(asked, ["ideal"], seeds=100, first_seed=7, data=tmp_path)

    pairs = [(job.plant, job.seed) for job in jobs]
    assert pairs == [("recording", seed) for seed in (0, *range(19))]
    with pytest.raises(DataError, match="panda-real"):
        make_jobs(asked)


def test_perturbations_are_plants_of_robustness():
    every = make_jobs(["robustness"], seeds=2, first_seed=1000)
    some = make_jobs(["robustness"], ["fri", "lateral"])
    mixed = make_jobs(["robustness-mixed"])

    assert len(every) == 2 * len(ROBUST) * len(PERTURBATIONS)
    plants = [{job.plant for job in jobs} for jobs in (some, mixed)]
    assert plants == [{"fri", "lateral"}, {MIXED}]
    with pytest.raises(BenchmarkError, match="random-stack"):
        make_jobs(["random-stack"], ["lateral"])
