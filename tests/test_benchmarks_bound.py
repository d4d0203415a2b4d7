"""Bounds of friction and delay, on cases whose answer is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from benchmark_rows import make_row

from benchmarks.bound_study import ForceNoiseSeries, bound_cases, case_table
from benchmarks.bounds import (
    INTERVAL_s,
    MEASURED_m,
    ONSET_m,
    autocovariance,
    delay_bounds_s,
    evidence_nats,
    friction_bounds,
    least_delay_s,
    reading_error_N,
    release_course_N,
    whitener,
)
from benchmarks.identification_metrics import bound_metrics
from benchmarks.signals import NeedleSignal, lagging, insertion_truth
from benchmarks.tables import TABLES
from groundtruth import SCENARIOS, Scenario, insert_needle
from groundtruth.motion import constant_motion
from identification import MULTILAYER

RNG = np.random.default_rng(3)
WHITE = 0.01 * RNG.standard_normal(8000)
DRIFTING = lagging(10.0 * WHITE, 1e-3 * np.arange(8000), 0.2)
GEL = SCENARIOS["gel-50-constant"].layers[0]


def stack(release_m=0.3e-3, thickness_m=14e-3):
    layer = replace(GEL, release_m=release_m, thickness_m=thickness_m)
    motion = constant_motion(speed_m_s=4e-3, depth_m=2.0 * thickness_m + 11e-3, standoff_m=5e-3)
    chosen = Scenario(id="two", title="two gels", layers=(layer, layer), motion=motion)
    return insert_needle(chosen, noise="clean")


@pytest.fixture(scope="module")
def truth():
    return insertion_truth(stack())


def signal(truth, error_N):
    force = truth.axial_N + np.resize(error_N, truth.t_s.shape)
    return NeedleSignal(
        source="ft",
        t_s=truth.t_s,
        depth_m=truth.depth_m,
        speed_m_s=truth.speed_m_s,
        force_N=force,
    )


def test_the_error_of_a_reading_is_its_noise_but_for_the_releases(truth):
    error = reading_error_N(signal(truth, WHITE), truth)
    added = np.resize(WHITE, truth.t_s.shape)[truth.is_insertion]
    assert len(error) == len(added)
    assert np.mean(np.isclose(error, added)) > 0.9
    assert np.std(error) == pytest.approx(np.std(added), rel=0.05)


def test_a_lag_of_the_sensor_is_no_noise(truth):
    late = replace(signal(truth, [0.0]), force_N=lagging(truth.axial_N, truth.t_s, 0.02))
    assert np.std(reading_error_N(late, truth)) > 1e-4
    assert np.abs(reading_error_N(late, truth, 0.02)).max() < 1e-12


def test_an_autocovariance_belongs_to_a_covariance():
    found = autocovariance(WHITE, 50)
    assert found[0] == pytest.approx(np.mean(WHITE**2))
    assert np.abs(found[1:]).max() < 0.1 * found[0]
    assert autocovariance(np.ones(10), 12)[-2:].tolist() == [0.0, 0.0]
    factor = whitener(autocovariance(DRIFTING, 200))
    assert np.all(np.diag(factor) > 0.0)
    assert (factor @ factor.T)[0, 5] == pytest.approx(autocovariance(DRIFTING, 6)[5])


def test_white_noise_of_twice_the_size_doubles_the_bound_of_friction(truth):
    # Small noise: what is drawn adds nothing then.
    one, two = (friction_bounds(truth, k * WHITE, is_white=True) for k in (0.01, 0.02))
    assert two == pytest.approx([2.0 * value for value in one], rel=0.02)


def test_the_bound_of_a_level_is_that_of_a_mean(truth):
    """Without cutting it is where a line meets the rupture, 2 s / sqrt(n); a bend costs more."""
    first = friction_bounds(truth, WHITE, is_white=True, cutting_fraction=0.0)[0]
    samples = 2.7e-3 / 4e-3 / 1e-3
    level = 2.0 * 0.01 / math.sqrt(samples) / truth.ruptures[0].layer_friction_N
    assert level < first < 2.0 * level


def test_friction_is_harder_to_know_with_drift_cutting_and_a_long_release(truth):
    plain = friction_bounds(truth, DRIFTING, is_white=True)[1]
    assert friction_bounds(truth, DRIFTING, is_white=False)[1] > 2.0 * plain
    assert friction_bounds(truth, DRIFTING, is_white=True, cutting_fraction=0.0)[1] < plain
    longer = insertion_truth(stack(release_m=1e-3))
    assert friction_bounds(longer, DRIFTING, is_white=True)[1] > plain


def test_evidence_of_a_step_in_white_noise_grows_evenly():
    factor = 0.1 * np.eye(6)
    course = np.array([0.0, 0.0, 0.2, 0.2, 0.2, 0.2])
    assert evidence_nats(course, factor) == pytest.approx([0.0, 0.0, 2.0, 4.0, 6.0, 8.0])


def test_the_least_delay_is_where_the_evidence_is_enough():
    delay = np.array([1.0, 2.0, 3.0])
    assert least_delay_s(np.array([1.0, 2.5, 9.0]), delay, interval_s=2.0 * math.e**2) == 2.0
    assert least_delay_s(np.array([1.0, 1.5, 1.7]), delay, interval_s=60.0) == math.inf


def test_the_course_of_a_release_falls_by_its_drop(truth):
    rupture = truth.ruptures[0]
    course = release_course_N(truth, rupture, 100)
    assert course[0] == pytest.approx(0.0, abs=0.03)
    assert course[-1] == pytest.approx(-rupture.drop_N, rel=0.15)
    unknown = replace(rupture, onset_s=-1.0)
    assert release_course_N(truth, unknown, 5).tolist() == [0.0] * 5


def test_noise_and_lag_delay_the_earliest_alarm(truth):
    quiet, loud = (delay_bounds_s(truth, truth.ruptures, k * WHITE) for k in (1.0, 5.0))
    late = delay_bounds_s(truth, truth.ruptures, WHITE, lag_s=0.02)
    assert len(quiet) == 2
    assert 1e-3 <= quiet[0] < loud[0] < 0.1
    assert quiet[0] < late[0]


def test_a_run_has_bounds_and_one_without_ruptures_has_none(truth):
    values = bound_metrics(signal(truth, WHITE), truth, 0.01)
    assert set(values) == {
        "friction_bound_pct",
        "friction_bound_white_pct",
        "rupture_delay_bound_ms",
    }
    assert all(0.0 < value < 20.0 for value in values.values())
    assert bound_metrics(signal(truth, WHITE), replace(truth, ruptures=()), 0.01) == {}


def test_bounds_stand_beside_what_was_reached():
    rows = [
        make_row(metric="friction_bound_pct", value=1.25),
        make_row(metric="friction_error_mean_pct", value=3.75),
        make_row(metric="rupture_delay_ms", value=5.5, method="published"),
    ]
    (line,) = TABLES["bounds"](rows).lines
    assert line[4:6] == ("1.25", "3.75")
    assert line[-1] == "5.5"
    assert TABLES["bounds"](rows[1:]).lines == ()


def test_the_command_has_a_line_for_every_change():
    noises = [ForceNoiseSeries("white", WHITE, is_white=True, lag_s=0.0)]
    cases = list(bound_cases(noises))
    table = case_table(cases, noises)
    heads = [line[0] for line in table.lines]
    assert len(heads) == len(cases) == 13
    assert {"release 0.1 mm", "speed 6 mm/s", "thickness 40 mm", "cutting up to 12 %"} < set(heads)
    by_change = {(case.changed, case.value): case for case in cases}
    assert by_change["release_m", 0.1e-3].friction_pct < by_change["release_m", 2e-3].friction_pct
    assert by_change["speed_m_s", 6e-3].delay_ms < by_change["speed_m_s", 2e-3].delay_ms


def test_the_bounds_are_of_the_settings_that_ours_has():
    assert MULTILAYER.final_window_m == MEASURED_m
    assert MULTILAYER.cutting_onset_m == ONSET_m
    assert MULTILAYER.false_alarm_interval_s == INTERVAL_s
