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
    layer_frictions,
    match,
)
from benchmarks.insertion.signals import (
    InsertionTruth,
    NeedleSignal,
)
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
        drop_N=drop_N,
        visible_drop_N=drop_N,
        layer_friction_N=friction_N if layer else 0.0,
        friction_N=friction_N,
    )


def alarm(alarm_s, friction_N=None, std_N=None, rupture_s=None, online_N=None):
    layer, online = (
        None if N is None else SimpleNamespace(friction_N=N, friction_std_N=std_N)
        for N in (friction_N, online_N)
    )
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
    return SimpleNamespace(
        start=len(T) - len(enhanced_N),
        series={"enhanced_force_N": enhanced_N, "tip_force_N": tip_N}.get,
        result=SimpleNamespace(
            estimates=[
                SimpleNamespace(
                    rupture=None,
                    identified_layer="layer" if k == compensated_at else None,
                )
                for k in range(len(enhanced_N))
            ],
            layers=(),
        ),
    )


@pytest.mark.parametrize(
    ("ruptures", "alarms", "pairs"),
    [
        ([7.0], [6.81], [(7.0, 6.81)]),
        ([7.0], [6.79], []),
        ([7.0], [8.49], [(7.0, 8.49)]),
        ([7.0], [8.51], []),
        ([7.0], [7.5, 7.1], [(7.0, 7.1)]),  # the nearer one counts, the other is false
        ([7.0, 7.4], [7.45], [(7.4, 7.45)]),  # one alarm does not find two ruptures
        ([7.0, 7.4], [7.05, 7.5], [(7.0, 7.05), (7.4, 7.5)]),
    ],
)
def test_an_alarm_belongs_to_one_rupture_in_its_window(ruptures, alarms, pairs):
    found, missed, false = match(list(map(rupture, ruptures)), list(map(alarm, alarms)))

    assert [(true.onset_s, report.alarm_s) for true, report in found] == pairs
    numbers = (len(found) + len(missed), len(found) + len(false))
    assert numbers == (len(ruptures), len(alarms))


SOFT = rupture(11.0, layer=2, drop_N=0.15)


@pytest.mark.parametrize(
    ("ruptures", "alarms", "numbers"),
    [
        (
            [rupture(7.0)],
            [alarm(7.05, rupture_s=7.01)],
            {
                "rupture_recall": 1.0,
                "rupture_precision": 1.0,
                "false_alarms": 0.0,
                "rupture_delay_ms": 50.0,
                "rupture_delay_worst_ms": 50.0,
                "rupture_timing_error_ms": 10.0,
                "detection_depth_error_mm": 0.1,
            },
        ),
        (
            [rupture(7.0), rupture(11.0, drop_N=0.151)],
            [alarm(7.05), alarm(11.2)],
            {"rupture_delay_ms": 125.0, "rupture_delay_worst_ms": 200.0},
        ),
        (
            [rupture(7.0), SOFT],
            [alarm(7.0), alarm(11.0)],
            {"soft_transition_recall": 1.0, "rupture_precision": 1.0},
        ),
        (
            [rupture(7.0), SOFT],
            [alarm(7.0), alarm(4.0)],
            {
                "rupture_recall": 1.0,
                "soft_transition_recall": 0.0,
                "rupture_precision": 0.5,
                "false_alarms": 1.0,
            },
        ),
        ([rupture(7.0)], [], {"rupture_recall": 0.0, "rupture_precision": math.nan}),
    ],
)
def test_ruptures_delays_and_false_alarms_are_counted(ruptures, alarms, numbers):
    values = rupture_metrics(match(ruptures, alarms), truth())
    chosen = {name: values[name] for name in numbers}

    assert chosen == pytest.approx(numbers, abs=1e-2, nan_ok=True)
    assert ("rupture_delay_ms" in values) == bool(alarms)


TWO = [rupture(7.0, friction_N=0.4), rupture(11.0, layer=2, friction_N=0.2)]
MEMBRANE = [rupture(4.0, layer=0), rupture(7.0, friction_N=0.4)]
SOFT_END = [rupture(7.0, drop_N=0.01, friction_N=0.4), TWO[1]]


