"""Constraints in closed loop, shortened."""

from fnmatch import fnmatchcase

import pytest

from benchmarks.control import constraints as control_constraints
from benchmarks.control.constraints import CASES
from benchmarks.jobs import Job
from benchmarks.judging import TARGETS


def numbers(case):
    job = Job(benchmark="control-constraints", case=case, plant="clean")
    figures = control_constraints.run(job)
    return {item.metric: item.value for item in figures}


def limits(case):
    """Upper limits by metric, on the plant clean."""
    scenario = f"control-constraints/{case.replace(' ', '-')}"
    return {
        target.metric: target.at_most
        for target in TARGETS
        if any(fnmatchcase(scenario, name) for name in target.scenarios)
    }


@pytest.mark.slow
def test_constraints_hold_their_targets(monkeypatch):
    """On shorter paths the constraints meet their targets."""
    monkeypatch.setattr(control_constraints, "PERIOD_s", 2.0)
    monkeypatch.setattr(control_constraints, "RADIUS_m", 0.005)
    monkeypatch.setattr(control_constraints, "INSERTION_m", 0.01)
    for case in ("rcm S", "rcm_elbow I", "fixture I", "decoupled S"):
        values = numbers(case)
        judged = limits(case)
        assert judged
        assert all(0.0 < values[name] <= judged[name] for name in judged), values

    assert numbers("fixture S")["no_fixture_error_max_mm"] > 10.0


@pytest.mark.slow
def test_published_recursion_loses_the_insertion_to_posture(monkeypatch):
    """The published recursion loses the insertion to the posture below."""
    monkeypatch.setattr(control_constraints, "INSERTION_m", 0.02)
    ours_mm = numbers("fixture S")["fixture_travel_mm"]
    published_mm = numbers("fixture_published S")["fixture_travel_mm"]

    assert published_mm < 2.0 < 18.0 < ours_mm


@pytest.mark.slow
def test_kinematic_error_shows_where_shared_kinematics_hide_it():
    shared = numbers("decoupled S")["turn_tip_error_mm_per_rad"]
    displaced = numbers("decoupled_kinematic S")["turn_tip_error_mm_per_rad"]

    assert displaced > 5.0 * shared


def test_every_constraint_is_measured_with_both_servos():
    assert len(CASES) == len(set(CASES)) == 20
