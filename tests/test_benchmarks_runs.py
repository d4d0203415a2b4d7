"""Simulated benchmarks end to end: the arm, the needle alone, the arm's kinematics."""

from dataclasses import replace

import numpy as np
import pytest
from gel_slice import gel_slice

from benchmarks.benchmark import Job
from benchmarks.rows import to_json
from benchmarks.signals import JointSignals, MeasuredTravel, measured_travel, smoothed
from benchmarks.simulated import drawn_noise, run_needle, simulated_case, simulated_metrics
from benchmarks.tables import TABLES
from groundtruth import simulate
from groundtruth.scenarios import named_scenario

SHORT = gel_slice()
BRIEF = gel_slice(25, thickness_m=8e-3, speed_m_s=15e-3)
TOUCHLESS = replace(BRIEF, layers=())


def silent(share):
    assert 0.0 <= share <= 1.0


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    job = Job(benchmark="short", plant="needle", drawings=tmp_path_factory.mktemp("drawings"))
    return run_needle(job, SHORT, silent, is_drawn=False)


def test_a_needle_alone_gives_both_methods_on_the_ft_sensor(found):
    by_key = {(item.source, item.method, item.metric): item.value for item in found.measurements}
    assert {key[:2] for key in by_key} == {("ft", "default"), ("ft", "published")}
    assert by_key["ft", "default", "rupture_recall"] == 1.0
    assert by_key["ft", "default", "rupture_precision"] == 1.0
    assert by_key["ft", "default", "friction_error_worst_pct"] < 10.0
    true = by_key["ft", "default", "cumulative_friction_true_Ns_per_m"]
    assert true == by_key["ft", "published", "cumulative_friction_true_Ns_per_m"] > 0.0
    assert ("ft", "published", "offline_rmse_ml_N") not in by_key
    ml, kv = (by_key["ft", "default", f"offline_rmse_{model}_N"] for model in ("ml", "kv"))
    assert 0.0 < ml < kv


def test_its_charts_are_drawn_and_its_tables_have_lines(found):
    assert [drawing.path.name for drawing in found.drawings] == [
        "short-needle-0-ft-published.svg",
        "short-needle-0-ft-ours.svg",
    ]
    assert all(drawing.path.stat().st_size > 10_000 for drawing in found.drawings)
    rows = [item.row("gel-70-constant", "needle", 0) for item in found.measurements]
    for name in ("friction", "ruptures", "table I"):
        assert len(TABLES[name](rows).lines) == 2
        assert TABLES[name]([]).lines == ()


def test_without_tissue_there_is_nothing_to_identify():
    job = Job(benchmark="short", plant="needle")
    assert run_needle(job, replace(SHORT, layers=()), silent, is_drawn=False).measurements == []


def test_drawn_noise_stays_within_a_factor_of_two():
    levels = [drawn_noise(np.random.default_rng(k)).white_std_N for k in range(200)]
    assert 0.005 <= min(levels) < 0.006
    assert 0.019 < max(levels) <= 0.02


# The degraded arm's encoders step by 1.75e-4 rad, 0.1 mm at the tip, and it sends no velocity.
@pytest.mark.parametrize(
    ("plant", "depth_std_m", "zero_m", "speed_std_m_s"),
    [("ideal", 2e-5, 1e-4, 1e-3), ("degraded", 1.3e-4, 4e-4, 5e-3)],
)
def test_the_robots_kinematics_give_the_travel_of_the_tip(
    plant, depth_std_m, zero_m, speed_std_m_s
):
    run = simulate(SHORT, plant)
    travel = measured_travel(run.robot, JointSignals.of_run(run), run.tare_end_s)
    after = run.truth.t_s > run.tare_end_s
    error = (travel.depth_m - run.truth.depth_m)[after]
    assert np.std(error) < depth_std_m
    # The zero is where the tare ended, 10 mm above the surface, and not the surface.
    assert np.mean(error) == pytest.approx(10e-3, abs=zero_m)
    assert np.std((travel.speed_m_s - run.truth.speed_m_s)[after]) < speed_std_m_s


def test_a_smoothed_speed_lags_by_its_time_constant_and_leaves_the_depth_alone():
    ramp = np.linspace(0.0, 1.0, 1001)
    travel = smoothed(MeasuredTravel(ramp, ramp), np.full(1001, 1e-3), 0.02)
    assert np.array_equal(travel.depth_m, ramp)
    assert travel.speed_m_s[-1] == pytest.approx(0.98, abs=1e-3)


# The arm.


def case_of(plant, chosen=BRIEF):
    return simulated_case(Job(benchmark="short", plant=plant), chosen, silent)


def values(case):
    found = simulated_metrics(case)
    return {(item.source, item.method, item.metric): item.value for item in found}


@pytest.fixture(scope="module")
def ideal_case():
    return case_of("ideal")


@pytest.fixture(scope="module")
def degraded_case():
    return case_of("degraded")


def test_the_ideal_residual_is_the_ideal_filter(ideal_case):
    assert values(ideal_case)["virtual", "default", "residual_rms_Nm"] < 1e-6


def test_the_ft_sensor_of_the_ideal_arm_reads_the_truth(ideal_case):
    found = values(ideal_case)
    # 68 g of needle are started and stopped: that much inertia is in the reading.
    assert found["ft", "default", "wrench_rmse_N"] < 2e-3
    assert abs(found["ft", "default", "wrench_lag_ms"]) < 5.0


def test_the_lag_of_the_published_sensor_is_seen(ideal_case):
    found = values(ideal_case)
    assert found["virtual", "published", "wrench_lag_ms"] > 100.0
    assert 0.0 < found["virtual", "default", "wrench_lag_ms"] < 50.0


def test_a_wrong_sign_would_be_seen(ideal_case):
    """The error of the force turned round is twice the force."""
    judged = ideal_case.truth.judged
    ours = ideal_case.readings[1]
    assert (ours.source, ours.method) == ("virtual", "default")
    force = np.sqrt(np.mean(ideal_case.truth.axial_N[judged] ** 2))
    assert force > 0.05
    assert values(ideal_case)["virtual", "default", "wrench_rmse_N"] < 0.2 * force


def test_equal_jobs_give_equal_bytes(degraded_case):
    first, second = (
        to_json(item.row("short", "degraded", 0) for item in simulated_metrics(case))
        for case in (degraded_case, case_of("degraded"))
    )
    assert first == second


def test_every_source_and_method_has_its_four_numbers(degraded_case):
    found = values(degraded_case)
    for source, method in (("ft", "default"), ("virtual", "default"), ("virtual", "published")):
        for name in ("rmse_N", "bias_N", "lag_ms", "coverage_2sigma"):
            assert np.isfinite(found[source, method, f"wrench_{name}"])
    assert len(found) == 12


def test_without_tissue_only_the_virtual_sensor_is_judged_and_from_the_tare_on():
    case = case_of("clean", TOUCHLESS)
    assert {item.source for item in case.readings} == {"virtual"}
    assert case.truth.start_s == case.run.tare_end_s
    assert {metric for _, _, metric in values(case)} == {
        "wrench_rmse_N",
        "wrench_bias_N",
        "wrench_coverage_2sigma",
    }


def test_a_random_stack_is_drawn_from_the_seed():
    def drawn(seed):
        return named_scenario("random-stack", seed)

    assert drawn(1) == drawn(1)
    assert drawn(1) != drawn(2)
