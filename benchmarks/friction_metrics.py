"""Estimated shaft friction of each layer against the true one."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.bounds import delay_bounds_s, friction_bounds, reading_error_N
from benchmarks.force_metrics import force_lag_s
from benchmarks.methods import Alarm, Identified, cumulative_friction_Ns_per_m
from benchmarks.offline_fit import offline_fit
from benchmarks.rupture_metrics import EARLY_s, LATE_s, is_visible
from benchmarks.signals import InsertionTruth, NeedleSignal
from groundtruth import Rupture
from identification import LayerEstimate


class LayerFriction(NamedTuple):
    """Friction of one layer at its rupture.

    Attributes:
        true_N: On the shaft.
        estimated_N: Estimated; 0 when its rupture was missed.
        std_N: Stated standard deviation; nan when none is stated.
    """

    true_N: float
    estimated_N: float
    std_N: float

    @property
    def error(self) -> float:
        """Relative error."""
        return abs(self.estimated_N - self.true_N) / self.true_N


def layer_frictions(
    ruptures: Sequence[Rupture], alarms: Sequence[Alarm], noise_N: float, *, online: bool = False
) -> list[LayerFriction]:
    """Pair every layer with what was identified of it.

    A layer ends at its rupture. What is identified by alarms since the layer before it (a surface
    membrane's, a false one's) counts for it: that much friction was taken off the force. A layer
    that ends softly counts together with the one after it, for none can be blamed for not telling
    them apart; one whose rupture was missed counts as estimated at zero.

    Args:
        ruptures: True ones of the run, in order.
        alarms: Reported ones.
        noise_N: Of the source.
        online: Judge what was known in the layer after it, not what is known at the end.
    """
    found: list[LayerFriction] = []
    true_N, begin_s = 0.0, -math.inf
    for k, rupture in enumerate(ruptures):
        true_N += rupture.layer_friction_N
        if rupture.layer == 0 or not is_visible(rupture, noise_N):
            continue
        following = ruptures[k + 1].onset_s - EARLY_s if k + 1 < len(ruptures) else math.inf
        until_s = max(min(rupture.onset_s + LATE_s, following), rupture.end_s)
        mine = [alarm for alarm in alarms if begin_s < alarm.alarm_s <= until_s]
        was_seen = any(alarm.alarm_s >= rupture.onset_s - EARLY_s for alarm in mine)
        known = [alarm.online if online else alarm.layer for alarm in mine]
        found.append(_pair(true_N, known if was_seen else []))
        if was_seen:
            begin_s = until_s
        true_N = 0.0
    return found


def _pair(true_N: float, found: Sequence[LayerEstimate | None]) -> LayerFriction:
    layers = [layer for layer in found if layer is not None]
    stds = [layer.friction_std_N for layer in layers]
    known = [std for std in stds if std is not None]
    is_stated = bool(layers) and len(known) == len(stds)
    return LayerFriction(
        true_N=true_N,
        estimated_N=sum(layer.friction_N for layer in layers),
        std_N=math.hypot(*known) if is_stated else math.nan,
    )


def friction_metrics(frictions: Sequence[LayerFriction]) -> dict[str, float]:
    """Worst and mean relative error, and whether the stated doubts are fair.

    Returns:
        Numbers by name. The coverage is the share of layers within twice the stated standard
        deviation; layers that were not identified state none and do not count there.
    """
    if not frictions:
        return {}
    errors = [100.0 * layer.error for layer in frictions]
    values = {
        "friction_error_worst_pct": max(errors),
        "friction_error_mean_pct": float(np.mean(errors)),
    }
    stated = [layer for layer in frictions if not math.isnan(layer.std_N)]
    if stated:
        inside = [abs(layer.estimated_N - layer.true_N) <= 2.0 * layer.std_N for layer in stated]
        values["friction_coverage_2sigma"] = float(np.mean(inside))
    return values


def online_friction_metrics(frictions: Sequence[LayerFriction]) -> dict[str, float]:
    """The same numbers of what was known online, under names of their own."""
    names = {
        "friction_error_worst_pct": "friction_error_online_worst_pct",
        "friction_error_mean_pct": "friction_error_online_mean_pct",
        "friction_coverage_2sigma": "friction_coverage_online_2sigma",
    }
    return {names[name]: value for name, value in friction_metrics(frictions).items()}


# Table I: cumulative friction of a single gel, true, offline and online.


def table_one(
    signal: NeedleSignal, truth: InsertionTruth, identified: Identified
) -> dict[str, float]:
    """B d of the one layer in Ns/m, by name.

    True: friction over speed at the rupture. Offline: equation (6) with the multi-layer model on
    the insertion, rupture known. Online: as the method states it in the end.
    """
    rupture = truth.ruptures[0]
    speed = float(np.interp(rupture.onset_s, truth.t_s, truth.speed_m_s))
    online = cumulative_friction_Ns_per_m(identified.alarms)
    offline = offline_fit(signal, truth).layers[0]
    return {
        "cumulative_friction_true_Ns_per_m": rupture.layer_friction_N / speed,
        "cumulative_friction_offline_Ns_per_m": offline.cumulative_friction_Ns_per_m,
        "cumulative_friction_online_Ns_per_m": online,
    }


def is_single_gel(truth: InsertionTruth) -> bool:
    """Whether the table has a line for such a run: one layer that ruptures, and no membrane."""
    return len(truth.ruptures) == 1 and truth.ruptures[0].layer == 1


# What the noise of a reading would have allowed in one insertion, beside what was reached.


MEAN_ABSOLUTE = float(np.sqrt(2.0 / np.pi))
"""Of a standard normal variable: the mean error of an estimator that reaches its bound."""


def bound_metrics(signal: NeedleSignal, truth: InsertionTruth, noise_N: float) -> dict[str, float]:
    """Least errors by name; nothing for a run without ruptures.

    Args:
        signal: Reading of one source.
        truth: Of the run.
        noise_N: Of the source: it decides which transitions are ruptures.
    """
    visible = [rupture for rupture in truth.ruptures if is_visible(rupture, noise_N)]
    lag_s = 0.0
    if signal.source == "virtual":
        lag_s = max(force_lag_s(truth.t_s, signal.force_N, truth.axial_N), 0.0)
    error = reading_error_N(signal, truth, lag_s)
    values: dict[str, float] = {}
    if any(rupture.layer > 0 for rupture in visible):
        for name, is_white in (("", False), ("_white", True)):
            bounds = [
                bound
                for bound, rupture in zip(
                    friction_bounds(truth, error, is_white=is_white),
                    (item for item in truth.ruptures if item.layer > 0),
                    strict=True,
                )
                if rupture in visible
            ]
            values[f"friction_bound{name}_pct"] = 100.0 * MEAN_ABSOLUTE * float(np.mean(bounds))
    if visible:
        delays = [each for each in delay_bounds_s(truth, visible, error, lag_s) if each < math.inf]
        if delays:
            values["rupture_delay_bound_ms"] = 1e3 * float(np.median(delays))
    return values
