"""Perturbed worlds: drawn from the seed, what they change, and what becomes of their
numbers."""

import numpy as np
import pytest

from benchmarks.catalogue import Request, make_plan
from benchmarks.insertion.perturbations import (
    ARM_ONLY,
    FT_ONLY,
    GROUPS,
    MIXED,
    PERTURBATIONS,
    perturbed,
)
from benchmarks.insertion.robustness import SCENARIOS, perturbed_needle, run_robustness
from benchmarks.jobs import Job
from benchmarks.report.tables import TABLES, build_table, frame_of, result_tables
from groundtruth import scenario
from tests.benchmarks.benchmark_cases import by_head, gel_slice, make_row, silent

BRIEF = gel_slice(25, thickness_m=10e-3, speed_m_s=10e-3)


@pytest.mark.parametrize("name", [*PERTURBATIONS, MIXED])
def test_a_perturbation_depends_on_seed_and_changes_something(name):
    chosen = scenario("stack-constant")
    world, names = perturbed(name, chosen, 1)

    assert (world, names) == perturbed(name, chosen, 1)

    plain, _ = perturbed("none", chosen, 1)

    assert (world == plain) == (name == "none")

    # Plants and a tare at rest have no size to draw.
    if name not in (*GROUPS["plants"], "tare-at-rest"):
        assert world != perturbed(name, chosen, 2)[0]
    # Whatever the hand does, it goes as deep, and the tare is done in free air.
    motion = world.scenario.motion

    assert motion.deepest_m == pytest.approx(chosen.motion.deepest_m)
    assert motion.position_m(motion.tare_end_s) == pytest.approx(-5e-3)

    if name != MIXED and name in ARM_ONLY:
        assert world.scenario.layers == chosen.layers


def test_every_size_has_a_source_mixtures_three_groups():
    assert all(
        item.what and item.source
        for name, item in PERTURBATIONS.items()
        if name != "none"
    )

    group_of = {name: group for group, items in GROUPS.items() for name in items}
    drawn = [perturbed(MIXED, BRIEF, seed)[1] for seed in range(40)]

    assert all(len({group_of[name] for name in names}) == 3 for names in drawn)
    assert len({name for names in drawn for name in names}) > 25


@pytest.mark.slow
def test_truth_is_relative_to_the_moving_tissue():
    still_signal, still_truth = perturbed_needle("none", BRIEF, 3)
    moved_signal, moved_truth = perturbed_needle("breathing", BRIEF, 3)

    assert np.allclose(still_signal.depth_m, moved_signal.depth_m, atol=1e-4)

    difference_m = np.abs(moved_truth.depth_m - still_truth.depth_m)

    assert 0.5e-3 < difference_m.max() < 3e-3

    (rupture,) = moved_truth.ruptures
    onset_m = np.interp(rupture.onset_s, moved_truth.t_s, moved_truth.depth_m)

    assert onset_m == pytest.approx(rupture.onset_m, abs=5e-5)


@pytest.mark.slow
def test_force_sensor_robustness_needs_no_arm():
    assert FT_ONLY.isdisjoint(ARM_ONLY)

    job = Job(benchmark=f"robustness-{SCENARIOS[0]}", plant="force-noise", seed=1)
    numbers = list(run_robustness(job, silent))

    assert {item.source for item in numbers} == {"ft"}
    assert {item.method for item in numbers} == {"ours", "published-as-authors-ran"}
    assert {"rupture_recall", "false_alarms"} <= {item.metric for item in numbers}


def test_robustness_runs_every_perturbation_from_the_first_seed():
    plan = make_plan(Request(ids=("robustness",), seeds=2, first_seed=1000))

    assert len(plan.jobs) == 2 * len(SCENARIOS) * len(PERTURBATIONS)
    assert {job.seed for job in plan.jobs} == {1000, 1001}

    some = make_plan(Request(ids=("robustness",), plants=("fri", "lateral")))

    assert {job.plant for job in some.jobs} == {"fri", "lateral"}
    assert {
        job.plant for job in make_plan(Request(ids=("robustness-mixed",))).jobs
    } == {MIXED}


def test_the_worst_row_is_first_in_its_table():
    rows = [
        make_row(
            scenario=f"robustness-{at}",
            plant=plant,
            source="ft",
            metric=metric,
            value=value,
        )
        for at in SCENARIOS
        for plant, recall in (("none", 1.0), ("heartbeat", 0.5))
        for metric, value in (("rupture_recall", recall), ("false_alarms", 2.0))
    ]
    lines = by_head(build_table(TABLES["robustness"], frame_of(rows)))

    assert [line["plant"] for line in lines] == ["heartbeat", "none"]
    assert {line["force"] for line in lines} == {"ft"}
    assert {line["runs"] for line in lines} == {"4"}
    assert [table.title for table in result_tables(rows)] == ["Robustness"]
