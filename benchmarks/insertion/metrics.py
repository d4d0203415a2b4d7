"""Every number of an identification: ruptures, friction, forces."""

import math

import numpy as np
from numpy.typing import NDArray

from benchmarks.insertion.methods import Identified
from benchmarks.insertion.offline import offline_fit, offline_metrics
from benchmarks.insertion.ruptures import (
    Matching,
    friction_metrics,
    is_visible,
    layer_frictions,
    match,
)
from benchmarks.insertion.signals import InsertionTruth
from benchmarks.jobs import Figure, make_figures
from foundation.arrays import Array


def measure_identification(item: Identified, truth: InsertionTruth) -> list[Figure]:
    """Measure one method on one signal.

    What the models can explain offline depends on neither method nor estimated force:
    it is stated once, on the F/T reading.
    """
    values = event_metrics(item, truth) | enhanced_metrics(item, truth)
    values |= coverage_metrics(item, truth)
    values |= before_rupture_metrics(item, truth)
    # Table I: one layer that ruptures, and no membrane.
    if [rupture.layer for rupture in truth.ruptures] == [1]:
        values |= table_one(item, truth)
    if (item.source, item.method) == ("ft", "ours"):
        values |= offline_metrics(item.signal, truth)
    return make_figures(values, item.source, item.method)


def event_metrics(item: Identified, truth: InsertionTruth) -> dict[str, float]:
    """Return the numbers of ruptures and friction by name."""
    values = rupture_metrics(match(truth.ruptures, item.alarms), truth)
    values |= friction_metrics(layer_frictions(truth.ruptures, item.alarms))
    online = layer_frictions(truth.ruptures, item.alarms, online=True)
    return values | friction_metrics(online, "_online")


def rupture_metrics(matching: Matching, truth: InsertionTruth) -> dict[str, float]:
    """Return the numbers of one insertion by name.

    What does not exist in it has no entry. Recall over ruptures and over soft
    transitions. Precision: the fraction of alarms that belong to either; nan without an
    alarm, since then it is undefined. Medians over the ruptures found: alarm after
    onset, error of the estimated time, travel from onset to alarm.
    """
    found, not_found, false = matching
    hard = [pair for pair in found if is_visible(pair[0])]
    missed = [rupture for rupture in not_found if is_visible(rupture)]
    soft_found = len(found) - len(hard)
    soft = soft_found + len(not_found) - len(missed)
    alarms = len(found) + len(false)
    values = {
        "rupture_precision": len(found) / alarms if alarms else math.nan,
        "false_alarms": float(len(false)),
    }
    if hard or missed:
        values["rupture_recall"] = len(hard) / (len(hard) + len(missed))
    if soft:
        values["soft_transition_recall"] = soft_found / soft
    if hard:
        delay = [alarm.alarm_s - rupture.onset_s for rupture, alarm in hard]
        timing = [abs(alarm.rupture_s - rupture.onset_s) for rupture, alarm in hard]
        travel = [
            truth.depth_m[alarm.sample] - rupture.onset_m for rupture, alarm in hard
        ]
        values["rupture_delay_ms"] = 1e3 * float(np.median(delay))
        values["rupture_delay_worst_ms"] = 1e3 * max(delay)
        values["rupture_timing_error_ms"] = 1e3 * float(np.median(timing))
        values["detection_depth_error_mm"] = 1e3 * float(np.median(travel))
    return values


def table_one(identified: Identified, truth: InsertionTruth) -> dict[str, float]:
    """Return the cumulative friction B d of the one layer in Ns/m, as in Table I.

    True: friction over speed at the rupture. Offline: equation (6) with the multi-layer
    model on the insertion, rupture known. Online: as the method states it in the end,
    the sum over its layers, each at the speed of its rupture.
    """
    rupture = truth.ruptures[0]
    speed = float(np.interp(rupture.onset_s, truth.t_s, truth.speed_m_s))
    offline = offline_fit(identified.signal, truth).layers[0]
    layers = [alarm.layer for alarm in identified.alarms if alarm.layer is not None]
    return {
        "cumulative_friction_true_Ns_per_m": rupture.layer_friction_N / speed,
        "cumulative_friction_offline_Ns_per_m": offline.cumulative_friction_Ns_per_m,
        "cumulative_friction_online_Ns_per_m": sum(
            layer.friction_N / max(layer.rupture.speed_m_s, 1e-9) for layer in layers
        ),
    }


ADVANCING_m_s = 1e-4
"""Below this speed the needle rests."""


