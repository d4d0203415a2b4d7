"""A simulated benchmark on a short insertion: equal runs, true numbers, a picture."""

from dataclasses import replace

import numpy as np
import pytest
from gel_slice import gel_slice

from benchmarks.benchmark import Job
from benchmarks.rows import to_json
from benchmarks.simulated import simulated_case, simulated_metrics
from groundtruth.scenarios import named_scenario

SHORT = gel_slice(25, thickness_m=8e-3, speed_m_s=15e-3)
TOUCHLESS = replace(SHORT, layers=())


def silent(share):
    assert 0.0 <= share <= 1.0


def case_of(plant, chosen=SHORT):
    return simulated_case(Job(benchmark="short", plant=plant), chosen, silent)


def values(case):
    found = simulated_metrics(case)
    return {(item.source, item.method, item.metric): item.value for item in found}


@pytest.fixture(scope="module")
def textbook():
    return case_of("ideal")


@pytest.fixture(scope="module")
def hard():
    return case_of("degraded")


def test_the_textbook_residual_is_the_ideal_filter(textbook):
    assert values(textbook)["virtual", "default", "residual_rms_Nm"] < 1e-6


def test_the_ft_sensor_of_the_textbook_arm_reads_the_truth(textbook):
    found = values(textbook)
    # 68 g of needle are started and stopped: that much inertia is in the reading.
    assert found["ft", "default", "wrench_rmse_N"] < 2e-3
    assert abs(found["ft", "default", "wrench_lag_ms"]) < 5.0


def test_the_papers_lag_is_seen(textbook):
    found = values(textbook)
    assert found["virtual", "published", "wrench_lag_ms"] > 100.0
    assert 0.0 < found["virtual", "default", "wrench_lag_ms"] < 50.0


def test_a_wrong_sign_would_be_seen(textbook):
    """The error of the force turned round is twice the force."""
    judged = textbook.truth.judged
    ours = textbook.readings[1]
    assert (ours.source, ours.method) == ("virtual", "default")
    force = np.sqrt(np.mean(textbook.truth.axial_N[judged] ** 2))
    assert force > 0.05
    assert values(textbook)["virtual", "default", "wrench_rmse_N"] < 0.2 * force


def test_equal_jobs_give_equal_bytes(hard):
    first, second = (
        to_json(item.row("short", "degraded", 0) for item in simulated_metrics(case))
        for case in (hard, case_of("degraded"))
    )
    assert first == second


def test_every_source_and_method_has_its_four_numbers(hard):
    found = values(hard)
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
