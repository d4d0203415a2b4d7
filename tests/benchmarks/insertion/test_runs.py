"""Simulated insertions end to end, and errors of a force."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.insertion.methods import (
    WARNINGS,
    ForceReading,
    force_lag_s,
    wrench_metrics,
)
from benchmarks.insertion.signals import ForceTruth
from benchmarks.insertion.simulated import read_sensors, run_needle, simulated_metrics
from benchmarks.jobs import Job
from groundtruth import simulate
from identification import SampleStatus, TissueWarning
from residual import SensorWarning
from tests.benchmarks.benchmark_cases import gel_slice

BRIEF = gel_slice(25, thickness_m=8e-3, speed_m_s=15e-3)


def values(figures):
    return {(item.source, item.method, item.metric): item.value for item in figures}


@pytest.mark.slow
def test_a_needle_alone_is_identified_by_every_method_and_drawn(tmp_path):
    job = Job(benchmark="gel-70-constant", plant="needle", report=tmp_path)
    numbers = values(run_needle(job, gel_slice(), is_drawn=False))
    ml, kv = (
        numbers["ft", "ours", f"offline_rmse_{model}_N"] for model in ("ml", "kv")
    )

    assert {key[:2] for key in numbers} == {
        ("ft", "ours"),
        ("ft", "published-one-setting"),
        ("ft", "published-as-authors-ran"),
    }
    scores = [numbers["ft", "ours", f"rupture_{n}"] for n in ("recall", "precision")]
    assert scores == [1.0, 1.0]
    assert numbers["ft", "ours", "friction_error_worst_pct"] < 10.0
    assert numbers["ft", "ours", "cumulative_friction_true_Ns_per_m"] > 0.0
    assert 0.0 < ml < kv
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "figure-2-gel-70-constant-needle-0-offline.svg",
        "figure-8-gel-70-constant-needle-0-ft.svg",
    ]


@pytest.mark.slow
def test_the_ideal_arm_gives_true_force_and_lags():
    case = read_sensors(simulate(BRIEF, "ideal"))
    numbers = values(simulated_metrics(case))
    force_N = np.sqrt(np.mean(case.truth.axial_N[case.truth.judged] ** 2))

    # 68 g of needle are started and stopped: that much inertia is in the reading.
    assert numbers["ft", "ours", "wrench_rmse_N"] < 2e-3
    assert abs(numbers["ft", "ours", "wrench_lag_ms"]) < 5.0
    assert 0.0 < numbers["virtual", "ours", "wrench_lag_ms"] < 50.0
    # A wrong sign would be seen: the error of the force turned round is twice the
    # force.
    assert numbers["virtual", "ours", "wrench_rmse_N"] < 0.2 * force_N
    assert force_N > 0.05


def test_warnings_are_told_apart():
    estimate = SimpleNamespace(
        warnings=SensorWarning.TORQUE_JUMP,
        identification=SimpleNamespace(
            warnings=TissueWarning.HARD_CONTACT, status=SampleStatus.NEEDLE_PULLED
        ),
    )

    assert [name for name, is_said in WARNINGS.items() if is_said(estimate)] == [
        "torque_jump_warned",
        "needle_pull_warned",
        "hard_contact_warned",
    ]


T = np.arange(0.0, 20.0, 1e-3)
SAW = np.where(T < 5.0, 0.0, np.mod(T, 5.0) * 0.3)
"""A force that climbs and ruptures, zero before 5 s."""


def measured(axial_N, std_N=0.1, start_s=2.0):
    reading = ForceReading(
        source="virtual", method="ours", axial_N=axial_N, std_N=np.full(len(T), std_N)
    )
    truth = ForceTruth(
        t_s=T, depth_m=T, axial_N=SAW, zeroed_s=1.0, start_s=start_s, end_s=18.0
    )
    return {item.metric: item.value for item in wrench_metrics(reading, truth)}


@pytest.mark.slow
@given(delay=st.floats(-0.05, 0.5), offset=st.floats(-1.0, 1.0))
def test_a_delay_is_found_whatever_the_offset(delay, offset):
    late = np.interp(T - delay, T, SAW) + offset

    assert force_lag_s(T, late, SAW) == pytest.approx(delay, abs=1e-4)


@pytest.mark.parametrize(("std_N", "fraction"), [(0.1, 0.6827), (0.2, 0.9545)])
def test_coverage_is_of_two_stated_deviations(std_N, fraction):
    noise_N = np.random.default_rng(0).normal(scale=0.2, size=len(T))
    numbers = measured(SAW + 0.05 + noise_N, std_N)

    assert numbers == numbers | {
        "wrench_bias_N": pytest.approx(0.05, abs=0.01),
        "wrench_rmse_N": pytest.approx(0.206, abs=0.01),
        "wrench_lag_ms": pytest.approx(0.0, abs=2.0),
        "wrench_coverage_2sigma": pytest.approx(fraction, abs=0.03),
    }


def test_only_the_judged_part_of_a_force_counts():
    wild = SAW + np.where((T < 2.0) | (T > 18.0), 100.0, 0.0)

    assert measured(wild)["wrench_rmse_N"] == 0.0

    wild[10_000] = np.nan  # in the judged part it does not hide

    assert math.isnan(measured(wild)["wrench_rmse_N"])
    assert all(map(math.isnan, measured(SAW, start_s=30.0).values()))
