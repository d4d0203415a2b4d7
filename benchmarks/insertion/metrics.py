"""Every identification number of one simulated insertion: ruptures, friction,
enhanced force.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from benchmarks.insertion.bounds import delay_bounds_s, friction_bounds, reading_error_N
from benchmarks.insertion.methods import (
    Alarm,
    Identified,
    cumulative_friction_Ns_per_m,
    force_lag_s,
    identify,
)
from benchmarks.insertion.signals import InsertionTruth, NeedleSignal
from benchmarks.results import Measurement, Method
from groundtruth import Rupture
from identification import (
    PUBLISHED,
    LayerEstimate,
    LayerSpan,
    OfflineIdentification,
    PublishedConfig,
    identify_offline,
)
from identification.config import Model

SPEED_WINDOW_s = 0.2
"""Over which the median of the speed is taken, centred, as one may offline: the models
are judged, not the noise of an arm's velocity, which B Δz would turn into force."""


def offline_metrics(signal: NeedleSignal, truth: InsertionTruth) -> dict[str, float]:
    """Rms residual of each model over the insertion [N], as in Figures 2 and 3."""
    models: tuple[Model, ...] = ("ml", "kv")
    return {f"offline_rmse_{m}_N": offline_fit(signal, truth, m).rmse_N for m in models}


def offline_fit(
    signal: NeedleSignal, truth: InsertionTruth, model: Model = "ml"
) -> OfflineIdentification:
    """Equation (6) on the insertion, from first contact to the deepest point."""
    inside = truth.is_insertion
    depth = signal.depth_m - np.interp(truth.contact_s, truth.t_s, signal.depth_m)
    columns = (truth.t_s, depth, quiet_speed_m_s(signal), signal.force_N)
    t_s, depth_m, speed_m_s, force_N = (each[inside] for each in columns)
    return identify_offline(t_s, depth_m, speed_m_s, force_N, layer_spans(truth), model)


def quiet_speed_m_s(signal: NeedleSignal) -> NDArray[np.float64]:
    """The speed without its noise, its steps as they are, shape (n,)."""
    samples = max(round(SPEED_WINDOW_s / float(np.median(np.diff(signal.t_s)))), 1)
    assert signal.speed_m_s is not None, "an arm or a motion gives the speed"
    return median_filter(signal.speed_m_s, samples + 1 - samples % 2, mode="nearest")


def layer_spans(truth: InsertionTruth) -> list[LayerSpan]:
    """The spans from first contact to the first rupture, and from each rupture to the
    next.

    A membrane on the surface thus has a span of its own, the fictitious layer of
    Section III-B. A layer that the tip is still in at the deepest point ends there.
    """
    inside = truth.is_insertion
    last = int(np.flatnonzero(inside)[-1])
    # An arm that lags may break through after its path has ended: that is not in the
    # data.
    found = [rupture for rupture in truth.ruptures if rupture.onset_s < truth.t_s[last]]
    ends = [(rupture.onset_s, rupture.onset_m) for rupture in found]
    if truth.layer[last] <= truth.layer_friction_N.shape[1]:
        ends.append((float(truth.t_s[last]), float(truth.depth_m[inside].max())))
    starts = [(truth.contact_s, 0.0), *ends[:-1]]
    return [
        LayerSpan(
            start_s=start_s,
            start_depth_m=start_m,
            thickness_m=end_m - start_m,
            rupture_s=end_s,
        )
        for (start_s, start_m), (end_s, end_m) in zip(starts, ends, strict=True)
    ]


SIGMA1_N = (0.03, 0.05, 0.08, 0.15)
"""Its authors set σ₁ for each recording: 0.08 N in the text, 0.03 to 0.15 N in their
settings."""


def identify_as_run(
    signal: NeedleSignal,
    truth: InsertionTruth,
    commanded_m_s: NDArray[np.float64],
    method: Method = "published-as-run",
    config: PublishedConfig = PUBLISHED,
) -> Identified:
    """The published method as its authors ran it: commanded speed, shape (n,), and the
    best σ₁.

    Best is the one with most ruptures found less false alarms, which they saw in the
    force.
    """
    quiet = replace(signal, speed_m_s=commanded_m_s)
    tried = [
        identify(quiet, truth, method, replace(config, sigma1_N=each))
        for each in SIGMA1_N
    ]

    def merit(item: Identified) -> int:
        matching = match(truth.ruptures, item.alarms)
        return len(matching.found) - len(matching.false)

    return max(tried, key=merit)


