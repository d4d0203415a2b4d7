"""From what was asked for to jobs."""

from pathlib import Path

import pytest

from benchmarks import DataError, UnknownIdError
from benchmarks.catalogue import BENCHMARKS, benchmark
from benchmarks.paper_figures import NEEDED
from benchmarks.runner import Request, make_plan
from groundtruth import SCENARIOS

RECORDED = {item.id for item in BENCHMARKS.values() if item.is_recorded}


@pytest.fixture
def data(tmp_path):
    """A folder that looks like the recordings."""
    for item in BENCHMARKS.values():
        for name in item.needs:
            (tmp_path / name).mkdir(exist_ok=True)
    return tmp_path


def names(plan):
    return list(dict.fromkeys(job.benchmark for job in plan.jobs))


def test_every_scenario_and_every_real_recording_can_be_run_by_name():
    drawn = {"random-stack", "random-tissue"}
    assert set(SCENARIOS) | drawn | {"observers"} | RECORDED == set(BENCHMARKS)
    quick = {"panda-real", "panda-liver", "ur10e-payload", "liver-real", "bovine-real"}
    assert quick | {"liver-limit"} == RECORDED
    assert quick == {name for name in RECORDED if BENCHMARKS[name].is_default}


def test_without_recordings_the_rest_runs_and_the_skipped_are_named():
    plan = make_plan(Request())
    assert set(plan.skipped) == {name for name in RECORDED if BENCHMARKS[name].is_default}
    assert names(plan) == [
        item.id for item in BENCHMARKS.values() if item.is_default and not item.is_recorded
    ]


def test_a_folder_that_lacks_one_recording_skips_what_needs_it(data):
    (data / "liver_dejong2017").rmdir()
    plan = make_plan(Request(data=data))
    assert plan.skipped == ("panda-liver", "liver-real")
    assert "panda-real" in names(plan)


def test_all_means_all(data):
    plan = make_plan(Request(ids=["all"], data=data))
    assert names(plan) == list(BENCHMARKS)
    assert plan.skipped == ()


def test_tissue_means_every_scenario_with_tissue():
    tissue = [name for name, item in SCENARIOS.items() if item.layers]
    assert len(tissue) == 12
    assert names(make_plan(Request(ids=["tissue"]))) == tissue
    assert names(make_plan(Request(ids=["free-motion", "tissue"]))) == [*tissue, "free-motion"]


def test_every_named_benchmark_runs_once_for_every_plant_and_seed():
    request = Request(
        ids=["liver-constant", "liver-constant"], plants=["degraded", "degraded", "ideal"], seeds=3
    )
    jobs = [(job.plant, job.seed) for job in make_plan(request).jobs]
    assert jobs == [(plant, seed) for plant in ("degraded", "ideal") for seed in range(3)]


def test_a_recording_knows_no_plants_and_no_more_seeds_than_it_has(data):
    request = Request(
        ids=["panda-real", "panda-liver"], plants=["degraded", "ideal"], seeds=100, data=data
    )
    jobs = make_plan(request).jobs
    assert {job.plant for job in jobs} == {"recording"}
    assert [job.benchmark for job in jobs].count("panda-real") == 1
    assert [job.benchmark for job in jobs].count("panda-liver") == 19


def test_only_the_first_seed_draws(tmp_path):
    jobs = make_plan(Request(ids=["liver-constant"], seeds=2, drawings=tmp_path)).jobs
    assert [job.drawings for job in jobs] == [tmp_path, None]


def test_a_report_without_names_runs_all_that_the_papers_figures_need(tmp_path):
    drawn = {job.benchmark for job in make_plan(Request(drawings=tmp_path)).jobs}
    assert drawn == set(NEEDED) | {job.benchmark for job in make_plan(Request()).jobs}
    assert set(NEEDED) <= set(BENCHMARKS)
    named = make_plan(Request(ids=["liver-constant"], drawings=tmp_path)).jobs
    assert [job.benchmark for job in named] == ["liver-constant"]


@pytest.mark.parametrize(
    ("request_", "error", "message"),
    [
        (
            Request(ids=["gel"]),
            UnknownIdError,
            r"^no benchmark 'gel'; choose from: gel-25-constant",
        ),
        (Request(plants=["soft"]), UnknownIdError, "no plant 'soft'; choose from: ideal, clean"),
        (Request(data=Path("none")), DataError, "no folder of recordings at none"),
        (
            Request(ids=["free-motion"], plants=["needle"]),
            DataError,
            "free-motion needs an arm: a plant other than needle",
        ),
        (
            Request(ids=["panda-real"]),
            DataError,
            "panda-real needs recordings: give --data",
        ),
    ],
)
def test_what_cannot_be_run_is_refused_with_the_reason(request_, error, message):
    with pytest.raises(error, match=message):
        make_plan(request_)
    with pytest.raises(UnknownIdError, match="no benchmark 'gel'"):
        benchmark("gel")


def test_a_recording_asked_for_by_name_must_be_there(tmp_path):
    with pytest.raises(DataError, match="panda-real needs the folder panda_gaz2019"):
        make_plan(Request(ids=["panda-real"], data=tmp_path))


def test_the_random_stack_runs_without_an_arm_unless_one_is_named():
    assert {job.plant for job in make_plan(Request(ids=["random-stack"])).jobs} == {"needle"}
    named = make_plan(Request(ids=["random-stack"], plants=["clean"]))
    assert {job.plant for job in named.jobs} == {"clean"}


def test_a_needle_alone_leaves_out_what_needs_an_arm():
    found = names(make_plan(Request(ids=["all"], plants=["needle"])))
    assert set(found) == set(SCENARIOS) - {"free-motion"} | {"random-stack", "random-tissue"}