def enhanced_metrics(identified: Identified, truth: InsertionTruth) -> dict[str, float]:
    """Measure enhanced and tip force; what does not exist has no entry.

    Errors count from the first compensation to the deepest point; a method that never
    compensates is judged from the true exit of the first layer on, with what it calls
    enhanced force.
    """
    values: dict[str, float] = {}
    after = truth.is_insertion[identified.start :].copy()
    is_identified = [
        estimate.identified_layer is not None
        for estimate in identified.result.estimates
    ]
    if True in is_identified:
        after[: is_identified.index(True)] = False
    else:
        exits = (rupture.end_s for rupture in truth.ruptures if rupture.layer > 0)
        after &= truth.t_s[identified.start :] > next(exits, math.inf)
    enhanced = identified.series("enhanced_force_N")
    if after.any():
        for name, estimate, true in (
            ("enhanced_rmse_N", enhanced, truth.enhanced_N),
            ("tip_rmse_N", identified.series("tip_force_N"), truth.tip_N),
        ):
            error = (estimate - true[identified.start :])[after]
            values[name] = float(np.sqrt(np.mean(error**2)))
    beyond = beyond_last_exit(truth)[identified.start :]
    if beyond.any():
        plateau = float(np.mean(np.abs(truth.axial_N[identified.start :][beyond])))
        values["remaining_force_pct"] = (
            100.0 * float(np.mean(np.abs(enhanced[beyond]))) / plateau
        )
    return values


def coverage_metrics(identified: Identified, truth: InsertionTruth) -> dict[str, float]:
    """Return whether the deviations of tip force and shaft friction are right.

    How often each lies within twice its deviation, and the rms deviation over the rms
    error: a deviation that is too wide covers everything. From first contact to the
    deepest point, moving and at rest apart; there is no entry where the needle never
    rests, or where the method states no deviation.
    """
    inside = truth.is_insertion[identified.start :]
    speed_m_s = truth.speed_m_s[identified.start :]
    parts = {
        "moving": inside & (speed_m_s > ADVANCING_m_s),
        "at_rest": inside & (np.abs(speed_m_s) <= ADVANCING_m_s),
    }
    quantities = {
        "tip": ("tip_force", truth.tip_N),
        "shaft": ("shaft_friction", truth.axial_N - truth.tip_N),
    }
    values: dict[str, float] = {}
    for quantity, (name, true_N) in quantities.items():
        std_N = identified.series(f"{name}_std_N")
        error_N = identified.series(f"{name}_N") - true_N[identified.start :]
        is_stated = np.isfinite(std_N)
        for part, samples in parts.items():
            judged = samples & is_stated
            if judged.any():
                is_covered = np.abs(error_N) <= 2.0 * std_N
                covered = f"{quantity}_coverage_{part}_2sigma"
                values[covered] = float(np.mean(is_covered[judged]))
                ratio = f"{quantity}_std_ratio_{part}"
                values[ratio] = _rms(std_N[judged]) / _rms(error_N[judged])
    return values


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def before_rupture_metrics(
    identified: Identified, truth: InsertionTruth
) -> dict[str, float]:
    """Measure the enhanced force in the last second before each visible rupture.

    In a second a needle at 2 mm/s presses the tissue in visibly. Its rms error over all
    of them, and its largest fall within 0.3 s while the truth rises: a puncture that a
    hand would feel and that is none. There are no entries without a visible rupture.
    """
    t_s = truth.t_s[identified.start :]
    enhanced_N = identified.series("enhanced_force_N")
    true_N = truth.enhanced_N[identified.start :]
    errors_N: list[Array] = []
    fall_N = 0.0
    for rupture in filter(is_visible, truth.ruptures):
        begin, end = np.searchsorted(t_s, (rupture.onset_s - 1.0, rupture.onset_s))
        errors_N.append((enhanced_N - true_N)[begin:end])
        earlier = np.searchsorted(t_s, t_s[begin:end] - 0.3)
        is_rising = true_N[begin:end] > true_N[earlier]
        falls_N = (enhanced_N[earlier] - enhanced_N[begin:end])[is_rising]
        fall_N = max(fall_N, falls_N.max(initial=0.0))
    if not errors_N:
        return {}
    return {
        "enhanced_before_rupture_rmse_N": _rms(np.concatenate(errors_N)),
        "enhanced_false_fall_N": float(fall_N),
    }


def beyond_last_exit(truth: InsertionTruth) -> NDArray[np.bool_]:
    """Return which samples are past the last layer and advance, shape (n,)."""
    exits_s = [rupture.end_s for rupture in truth.ruptures]
    end = int(np.searchsorted(truth.t_s, exits_s[-1])) if exits_s else len(truth.t_s)
    if end >= len(truth.t_s) or truth.layer.max() <= truth.layer_friction_N.shape[1]:
        return np.zeros(len(truth.t_s), dtype=bool)
    # Both methods wait for 1 mm of travel before they compensate, and another is left
    # for their delay.
    is_clear = truth.depth_m > truth.depth_m[end] + 2e-3
    is_advancing = (truth.speed_m_s > ADVANCING_m_s) & (
        truth.t_s <= truth.insertion_end_s
    )
    return is_clear & is_advancing
