"""Falls of the force that the benchmark of pulls makes."""

import pytest

from benchmarks.control.pulls import CASES, FALLS, PHASES, PUSH_S


@pytest.mark.parametrize("name", FALLS)
def test_no_fall_acts_before_it_begins(name):
    assert FALLS[name].at(-1e-3) == 0.0


def test_a_step_stays():
    step = FALLS["step -5 N"]
    assert step.at(0.0) == step.at(100.0) == -5.0


def test_a_drift_falls_evenly_and_then_stays():
    drift = FALLS["drift -5 N in 4 s"]
    assert drift.at(1.0) == pytest.approx(-1.25)
    assert drift.at(4.0) == drift.at(100.0) == -5.0


def test_a_hand_lets_go():
    push = FALLS["push 10 N"]
    assert push.at(0.5 * PUSH_S) == -10.0
    assert push.at(PUSH_S + 1e-3) == 0.0


def test_every_fall_is_tried_in_every_phase():
    assert len(CASES) == len(set(CASES)) == len(FALLS) * len(PHASES)
