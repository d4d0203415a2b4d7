"""Metrics of online identification, on small cases whose answer is known."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.identification_metrics import (
    CLEAR_m,
    EARLY_s,
    LATE_s,
    LayerFriction,
    beyond_last_exit,
    enhanced_metrics,
    force_noise_N,
    friction_metrics,
    is_visible,
    layer_frictions,
    match,
    rupture_metrics,
)
from benchmarks.methods import Alarm, alarms_of, first_compensation
from benchmarks.offline_fit import layer_spans, offline_metrics
from benchmarks.signals import InsertionTruth, NeedleSignal
from groundtruth import Rupture

SPEED = 2e-3
T = np.arange(0.0, 20.0, 1e-2)
DEPTH = SPEED * (T - 2.0)


def rupture(onset_s, layer=1, drop_N=0.5, friction_N=0.4):
    return Rupture(
        onset_s=onset_s,
        end_s=onset_s + 0.1,
        onset_m=SPEED * (onset_s - 2.0),
        layer=layer,
        is_membrane=layer == 0,
        drop_N=drop_N,
        visible_drop_N=drop_N,
        layer_friction_N=friction_N if layer else 0.0,
        friction_N=friction_N,
    )


def alarm(alarm_s, friction_N=None, std_N=None, rupture_s=None, online_N=None):
    layer = online = None
    if friction_N is not None:
        layer = SimpleNamespace(friction_N=friction_N, friction_std_N=std_N)
    if online_N is not None:
        online = SimpleNamespace(friction_N=online_N, friction_std_N=std_N)
    sample = int(np.searchsorted(T, alarm_s))
    return Alarm(sample, alarm_s, alarm_s if rupture_s is None else rupture_s, layer, online)


def truth(*ruptures):
    """One layer of 10 mm, constant friction 0.4 N from its end on, at rest from 17 s on."""
    moving = T < 17.0
    friction = np.where(T >= 2.0, np.minimum(0.4, 40.0 * np.maximum(DEPTH, 0.0)), 0.0)
    tip = np.where((T >= 2.0) & (T < 7.0), 0.1 * (T - 2.0), 0.0)
    return InsertionTruth(
        t_s=T,
        depth_m=np.where(moving, DEPTH, SPEED * 15.0),
        speed_m_s=np.where(moving, SPEED, 0.0),
        axial_N=tip + friction,
        tip_N=tip,
        layer_friction_N=friction[:, None],
        layer=np.select([T < 2.0, T < 7.0], [0, 1], 2),
        ruptures=ruptures or (rupture(7.0),),
        tare_end_s=1.0,
        contact_s=2.0,
        insertion_end_s=18.0,
    )


def identified(enhanced_N, tip_N, compensated_at=None):
    estimates = [
        SimpleNamespace(rupture=None, identified_layer="layer" if k == compensated_at else None)
        for k in range(len(enhanced_N))
    ]
    return SimpleNamespace(
        start=len(T) - len(enhanced_N),
        enhanced_N=enhanced_N,
        tip_N=tip_N,
        result=SimpleNamespace(estimates=estimates, layers=()),
    )


# Matching.


@pytest.mark.parametrize("late", [-EARLY_s + 0.01, 0.0, LATE_s - 0.01])
def test_an_alarm_inside_the_window_belongs_to_the_rupture(late):
    assert len(match([rupture(7.0)], [alarm(7.0 + late)]).found) == 1


@pytest.mark.parametrize("late", [-EARLY_s - 0.01, LATE_s + 0.01, 1.6, 5.0])
def test_an_alarm_outside_is_false_and_the_rupture_missed(late):
    found = match([rupture(7.0)], [alarm(7.0 + late)])
    assert (len(found.found), len(found.missed), len(found.false)) == (0, 1, 1)


def test_the_window_of_an_alarm_is_the_documented_one():
    """In numbers: a window as long as one likes would find every rupture and no false alarm."""
    assert (EARLY_s, LATE_s) == (0.2, 1.5)
    values = rupture_metrics(match([rupture(7.0)], [alarm(8.51)]), truth(), 0.01)
    assert (values["rupture_recall"], values["rupture_precision"]) == (0.0, 0.0)
    assert "rupture_delay_ms" not in values
    # Friction that is identified by such an alarm does not count for the layer either.
    (layer,) = layer_frictions([rupture(7.0)], [alarm(8.51, friction_N=0.4)], 0.01)
    assert layer.estimated_N == 0.0


def test_a_second_alarm_for_one_rupture_is_false_and_the_nearer_one_counts():
    found = match([rupture(7.0)], [alarm(7.5), alarm(7.1)])
    assert found.found[0][1].alarm_s == 7.1
    assert [item.alarm_s for item in found.false] == [7.5]


def test_one_alarm_does_not_find_two_ruptures():
    found = match([rupture(7.0), rupture(7.4, layer=2)], [alarm(7.45)])
    assert found.found[0][0].layer == 2
    assert [item.layer for item in found.missed] == [1]


def test_close_ruptures_each_keep_their_alarm():
    found = match([rupture(7.0), rupture(7.4, layer=2)], [alarm(7.05), alarm(7.5)])
    assert [(pair[0].layer, pair[1].alarm_s) for pair in found.found] == [(1, 7.05), (2, 7.5)]


# Ruptures.


def test_a_perfect_detector_has_its_delay_and_nothing_else():
    values = rupture_metrics(match([rupture(7.0)], [alarm(7.05, rupture_s=7.01)]), truth(), 0.01)
    assert values["rupture_recall"] == values["rupture_precision"] == 1.0
    assert values["rupture_delay_ms"] == pytest.approx(50.0)
    assert values["rupture_timing_error_ms"] == pytest.approx(10.0)
    assert values["detection_depth_error_mm"] == pytest.approx(0.1, abs=0.03)
    assert "soft_transition_recall" not in values


def test_a_soft_transition_is_reported_apart_and_finding_it_is_no_false_alarm():
    both = [rupture(7.0), rupture(11.0, layer=2, drop_N=0.04)]
    missed = rupture_metrics(match(both, [alarm(7.0)]), truth(), 0.01)
    assert (missed["rupture_recall"], missed["soft_transition_recall"]) == (1.0, 0.0)
    found = rupture_metrics(match(both, [alarm(7.0), alarm(11.0)]), truth(), 0.01)
    assert (found["rupture_precision"], found["soft_transition_recall"]) == (1.0, 1.0)


def test_silence_has_no_recall_and_an_undefined_precision():
    values = rupture_metrics(match([rupture(7.0)], []), truth(), 0.01)
    assert values["rupture_recall"] == 0.0
    assert math.isnan(values["rupture_precision"])
    assert len(values) == 2


def test_false_alarms_cost_precision():
    values = rupture_metrics(match([rupture(7.0)], [alarm(7.0), alarm(4.0)]), truth(), 0.01)
    assert values["rupture_precision"] == 0.5


def test_visible_means_more_than_five_times_the_noise():
    assert not is_visible(rupture(7.0, drop_N=0.05), 0.01)
    assert is_visible(rupture(7.0, drop_N=0.051), 0.01)


def test_noise_is_what_the_reading_scatters_in_free_air_after_the_tare():
    true = truth()
    free = (true.tare_end_s < T) & (true.contact_s > T)
    reading = np.where(free, np.where(np.arange(len(T)) % 2, 0.03, -0.03), 50.0)
    assert force_noise_N(SimpleNamespace(force_N=reading), true) == pytest.approx(0.03, rel=0.01)


# Friction.


def test_the_friction_of_each_layer_is_judged_at_its_own_rupture():
    both = [rupture(7.0, friction_N=0.4), rupture(11.0, layer=2, friction_N=0.2)]
    found = layer_frictions(both, [alarm(7.1, 0.44, 0.01), alarm(11.1, 0.19, 0.01)], 0.01)
    assert [layer.error for layer in found] == pytest.approx([0.1, 0.05])
    values = friction_metrics(found)
    assert values["friction_error_worst_pct"] == pytest.approx(10.0)
    assert values["friction_error_mean_pct"] == pytest.approx(7.5)
    assert values["friction_coverage_2sigma"] == 0.5


def test_what_was_known_online_is_judged_apart_from_what_is_known_at_the_end():
    one = [alarm(7.1, 0.4, 0.01, online_N=0.5)]
    values = friction_metrics(layer_frictions([rupture(7.0)], one, 0.01, online=True), "_online")
    assert values["friction_error_online_worst_pct"] == pytest.approx(25.0)
    assert values["friction_coverage_online_2sigma"] == 0.0


def test_a_missed_layer_counts_as_estimated_at_zero_even_if_the_next_one_gets_its_friction():
    both = [rupture(7.0, friction_N=0.4), rupture(11.0, layer=2, friction_N=0.2)]
    found = layer_frictions(both, [alarm(11.1, 0.6)], 0.01)
    assert [layer.error for layer in found] == pytest.approx([1.0, 2.0])


def test_what_a_surface_membrane_was_given_counts_for_the_layer_below_it():
    both = [rupture(4.0, layer=0), rupture(7.0, friction_N=0.4)]
    (layer,) = layer_frictions(both, [alarm(4.0, 0.1, 0.03), alarm(7.0, 0.3, 0.04)], 0.01)
    assert (layer.true_N, layer.estimated_N) == (0.4, pytest.approx(0.4))
    assert layer.std_N == pytest.approx(0.05)


def test_a_layer_with_a_soft_end_counts_together_with_the_next_found_or_not():
    both = [rupture(7.0, drop_N=0.01, friction_N=0.4), rupture(11.0, layer=2, friction_N=0.2)]
    (missed,) = layer_frictions(both, [alarm(11.0, 0.6)], 0.01)
    (found,) = layer_frictions(both, [alarm(7.0, 0.4), alarm(11.0, 0.2)], 0.01)
    assert missed.error == pytest.approx(0.0)
    assert found.error == pytest.approx(0.0)


def test_without_stated_deviations_there_is_no_coverage():
    values = friction_metrics([LayerFriction(0.4, 0.4, math.nan)])
    assert "friction_coverage_2sigma" not in values
    assert friction_metrics([]) == {}


# Forces.


def test_a_perfect_enhanced_force_leaves_no_force_and_no_error():
    true = truth()
    values = enhanced_metrics(identified(true.enhanced_N, true.tip_N, compensated_at=750), true)
    assert values == pytest.approx(
        {"enhanced_rmse_N": 0.0, "tip_rmse_N": 0.0, "remaining_force_pct": 0.0}, abs=1e-12
    )


def test_no_compensation_leaves_the_whole_plateau():
    true = truth()
    values = enhanced_metrics(identified(true.axial_N, true.axial_N), true)
    assert values["remaining_force_pct"] == pytest.approx(100.0)
    assert values["enhanced_rmse_N"] == pytest.approx(0.4)


def test_errors_before_the_first_compensation_and_after_the_insertion_do_not_count():
    true = truth()
    wild = np.where((T < 7.5) | (true.insertion_end_s < T), 9.0, 0.0)
    found = identified(true.enhanced_N + wild, true.tip_N + wild, compensated_at=755)
    assert enhanced_metrics(found, true)["enhanced_rmse_N"] == pytest.approx(0.0, abs=1e-12)


def test_the_remaining_force_is_taken_clear_of_the_release_and_only_while_the_needle_advances():
    true = truth()
    times = T[beyond_last_exit(true)]
    assert times[0] == pytest.approx(7.1 + CLEAR_m / SPEED, abs=0.03)
    assert times[-1] < 17.0


def test_true_enhanced_force_loses_a_layers_friction_when_the_tip_leaves_it():
    true = truth()
    before, after = np.searchsorted(T, [6.9, 7.1])
    assert true.enhanced_N[before] == true.axial_N[before]
    assert true.enhanced_N[after] == pytest.approx(0.0)


# Offline.


def offline_signal(true):
    """The true force, with the zero of depth where a user has it: not at the surface."""
    return NeedleSignal(
        source="ft",
        t_s=T,
        depth_m=true.depth_m + 4e-3,
        speed_m_s=true.speed_m_s,
        force_N=true.axial_N,
    )


def test_the_multi_layer_model_fits_its_own_force_and_kelvin_voigt_does_not():
    # The tip is free at 7 s already. Friction without speed, at rest, is in neither model.
    true = replace(truth(rupture(6.995)), insertion_end_s=16.9)
    values = offline_metrics(offline_signal(true), true)
    assert values["offline_rmse_ml_N"] == pytest.approx(0.0, abs=1e-9)
    assert values["offline_rmse_kv_N"] > 0.01


def test_spans_run_from_contact_to_each_rupture_in_turn():
    first, second = layer_spans(truth(rupture(4.0, layer=0), rupture(7.0)))
    assert (first.start_s, first.start_depth_m, first.rupture_s) == (2.0, 0.0, 4.0)
    assert (second.start_s, second.rupture_s) == (4.0, 7.0)
    assert first.thickness_m + second.thickness_m == pytest.approx(10e-3)


def test_a_layer_the_tip_stays_in_ends_at_the_deepest_point():
    late = rupture(18.5)
    true = replace(truth(late), layer=np.where(T < 2.0, 0, 1))
    (span,) = layer_spans(true)
    assert span.rupture_s == pytest.approx(true.insertion_end_s)
    assert span.thickness_m == pytest.approx(SPEED * 15.0)


# Alarms on the run's clock.


def test_a_rupture_has_its_best_estimated_time_on_the_runs_clock():
    event = SimpleNamespace(alarm_s=0.03, time_s=0.03)
    better = SimpleNamespace(alarm_s=0.03, time_s=0.01)
    layer = SimpleNamespace(rupture=better)
    estimates = [
        SimpleNamespace(
            rupture=event if k == 2 else None, identified_layer=layer if k == 4 else None
        )
        for k in range(6)
    ]
    result = SimpleNamespace(estimates=estimates, layers=(layer,))
    (found,) = alarms_of(result, 5.0 + 0.01 * np.arange(6))
    assert (found.sample, found.layer) == (2, layer)
    assert found.alarm_s == pytest.approx(5.02)
    assert found.rupture_s == pytest.approx(5.0)
    assert first_compensation(result) == 4