def measure_identification(
    item: Identified, truth: InsertionTruth
) -> Iterator[Measurement]:
    """Measure one method on one signal.

    What the models can explain offline depends on neither method nor estimated force:
    it is stated once, on the F/T reading.
    """
    values = event_metrics(item, truth) | enhanced_metrics(item, truth)
    # Table I: one layer that ruptures, and no membrane.
    if [rupture.layer for rupture in truth.ruptures] == [1]:
        values |= table_one(item, truth)
    if (item.source, item.method) == ("ft", "ours"):
        values |= offline_metrics(item.signal, truth)
    if item.method == "ours":
        values |= bound_metrics(item.signal, truth)
    for name, value in values.items():
        yield Measurement(item.source, item.method, name, value)


def event_metrics(item: Identified, truth: InsertionTruth) -> dict[str, float]:
    """Numbers of ruptures and friction by name."""
    values = rupture_metrics(match(truth.ruptures, item.alarms), truth)
    values |= friction_metrics(layer_frictions(truth.ruptures, item.alarms))
    online = layer_frictions(truth.ruptures, item.alarms, online=True)
    return values | friction_metrics(online, "_online")


VISIBLE_N = 0.15
"""A true transition counts as a rupture when the true force drops by more than this,
whatever the noise of who looks for it; below it is a soft transition. The least drop of
ruptures in real liver (0.15 to 1.4 N); half that of the 25 % gel, the softest of the
published tissues."""
EARLY_s = 0.2
"""An alarm may come this much before the onset: a derivative criterion sees the force
level off before it drops."""
LATE_s = 1.5
"""It may come this much after the onset: the longest release takes 0.25 s (0.5 mm at 2
mm/s), the published virtual sensor (K = 5/s) needs three lags of 0.2 s to show nine
tenths of it, and as much again is left to the method. True onsets are 1.25 s apart at
the least in drawn stacks without membranes (10 mm at 8 mm/s), so where windows overlap
the nearest onset decides."""


def is_visible(rupture: Rupture) -> bool:
    """Whether a true transition counts as a rupture."""
    return rupture.visible_drop_N > VISIBLE_N


class Matching(NamedTuple):
    """True transitions matched with reported ruptures.

    Attributes:
        found: Pairs of a true rupture and its alarm, in the order of the ruptures.
        missed: True ruptures without an alarm.
        false: Alarms without a true rupture.
    """

    found: tuple[tuple[Rupture, Alarm], ...]
    missed: tuple[Rupture, ...]
    false: tuple[Alarm, ...]


def match(ruptures: Sequence[Rupture], alarms: Sequence[Alarm]) -> Matching:
    """Give each alarm to at most one true rupture and the other way round, nearest
    first.

    An alarm may belong to a rupture when it lies within `EARLY_s` before and `LATE_s`
    after its onset.
    """
    onsets_s = [rupture.onset_s for rupture in ruptures]
    pairs = nearest_pairs(
        onsets_s, [alarm.alarm_s for alarm in alarms], EARLY_s, LATE_s
    )
    taken = set(pairs.values())
    return Matching(
        found=tuple((ruptures[i], alarms[pairs[i]]) for i in sorted(pairs)),
        missed=tuple(rupture for i, rupture in enumerate(ruptures) if i not in pairs),
        false=tuple(alarm for j, alarm in enumerate(alarms) if j not in taken),
    )


def nearest_pairs(
    true: Sequence[float], found: Sequence[float], before: float, after: float
) -> dict[int, int]:
    """Index of the found value that belongs to each true one; those without are left
    out.

    A found value is at most so much before or after the true one, and belongs to one
    true value at most, nearest first.
    """
    candidates = sorted(
        (abs(value - wanted), i, j)
        for i, wanted in enumerate(true)
        for j, value in enumerate(found)
        if -before <= value - wanted <= after
    )
    pairs: dict[int, int] = {}
    for _, i, j in candidates:
        if i not in pairs and j not in pairs.values():
            pairs[i] = j
    return pairs


