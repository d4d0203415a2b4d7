"""Perturbed worlds: drawn from the seed, what they change, and what becomes of their numbers."""

from dataclasses import fields, replace

import numpy as np
import pytest
from benchmark_cases import gel_slice, make_row

from benchmarks.benchmark import Job
from benchmarks.methods import best_gain, identify, run_session
from benchmarks.perturbations import ARM_ONLY, FT_ONLY, GROUPS, MIXED, PERTURBATIONS, perturbed
from benchmarks.robustness import SCENARIOS, perturbed_needle, run_robustness
from benchmarks.runner import Request, make_plan
from benchmarks.signals import ForceTruth, JointSignals
from benchmarks.tables import TABLES, fill, result_tables, worst_rows
from groundtruth import PLANT_MODELS, scenario, simulate
from residual import PUBLISHED

BRIEF = gel_slice(25, thickness_m=10e-3, speed_m_s=10e-3)


def silent(fraction):
    assert 0.0 <= fraction <= 1.0


@pytest.mark.parametrize("name", [*PERTURBATIONS, MIXED])
def test_a_perturbation_is_drawn_from_the_seed_and_changes_something(name):
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


def test_every_size_has_a_source_and_a_mixture_is_of_three_groups():
    assert all(item.what and item.source for name, item in PERTURBATIONS.items() if name != "none")
    group_of = {name: group for group, items in GROUPS.items() for name in items}
    drawn = [perturbed(MIXED, BRIEF, seed)[1] for seed in range(40)]
    assert all(len({group_of[name] for name in names}) == 3 for names in drawn)
    assert len({name for names in drawn for name in names}) > 25


def test_a_needle_sees_the_tissue_move_and_its_truth_is_that_of_the_tissue():
    (still, before), (moved, after) = (
        perturbed_needle(name, BRIEF, 3) for name in ("none", "breathing")
    )
    assert np.allclose(still.depth_m, moved.depth_m, atol=1e-4)
    assert 0.5e-3 < np.abs(after.depth_m - before.depth_m).max() < 3e-3
    (rupture,) = after.ruptures
    at = float(np.interp(rupture.onset_s, after.t_s, after.depth_m))
    assert at == pytest.approx(rupture.onset_m, abs=5e-5)


def test_sensor_and_interface_of_a_needle_are_those_of_the_plant():
    (rate, true), (alone, _) = (perturbed_needle(n, BRIEF, 1) for n in ("rate", "depth-only"))
    assert 2e-3 <= np.median(np.diff(rate.t_s)) <= 5e-3
    assert len(rate.t_s) == len(true.axial_N) == len(rate.force_N)
    assert alone.speed_m_s is None
    loud, true = perturbed_needle("force-noise", BRIEF, 1)
    world, _ = perturbed("force-noise", BRIEF, 1)
    assert np.std(loud.force_N - true.axial_N) == pytest.approx(
        world.plant.ft_noise_std[2], rel=0.1
    )


def test_the_published_force_at_another_gain_is_that_of_a_sensor_with_that_gain():
    run = simulate(BRIEF, "clean")
    signals = JointSignals.of_run(run)
    truth = ForceTruth(
        t_s=run.truth.t_s,
        depth_m=run.truth.depth_m,
        axial_N=run.truth.axial_N,
        zeroed_s=run.tare_end_s,
        start_s=run.truth.contact_s,
        end_s=run.truth.withdrawn_s,
    )
    slow, quick = (
        run_session(
            run.robot,
            signals,
            "published",
            run.tare_end_s,
            silent,
            sensor=replace(PUBLISHED, gain_per_s=gain, alignment="hold"),
        ).reading
        for gain in (5.0, 20.0)
    )
    found = best_gain(slow, truth, signals.dt_s, (20.0,))
    assert np.std((found.axial_N - quick.axial_N)[truth.judged]) < 5e-3
    assert np.std((slow.axial_N - quick.axial_N)[truth.judged]) > 20e-3


def test_the_robustness_of_a_sensor_is_measured_without_an_arm_where_that_is_enough():
    assert FT_ONLY.isdisjoint(ARM_ONLY)
    job = Job(benchmark=f"robustness-{SCENARIOS[0]}", plant="force-noise", seed=1)
    found = run_robustness(job, silent).measurements
    assert {item.source for item in found} == {"ft"}
    assert {item.method for item in found} == {"default", "published-as-run"}
    assert {"rupture_recall", "false_alarms"} <= {item.metric for item in found}


def test_robustness_runs_every_perturbation_and_seeds_begin_where_asked():
    plan = make_plan(Request(ids=("robustness",), seeds=2, first_seed=1000))
    assert len(plan.jobs) == 2 * len(SCENARIOS) * len(PERTURBATIONS)
    assert {job.seed for job in plan.jobs} == {1000, 1001}
    some = make_plan(Request(ids=("robustness",), plants=("fri", "lateral")))
    assert {job.plant for job in some.jobs} == {"fri", "lateral"}
    assert {job.plant for job in make_plan(Request(ids=("robustness-mixed",))).jobs} == {MIXED}


def test_the_worst_comes_first_and_other_tables_leave_these_runs_out():
    rows = [
        make_row(scenario=f"robustness-{at}", plant=plant, source="ft", metric=metric, value=value)
        for at in SCENARIOS
        for plant, recall in (("none", 1.0), ("heartbeat", 0.5))
        for metric, value in (("rupture_recall", recall), ("false_alarms", 2.0))
    ]
    table = TABLES["robustness"](rows)
    assert [line[:3] for line in table.lines] == [("heartbeat", "ft", "4"), ("none", "ft", "4")]
    assert [table.title for table in result_tables(rows)] == ["Robustness"]
    page = fill("a <!-- results:begin -->\n<!-- results:end --> z", worst_rows(rows))
    assert PERTURBATIONS["heartbeat"].what in page


def test_every_plant_number_that_is_changed_exists():
    names = {item.name for item in fields(PLANT_MODELS["clean"])}
    assert all({*item.plant, *item.times} <= names for item in PERTURBATIONS.values())


def test_a_session_tared_a_sample_late_by_its_own_clock_is_judged_on_its_own_samples():
    signal, truth = perturbed_needle("none", BRIEF, 1)
    whole = identify(signal, truth, "default")
    late = replace(whole.result, estimates=whole.result.estimates[1:])
    found = identify(signal, truth, "default", result=late)
    assert found.start == whole.start + 1
    assert found.start + len(found.enhanced_N) == len(signal.t_s)
    assert [alarm.sample for alarm in found.alarms] == [alarm.sample for alarm in whole.alarms]
