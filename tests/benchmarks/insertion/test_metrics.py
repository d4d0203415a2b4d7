"""Metrics of online identification, on small cases whose answer is known."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.insertion.methods import Alarm
from benchmarks.insertion.metrics import (
    before_rupture_metrics,
    coverage_metrics,
    enhanced_metrics,
    rupture_metrics,
)
from benchmarks.insertion.offline import offline_metrics
from benchmarks.insertion.ruptures import (
    LayerFriction,
    friction_metrics,
    is_visible,
    layer_frictions,
    match,
)
from benchmarks.insertion.signals import (
    InsertionTruth,
    NeedleSignal,
)
from groundtruth import Rupture
from groundtruth.rupture_match import EARLY_s, LATE_s

SPEED = 2e-3
T = np.arange(0.0, 20.0, 1e-2)
DEPTH = SPEED * (T - 2.0)


def rupture(onset_s, layer=1, drop_N=0.5, friction_N=0.4):
    return Rupture(
        onset_s=onset_s,
        end_s=onset_s + 0.1,
        onset_m=SPEED * (onset_s - 2.0),
        layer=layer,
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
    return Alarm(
        sample, alarm_s, alarm_s if rupture_s is None else rupture_s, layer, online
    )


def truth(*ruptures):
    """One layer of 10 mm, constant friction 0.4 N from its end on, at rest from 17 s
    on."""
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
        SimpleNamespace(
            rupture=None, identified_layer="layer" if k == compensated_at else None
        )
        for k in range(len(enhanced_N))
    ]
    return SimpleNamespace(
        start=len(T) - len(enhanced_N),
        series={"enhanced_force_N": enhanced_N, "tip_force_N": tip_N}.get,
        result=SimpleNamespace(estimates=estimates, layers=()),
    )


@pytest.mark.parametrize(
    ("ruptures", "alarms", "pairs"),
    [
        ([7.0], [7.0 - EARLY_s + 0.01], [(7.0, 7.0 - EARLY_s + 0.01)]),
        ([7.0], [7.0], [(7.0, 7.0)]),
        ([7.0], [7.0 + LATE_s - 0.01], [(7.0, 7.0 + LATE_s - 0.01)]),
        ([7.0], [7.0 - EARLY_s - 0.01], []),
        ([7.0], [7.0 + LATE_s + 0.01], []),
        ([7.0], [7.5, 7.1], [(7.0, 7.1)]),  # the nearer one counts, the other is false
        ([7.0, 7.4], [7.45], [(7.4, 7.45)]),  # one alarm does not find two ruptures
        ([7.0, 7.4], [7.05, 7.5], [(7.0, 7.05), (7.4, 7.5)]),
    ],
)
def test_an_alarm_belongs_to_one_rupture_in_window(ruptures, alarms, pairs):
    found, missed, false = match(list(map(rupture, ruptures)), list(map(alarm, alarms)))

    assert [(true.onset_s, report.alarm_s) for true, report in found] == pairs
    assert len(missed) == len(ruptures) - len(pairs)
    assert len(false) == len(alarms) - len(pairs)


def test_the_window_of_an_alarm_is_as_documented():
    assert (EARLY_s, LATE_s) == (0.2, 1.5)

    values = rupture_metrics(match([rupture(7.0)], [alarm(8.51)]), truth())

    assert (values["rupture_recall"], values["rupture_precision"]) == (0.0, 0.0)
    assert "rupture_delay_ms" not in values

    # Friction that is identified by such an alarm does not count for the layer either.
    (layer,) = layer_frictions([rupture(7.0)], [alarm(8.51, friction_N=0.4)])

    assert layer.estimated_N == 0.0


def test_delay_silence_and_false_alarms_are_counted():
    values = rupture_metrics(
        match([rupture(7.0)], [alarm(7.05, rupture_s=7.01)]), truth()
    )

    assert values["rupture_recall"] == values["rupture_precision"] == 1.0
    assert values["rupture_delay_ms"] == pytest.approx(50.0)
    assert values["rupture_delay_worst_ms"] == pytest.approx(50.0)
    assert values["rupture_timing_error_ms"] == pytest.approx(10.0)
    assert values["detection_depth_error_mm"] == pytest.approx(0.1, abs=0.03)

    two = match([rupture(7.0), rupture(11.0)], [alarm(7.05), alarm(11.2)])
    values = rupture_metrics(two, truth())

    assert values["rupture_delay_ms"] == pytest.approx(125.0)
    assert values["rupture_delay_worst_ms"] == pytest.approx(200.0)

    ruptures = [rupture(7.0), rupture(11.0, layer=2, drop_N=0.04)]
    missed = rupture_metrics(match(ruptures, [alarm(7.0)]), truth())

    assert (missed["rupture_recall"], missed["soft_transition_recall"]) == (1.0, 0.0)

    matched = rupture_metrics(match(ruptures, [alarm(7.0), alarm(11.0)]), truth())

    assert (matched["rupture_precision"], matched["soft_transition_recall"]) == (
        1.0,
        1.0,
    )

    values = rupture_metrics(match([rupture(7.0)], []), truth())

    assert values["rupture_recall"] == 0.0
    assert math.isnan(values["rupture_precision"])
    assert values["false_alarms"] == 0.0

    values = rupture_metrics(match([rupture(7.0)], [alarm(7.0), alarm(4.0)]), truth())

    assert values["rupture_precision"] == 0.5
    assert values["false_alarms"] == 1.0

    visible = [is_visible(rupture(7.0, drop_N=drop_N)) for drop_N in (0.15, 0.151)]

    assert visible == [False, True], "whatever the noise"


def test_layer_friction_is_judged_at_its_own_rupture():
    ruptures = [rupture(7.0, friction_N=0.4), rupture(11.0, layer=2, friction_N=0.2)]
    frictions = layer_frictions(
        ruptures, [alarm(7.1, 0.44, 0.01), alarm(11.1, 0.19, 0.01)]
    )

    assert [layer.error for layer in frictions] == pytest.approx([0.1, 0.05])

    values = friction_metrics(frictions)

    assert values["friction_error_worst_pct"] == pytest.approx(10.0)
    assert values["friction_error_mean_pct"] == pytest.approx(7.5)
    assert values["friction_coverage_2sigma"] == 0.5

    # What was known online is judged apart from what is known at the end.
    alarms = [alarm(7.1, 0.4, 0.01, online_N=0.5)]
    values = friction_metrics(
        layer_frictions([rupture(7.0)], alarms, online=True), "_online"
    )

    assert values["friction_error_online_worst_pct"] == pytest.approx(25.0)
    assert values["friction_coverage_online_2sigma"] == 0.0


def test_a_missed_layer_counts_as_zero_friction():
    ruptures = [rupture(7.0, friction_N=0.4), rupture(11.0, layer=2, friction_N=0.2)]
    frictions = layer_frictions(ruptures, [alarm(11.1, 0.6)])

    assert [layer.error for layer in frictions] == pytest.approx([1.0, 2.0])

    ruptures = [rupture(4.0, layer=0), rupture(7.0, friction_N=0.4)]
    (layer,) = layer_frictions(ruptures, [alarm(4.0, 0.1, 0.03), alarm(7.0, 0.3, 0.04)])

    assert (layer.true_N, layer.estimated_N) == (0.4, pytest.approx(0.4))
    assert layer.std_N == pytest.approx(0.05)

    # A layer with a soft end counts together with the next one, found or not.
    ruptures = [
        rupture(7.0, drop_N=0.01, friction_N=0.4),
        rupture(11.0, layer=2, friction_N=0.2),
    ]
    for alarms in ([alarm(11.0, 0.6)], [alarm(7.0, 0.4), alarm(11.0, 0.2)]):
        (layer,) = layer_frictions(ruptures, alarms)
        assert layer.error == pytest.approx(0.0)
    # Without stated deviations there is no coverage.
    values = friction_metrics([LayerFriction(0.4, 0.4, math.nan)])

    assert "friction_coverage_2sigma" not in values
    assert friction_metrics([]) == {}


def test_a_perfect_enhanced_force_leaves_no_remaining_force():
    true = truth()
    values = enhanced_metrics(
        identified(true.enhanced_N, true.tip_N, compensated_at=750), true
    )

    assert values == pytest.approx(
        {"enhanced_rmse_N": 0.0, "tip_rmse_N": 0.0, "remaining_force_pct": 0.0},
        abs=1e-12,
    )

    values = enhanced_metrics(identified(true.axial_N, true.axial_N), true)

    assert values["remaining_force_pct"] == pytest.approx(100.0)
    assert values["enhanced_rmse_N"] == pytest.approx(0.4)

    # Errors before the first compensation and after the insertion do not count.
    wild = np.where((T < 7.5) | (true.insertion_end_s < T), 9.0, 0.0)
    wild_force = identified(
        true.enhanced_N + wild, true.tip_N + wild, compensated_at=755
    )

    assert enhanced_metrics(wild_force, true)["enhanced_rmse_N"] == pytest.approx(
        0.0, abs=1e-12
    )


def test_a_fall_of_the_enhanced_force_before_a_rupture_is_found():
    true = replace(truth(), tip_N=0.1 * T, axial_N=0.1 * T)
    true = replace(true, layer_friction_N=np.zeros((len(T), 1)))
    right = before_rupture_metrics(identified(true.enhanced_N, None), true)

    assert right == {
        "enhanced_before_rupture_rmse_N": 0.0,
        "enhanced_false_fall_N": 0.0,
    }

    # Half a newton less from 0.5 s before the rupture on; the truth rises meanwhile.
    fallen = true.enhanced_N - np.where((T > 6.5) & (T < 7.0), 0.5, 0.0)
    values = before_rupture_metrics(identified(fallen, None), true)

    assert values["enhanced_false_fall_N"] == pytest.approx(0.5, abs=0.04)
    assert values["enhanced_before_rupture_rmse_N"] == pytest.approx(0.35, abs=0.01)

    # Where the truth falls too, a fall is right.
    falling = replace(true, axial_N=2.0 - 0.1 * T)
    fallen = falling.enhanced_N - np.where((T > 6.5) & (T < 7.0), 0.5, 0.0)
    values = before_rupture_metrics(identified(fallen, None), falling)

    assert values["enhanced_false_fall_N"] == 0.0


def test_deviations_are_compared_with_errors():
    true = truth()
    friction_N = true.axial_N - true.tip_N
    numbers = {
        "tip_force_N": true.tip_N + 0.1,
        "tip_force_std_N": np.full(len(T), 0.2),
        "shaft_friction_N": friction_N + 0.1,
        "shaft_friction_std_N": np.full(len(T), 0.04),
    }
    stated = SimpleNamespace(start=0, series=numbers.get)
    values = coverage_metrics(stated, true)

    assert values["tip_std_ratio_moving"] == pytest.approx(2.0)
    assert values["tip_coverage_moving_2sigma"] == 1.0
    assert values["shaft_std_ratio_at_rest"] == pytest.approx(0.4)
    assert values["shaft_coverage_at_rest_2sigma"] == 0.0


def signal(true, error_N=0.0, zero_m=0.0):
    """The true force with an error, and with the zero of depth where a user has it."""
    force_N = true.axial_N + np.resize(error_N, true.t_s.shape)
    depth_m = true.depth_m + zero_m
    speed_m_s = true.speed_m_s
    return NeedleSignal(
        source="ft", t_s=true.t_s, depth_m=depth_m, speed_m_s=speed_m_s, force_N=force_N
    )


def test_the_multilayer_model_fits_its_own_force_only():
    # The tip is free at 7 s already. Friction without speed, at rest, is in neither
    # model.
    true = replace(truth(rupture(6.995)), insertion_end_s=16.9)
    values = offline_metrics(signal(true, zero_m=4e-3), true)

    assert values["offline_rmse_ml_N"] == pytest.approx(0.0, abs=1e-9)
    assert values["offline_rmse_kv_N"] > 0.01
