"""From what was asked for to jobs, simulated benchmarks end to end, errors of a
force."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import DataError
from benchmarks.catalogue import BENCHMARKS, Request, make_plan
from benchmarks.insertion.methods import (
    ForceReading,
    force_lag_s,
    warnings_of,
    wrench_metrics,
)
from benchmarks.insertion.signals import ForceTruth
from benchmarks.insertion.simulated import (
    read_sensors,
    run_needle,
    simulated_metrics,
)
from benchmarks.jobs import Drawing, Job
from benchmarks.report.published_figures import NEEDED
from benchmarks.report.tables import TABLES, build_table, frame_of
from groundtruth import SCENARIOS, simulate
from identification import SampleStatus, TissueWarning
from residual import SensorWarning
from tests.benchmarks.benchmark_cases import gel_slice, silent

SHORT = gel_slice()
BRIEF = gel_slice(25, thickness_m=8e-3, speed_m_s=15e-3)
TOUCHLESS = replace(BRIEF, layers=())


@pytest.mark.slow
def test_a_needle_alone_gives_both_methods_and_charts(tmp_path):
    job = Job(benchmark="short", plant="needle", drawings=tmp_path)
    result = list(run_needle(job, SHORT, silent, is_drawn=False))
    drawings = [item for item in result if isinstance(item, Drawing)]
    figures = [item for item in result if not isinstance(item, Drawing)]
    by_key = {(item.source, item.method, item.metric): item.value for item in figures}
    methods = {"ours", "published-one-setting", "published-as-authors-ran"}

    assert {key[:2] for key in by_key} == {("ft", method) for method in methods}
    assert by_key["ft", "ours", "rupture_recall"] == 1.0
    assert by_key["ft", "ours", "rupture_precision"] == 1.0
    assert by_key["ft", "ours", "friction_error_worst_pct"] < 10.0

    true = by_key["ft", "ours", "cumulative_friction_true_Ns_per_m"]

    assert (
        true
        == by_key["ft", "published-one-setting", "cumulative_friction_true_Ns_per_m"]
        > 0.0
    )
    assert ("ft", "published-one-setting", "offline_rmse_ml_N") not in by_key

    ml, kv = (by_key["ft", "ours", f"offline_rmse_{model}_N"] for model in ("ml", "kv"))

    assert 0.0 < ml < kv
    assert [drawing.shown.path.name for drawing in drawings] == [
        "short-needle-0-ft-published.svg",
        "short-needle-0-ft-ours.svg",
    ]
    assert all(drawing.shown.path.stat().st_size > 10_000 for drawing in drawings)

    rows = [item.row("gel-70-constant", "needle", 0) for item in figures]
    for name in ("friction", "ruptures", "table I"):
        assert len(build_table(TABLES[name], frame_of(rows)).lines) == 3
        assert build_table(TABLES[name], frame_of([])).lines == ()

    # Without tissue there is nothing to identify.
    touchless = replace(SHORT, layers=())

    assert list(run_needle(job, touchless, silent, is_drawn=False)) == []


def case_of(plant, chosen=BRIEF):
    return read_sensors(simulate(chosen, plant), silent)


def values(case):
    measurements = simulated_metrics(case)
    return {
        (item.source, item.method, item.metric): item.value for item in measurements
    }


@pytest.mark.slow
def test_the_ideal_arm_gives_true_force_and_lags():
    case = case_of("ideal")
    numbers = values(case)

    assert numbers["virtual", "ours", "residual_rms_Nm"] < 1e-6
    # 68 g of needle are started and stopped: that much inertia is in the reading.
    assert numbers["ft", "ours", "wrench_rmse_N"] < 2e-3
    assert abs(numbers["ft", "ours", "wrench_lag_ms"]) < 5.0
    assert numbers["virtual", "published-one-setting", "wrench_lag_ms"] > 100.0
    assert 0.0 < numbers["virtual", "ours", "wrench_lag_ms"] < 50.0

    # A wrong sign would be seen: the error of the force turned round is twice the
    # force.
    force = np.sqrt(np.mean(case.truth.axial_N[case.truth.judged] ** 2))

    assert force > 0.05
    assert numbers["virtual", "ours", "wrench_rmse_N"] < 0.2 * force


@pytest.mark.slow
def test_equal_runs_give_equal_numbers_of_every_source():
    case = case_of("degraded")
    numbers = values(case)

    assert numbers == values(case)

    for source, method in (
        ("ft", "ours"),
        ("virtual", "ours"),
        ("virtual", "published-one-setting"),
    ):
        for name in ("rmse_N", "bias_N", "lag_ms", "coverage_2sigma"):
            assert np.isfinite(numbers[source, method, f"wrench_{name}"])

    assert len(numbers) == 22


@pytest.mark.slow
def test_without_tissue_only_the_virtual_sensor_is_judged():
    case = case_of("clean", TOUCHLESS)

    assert {item.source for item in case.readings} == {"virtual"}
    assert case.truth.start_s == case.run.tare_end_s

    numbers = {
        "wrench_rmse_N",
        "wrench_bias_N",
        "wrench_coverage_2sigma",
        "tare_refused",
        "torque_jump_warned",
        "needle_pull_warned",
        "moving_tissue_warned",
        "hard_contact_warned",
    }

    assert {metric for _, _, metric in values(case)} == numbers


def test_warnings_are_told_apart():
    identification = SimpleNamespace(
        warnings=TissueWarning.HARD_CONTACT, status=SampleStatus.NEEDLE_PULLED
    )
    estimate = SimpleNamespace(
        warnings=SensorWarning.TORQUE_JUMP, identification=identification
    )

    assert list(warnings_of(estimate)) == [
        "torque_jump_warned",
        "needle_pull_warned",
        "hard_contact_warned",
    ]


@pytest.fixture
def data(tmp_path):
    """A folder that looks like the recordings."""
    for item in BENCHMARKS.values():
        for name in item.needs:
            (tmp_path / name).mkdir(exist_ok=True)
    return tmp_path


def plan(*ids, **asked):
    return make_plan(Request(ids=ids, **asked))


def names(found):
    return list(dict.fromkeys(job.benchmark for job in found.jobs))


def test_without_recordings_the_skipped_are_named(data):
    quick = [item for item in BENCHMARKS.values() if item.is_default]

    assert set(plan().skipped) == {item.id for item in quick if item.is_recorded}
    assert names(plan()) == [item.id for item in quick if not item.is_recorded]

    (data / "liver_dejong2017").rmdir()

    assert plan(data=data).skipped == ("panda-liver", "liver-real", "liver-bound")
    assert "panda-real" in names(plan(data=data))


def test_all_and_tissue_name_what_they_say(data):
    assert names(plan("all", data=data)) == [
        n for n, b in BENCHMARKS.items() if not b.group
    ]
    assert plan("all", data=data).skipped == ()

    tissue = [name for name, item in SCENARIOS.items() if item.layers]

    assert len(tissue) == 12
    assert names(plan("tissue")) == tissue
    assert names(plan("free-motion", "tissue")) == [*tissue, "free-motion"]


def test_named_benchmarks_run_once_per_plant_and_seed(data, tmp_path):
    made_plan = plan(
        "liver-constant",
        "liver-constant",
        plants=["degraded", "degraded", "ideal"],
        seeds=3,
    )
    jobs = [(job.plant, job.seed) for job in made_plan.jobs]

    assert jobs == [
        (plant, seed) for plant in ("degraded", "ideal") for seed in range(3)
    ]

    # A recording knows no plants and no more seeds than it has.
    recorded = plan(
        "panda-real", "panda-liver", plants=["degraded", "ideal"], seeds=100, data=data
    )

    assert {job.plant for job in recorded.jobs} == {"recording"}
    assert [job.benchmark for job in recorded.jobs].count("panda-real") == 1
    assert [job.benchmark for job in recorded.jobs].count("panda-liver") == 19

    drawn = plan("liver-constant", seeds=2, drawings=tmp_path).jobs

    assert [job.drawings for job in drawn] == [tmp_path, None]
    # A report without names runs all that the published figures need.
    assert set(names(plan(drawings=tmp_path))) == set(NEEDED) | set(names(plan()))
    assert set(NEEDED) <= set(BENCHMARKS)
    assert names(plan("liver-constant", drawings=tmp_path)) == ["liver-constant"]


def test_a_missing_arm_or_recording_is_refused(tmp_path):
    with pytest.raises(
        DataError, match="free-motion needs a plant, one of ideal, clean"
    ):
        plan("free-motion", plants=["needle"])
    with pytest.raises(DataError, match="panda-real needs the folder panda_gaz2019"):
        plan("panda-real", data=tmp_path)
    # A needle alone leaves out what needs an arm.
    assert {job.plant for job in plan("random-stack").jobs} == {"needle"}
    assert {job.plant for job in plan("random-stack", plants=["clean"]).jobs} == {
        "clean"
    }

    ids = names(plan("all", plants=["needle"]))

    assert set(ids) == set(SCENARIOS) - {"free-motion"} | {
        "random-stack",
        "random-tissue",
    }


T = np.arange(0.0, 20.0, 1e-3)


def saw(t):
    """A force that climbs and ruptures, zero before 5 s."""
    return np.where(t < 5.0, 0.0, np.mod(t, 5.0) * 0.3)


def reading(axial, std=0.1):
    return ForceReading(
        source="virtual", method="ours", axial_N=axial, std_N=np.full(len(axial), std)
    )


def truth(axial, start=2.0, end=18.0):
    return ForceTruth(
        t_s=T, depth_m=T, axial_N=axial, zeroed_s=1.0, start_s=start, end_s=end
    )


def measured(axial, true, **kw):
    return {
        item.metric: item.value
        for item in wrench_metrics(reading(axial, **kw), truth(true))
    }


@pytest.mark.slow
@given(delay=st.floats(-0.05, 0.5), offset=st.floats(-1.0, 1.0))
def test_a_delay_is_found_whatever_the_offset(delay, offset):
    lag_s = force_lag_s(T, np.interp(T - delay, T, saw(T)) + offset, saw(T))
    assert lag_s == pytest.approx(delay, abs=1e-4)


def test_constant_error_is_bias_and_coverage_two_deviations():
    numbers = measured(saw(T) + 0.05, saw(T))

    assert numbers["wrench_rmse_N"] == pytest.approx(0.05)
    assert numbers["wrench_bias_N"] == pytest.approx(0.05)
    assert numbers["wrench_lag_ms"] == pytest.approx(0.0, abs=0.1)

    noise = np.random.default_rng(0).normal(scale=0.2, size=len(T))
    for std, fraction in ((0.1, 0.6827), (0.2, 0.9545)):
        numbers = measured(saw(T) + noise, saw(T), std=std)
        assert numbers["wrench_coverage_2sigma"] == pytest.approx(fraction, abs=0.01)


def test_only_the_judged_part_of_a_force_counts():
    wild = saw(T) + np.where((T < 2.0) | (T > 18.0), 100.0, 0.0)

    assert measured(wild, saw(T))["wrench_rmse_N"] == 0.0

    wild[10_000] = np.nan  # in the judged part it does not hide

    assert math.isnan(measured(wild, saw(T))["wrench_rmse_N"])

    never = truth(saw(T), start=30.0, end=40.0)
    numbers = {
        item.metric: item.value for item in wrench_metrics(reading(saw(T)), never)
    }

    assert "wrench_rmse_N" in numbers
    assert all(math.isnan(value) for value in numbers.values())