def rupture_metrics(matching: Matching, truth: InsertionTruth) -> dict[str, float]:
    """Numbers of one insertion by name; what does not exist in it has no entry.

    Recall over ruptures and over soft transitions. Precision: the fraction of alarms
    that belong to either; nan without an alarm, since then it is undefined. Medians
    over the ruptures found: alarm after onset, error of the estimated time, travel from
    onset to alarm.
    """
    hard = [pair for pair in matching.found if is_visible(pair[0])]
    missed = [rupture for rupture in matching.missed if is_visible(rupture)]
    soft_found = len(matching.found) - len(hard)
    soft = soft_found + len(matching.missed) - len(missed)
    alarms = len(matching.found) + len(matching.false)
    values = {
        "rupture_precision": len(matching.found) / alarms if alarms else math.nan,
        "false_alarms": float(len(matching.false)),
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
        values["rupture_timing_error_ms"] = 1e3 * float(np.median(timing))
        values["detection_depth_error_mm"] = 1e3 * float(np.median(travel))
    return values


class LayerFriction(NamedTuple):
    """Friction of one layer at its rupture.

    Attributes:
        true_N: On the shaft.
        estimated_N: estimated; 0 when its rupture was missed.
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
    ruptures: Sequence[Rupture], alarms: Sequence[Alarm], *, online: bool = False
) -> list[LayerFriction]:
    """Pair every layer with what was identified of it, at the end or, `online`, in the
    next layer.

    A layer ends at its rupture. What is identified by alarms since the layer before it
    (a surface membrane's, a false one's) counts for it: that much friction was taken
    off the force. A layer that ends softly counts together with the one after it, since
    the force does not separate them; one whose rupture was missed counts as estimated
    at zero.
    """
    found: list[LayerFriction] = []
    true_N = 0.0
    begin_s = -math.inf
    for k, rupture in enumerate(ruptures):
        true_N += rupture.layer_friction_N
        if rupture.layer == 0 or not is_visible(rupture):
            continue
        following = (
            ruptures[k + 1].onset_s - EARLY_s if k + 1 < len(ruptures) else math.inf
        )
        until_s = max(min(rupture.onset_s + LATE_s, following), rupture.end_s)
        mine = [alarm for alarm in alarms if begin_s < alarm.alarm_s <= until_s]
        was_seen = any(alarm.alarm_s >= rupture.onset_s - EARLY_s for alarm in mine)
        known = [alarm.online if online else alarm.layer for alarm in mine]
        found.append(_layer_friction(true_N, known if was_seen else []))
        if was_seen:
            begin_s = until_s
        true_N = 0.0
    return found


def _layer_friction(
    true_N: float, found: Sequence[LayerEstimate | None]
) -> LayerFriction:
    layers = [layer for layer in found if layer is not None]
    known = [
        layer.friction_std_N for layer in layers if layer.friction_std_N is not None
    ]
    is_stated = bool(layers) and len(known) == len(layers)
    std_N = math.hypot(*known) if is_stated else math.nan
    return LayerFriction(true_N, sum(layer.friction_N for layer in layers), std_N)


def friction_metrics(
    frictions: Sequence[LayerFriction], when: str = ""
) -> dict[str, float]:
    """Worst and mean relative error, and whether the stated standard deviations are
    right.

    `when` is part of the names: ``_online`` for what was known in the layer after. The
    coverage is the fraction of layers within twice the stated standard deviation;
    layers that were not identified state none and do not count there.
    """
    if not frictions:
        return {}
    errors = [100.0 * layer.error for layer in frictions]
    values = {
        f"friction_error{when}_worst_pct": max(errors),
        f"friction_error{when}_mean_pct": float(np.mean(errors)),
    }
    stated = [layer for layer in frictions if not math.isnan(layer.std_N)]
    if stated:
        inside = [
            abs(layer.estimated_N - layer.true_N) <= 2.0 * layer.std_N
            for layer in stated
        ]
        values[f"friction_coverage{when}_2sigma"] = float(np.mean(inside))
    return values


def table_one(identified: Identified, truth: InsertionTruth) -> dict[str, float]:
    """Cumulative friction B d of the one layer in Ns/m, by name, as in Table I.

    True: friction over speed at the rupture. Offline: equation (6) with the multi-layer
    model on the insertion, rupture known. Online: as the method states it in the end.
    """
    rupture = truth.ruptures[0]
    speed = float(np.interp(rupture.onset_s, truth.t_s, truth.speed_m_s))
    offline = offline_fit(identified.signal, truth).layers[0]
    return {
        "cumulative_friction_true_Ns_per_m": rupture.layer_friction_N / speed,
        "cumulative_friction_offline_Ns_per_m": offline.cumulative_friction_Ns_per_m,
        "cumulative_friction_online_Ns_per_m": cumulative_friction_Ns_per_m(
            identified.alarms
        ),
    }


CLEAR_m = 2e-3
"""Beyond the end of the last release: both methods wait for 1 mm of travel before they
compensate, and another is left for their delay."""
ADVANCING_m_s = 1e-4
"""Below this speed the needle rests."""


def enhanced_metrics(identified: Identified, truth: InsertionTruth) -> dict[str, float]:
    """Enhanced and tip force against the true ones; what does not exist has no entry.

    Errors count from the first compensation to the deepest point; a method that never
    compensates is judged from the true exit of the first layer on, with what it calls
    enhanced force.
    """
    values: dict[str, float] = {}
    after = truth.is_insertion[identified.start :].copy()
    is_identified = [
        each.identified_layer is not None for each in identified.result.estimates
    ]
    if True not in is_identified:
        exits = (rupture.end_s for rupture in truth.ruptures if rupture.layer > 0)
        after &= truth.t_s[identified.start :] > next(exits, math.inf)
    else:
        after[: is_identified.index(True)] = False
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


def beyond_last_exit(truth: InsertionTruth) -> NDArray[np.bool_]:
    """Samples past the last layer while the needle advances, shape (n,)."""
    exits_s = [rupture.end_s for rupture in truth.ruptures]
    end = int(np.searchsorted(truth.t_s, exits_s[-1])) if exits_s else len(truth.t_s)
    if end >= len(truth.t_s) or truth.layer.max() <= truth.layer_friction_N.shape[1]:
        return np.zeros(len(truth.t_s), dtype=bool)
    is_clear = truth.depth_m > truth.depth_m[end] + CLEAR_m
    is_advancing = (truth.speed_m_s > ADVANCING_m_s) & (
        truth.t_s <= truth.insertion_end_s
    )
    return is_clear & is_advancing


MEAN_ABSOLUTE = float(np.sqrt(2.0 / np.pi))
"""Of a standard normal variable: the mean error of an estimator that reaches its
bound."""


def bound_metrics(signal: NeedleSignal, truth: InsertionTruth) -> dict[str, float]:
    """Least errors that the noise of a reading allows, by name; nothing without
    ruptures.
    """
    visible = [rupture for rupture in truth.ruptures if is_visible(rupture)]
    lag_s = 0.0
    if signal.source == "virtual":
        lag_s = max(force_lag_s(truth.t_s, signal.force_N, truth.axial_N), 0.0)
    error = reading_error_N(signal, truth, lag_s)
    exits = [rupture for rupture in truth.ruptures if rupture.layer > 0]
    counts = [rupture in visible for rupture in exits]
    values: dict[str, float] = {}
    for name, is_white in (("", False), ("_white", True)) if any(counts) else ():
        bounds = np.array(friction_bounds(truth, error, is_white=is_white))[counts]
        values[f"friction_bound{name}_pct"] = (
            100.0 * MEAN_ABSOLUTE * float(np.mean(bounds))
        )
    delays = delay_bounds_s(truth, visible, error, lag_s) if visible else []
    finite = [delay for delay in delays if delay < math.inf]
    if finite:
        values["rupture_delay_bound_ms"] = 1e3 * float(np.median(finite))
    return values