@pytest.mark.parametrize(
    ("ruptures", "alarms", "errors"),
    [
        (TWO, [alarm(7.1, 0.44), alarm(11.1, 0.19)], [0.1, 0.05]),
        # A layer that was missed counts as zero, and one that was reported too late.
        (TWO, [alarm(11.1, 0.6)], [1.0, 2.0]),
        (TWO[:1], [alarm(8.51, 0.4)], [1.0]),
        # What a membrane's alarm took off the force counts for the layer below.
        (MEMBRANE, [alarm(4.0, 0.1), alarm(7.0, 0.3)], [0.0]),
        # A layer with a soft end counts together with the next one, found or not.
        (SOFT_END, [alarm(11.0, 0.6)], [0.0]),
        (SOFT_END, [alarm(7.0, 0.4), alarm(11.0, 0.2)], [0.0]),
    ],
)
def test_layer_friction_is_judged_at_its_own_rupture(ruptures, alarms, errors):
    frictions = layer_frictions(ruptures, alarms)

    assert [layer.error for layer in frictions] == pytest.approx(errors, abs=1e-9)


def test_friction_and_its_deviation_are_compared_with_the_truth():
    alarms = [alarm(7.1, 0.44, 0.01, online_N=0.5), alarm(11.1, 0.19, 0.01)]
    values = friction_metrics(layer_frictions(TWO, alarms))
    online = layer_frictions(TWO[:1], alarms[:1], online=True)
    (both,) = layer_frictions(MEMBRANE, [alarm(4.0, 0.1, 0.03), alarm(7.0, 0.3, 0.04)])

    assert values == pytest.approx(
        {
            "friction_error_worst_pct": 10.0,
            "friction_error_mean_pct": 7.5,
            "friction_coverage_2sigma": 0.5,
        }
    )
    # What was known online is judged apart from what is known at the end.
    worst_pct = friction_metrics(online, "_online")["friction_error_online_worst_pct"]
    assert (worst_pct, both.std_N) == pytest.approx((25.0, 0.05))
    assert "friction_coverage_2sigma" not in friction_metrics(
        [LayerFriction(0.4, 0.4, math.nan)]
    )
    assert friction_metrics([]) == {}


def test_enhanced_and_tip_force_count_from_the_first_compensation_on():
    true = truth()
    # Errors before the first compensation and after the insertion do not count.
    wild = np.where((T < 7.5) | (true.insertion_end_s < T), 9.0, 0.0)
    perfect = identified(true.enhanced_N + wild, true.tip_N + wild, compensated_at=755)
    nothing = identified(true.axial_N, true.axial_N)

    assert enhanced_metrics(perfect, true) == pytest.approx(
        {"enhanced_rmse_N": 0.0, "tip_rmse_N": 0.0, "remaining_force_pct": 0.0},
        abs=1e-12,
    )
    assert enhanced_metrics(nothing, true) == pytest.approx(
        {"enhanced_rmse_N": 0.4, "tip_rmse_N": 0.4, "remaining_force_pct": 100.0}
    )


@pytest.mark.parametrize(("slope", "fall_N"), [(0.1, 0.5), (-0.1, 0.0)])
def test_a_fall_of_the_enhanced_force_while_the_truth_rises_is_found(slope, fall_N):
    true = replace(
        truth(),
        tip_N=2.0 + slope * T,
        axial_N=2.0 + slope * T,
        layer_friction_N=np.zeros((len(T), 1)),
    )
    fallen_N = true.enhanced_N - np.where((T > 6.5) & (T < 7.0), 0.5, 0.0)
    values = before_rupture_metrics(identified(fallen_N, None), true)

    assert values == values | {
        "enhanced_false_fall_N": pytest.approx(fall_N, abs=0.04),
        "enhanced_before_rupture_rmse_N": pytest.approx(0.35, abs=0.01),
    }


def test_deviations_are_compared_with_errors():
    true = truth()
    numbers = {
        "tip_force_N": true.tip_N + 0.1,
        "tip_force_std_N": np.full(len(T), 0.2),
        "shaft_friction_N": true.axial_N - true.tip_N + 0.1,
        "shaft_friction_std_N": np.full(len(T), 0.04),
    }
    values = coverage_metrics(SimpleNamespace(start=0, series=numbers.get), true)

    assert values == values | {
        "tip_std_ratio_moving": pytest.approx(2.0),
        "tip_coverage_moving_2sigma": 1.0,
        "shaft_std_ratio_at_rest": pytest.approx(0.4),
        "shaft_coverage_at_rest_2sigma": 0.0,
    }


def test_the_multilayer_model_fits_its_own_force_only():
    # The tip is free at 7 s already. Friction without speed, at rest, is in neither
    # model. Depth has its zero where a user has it.
    true = replace(truth(rupture(6.995)), insertion_end_s=16.9)
    depth_m = true.depth_m + 4e-3
    signal = NeedleSignal("ft", true.t_s, depth_m, true.speed_m_s, true.axial_N)
    values = offline_metrics(signal, true)

    assert values["offline_rmse_ml_N"] == pytest.approx(0.0, abs=1e-9)
    assert values["offline_rmse_kv_N"] > 0.01
