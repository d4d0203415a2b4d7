"""Every identification number of one simulated insertion."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.friction_metrics import (
    bound_metrics,
    friction_metrics,
    is_single_gel,
    layer_frictions,
    online_friction_metrics,
    table_one,
)
from benchmarks.methods import IDENTIFIERS, Identified, first_compensation, identify
from benchmarks.metric_catalogue import Measurement
from benchmarks.offline_fit import offline_metrics
from benchmarks.rows import Method
from benchmarks.rupture_metrics import force_noise_N, match, rupture_metrics
from benchmarks.signals import InsertionTruth, NeedleSignal

# The enhanced force and the tip force against the true ones.


CLEAR_m = 2e-3
"""Beyond the end of the last release: both methods wait for 1 mm of travel before they compensate,
and another is left for their delay."""
ADVANCING_m_s = 1e-4
"""Below this speed the needle rests."""


def enhanced_metrics(identified: Identified, truth: InsertionTruth) -> dict[str, float]:
    """Numbers of one insertion by name; what does not exist in it has no entry.

    Errors count from the first compensation to the deepest point; a method that never compensates
    is judged from the true exit of the first layer on, with what it calls enhanced force.
    """
    values: dict[str, float] = {}
    after = truth.is_insertion[identified.start :].copy()
    begin = first_compensation(identified.result)
    if begin is None:
        exits = [rupture.end_s for rupture in truth.ruptures if rupture.layer > 0]
        after &= truth.t_s[identified.start :] > (exits[0] if exits else np.inf)
    else:
        after[:begin] = False
    enhanced, tip = identified.enhanced_N, identified.tip_N
    if after.any():
        for name, estimate, true in (
            ("enhanced_rmse_N", enhanced, truth.enhanced_N),
            ("tip_rmse_N", tip, truth.tip_N),
        ):
            error = (estimate - true[identified.start :])[after]
            values[name] = float(np.sqrt(np.mean(error**2)))
    beyond = beyond_last_exit(truth)[identified.start :]
    if beyond.any():
        plateau = float(np.mean(np.abs(truth.axial_N[identified.start :][beyond])))
        values["exit_residue_pct"] = 100.0 * float(np.mean(np.abs(enhanced[beyond]))) / plateau
    return values


def beyond_last_exit(truth: InsertionTruth) -> NDArray[np.bool_]:
    """Samples past the last layer while the needle advances, shape (n,)."""
    none = np.zeros(len(truth.t_s), dtype=bool)
    if not truth.ruptures or truth.layer.max() <= truth.layer_friction_N.shape[1]:
        return none
    end = int(np.searchsorted(truth.t_s, truth.ruptures[-1].end_s))
    if end >= len(truth.t_s):
        return none
    is_clear = truth.depth_m > truth.depth_m[end] + CLEAR_m
    is_advancing = (truth.speed_m_s > ADVANCING_m_s) & (truth.t_s <= truth.insertion_end_s)
    return is_clear & is_advancing


Signals = dict[Method, NeedleSignal]
"""One source's signal for each method; a virtual force is the method's own."""


def identify_all(signals: Signals, truth: InsertionTruth) -> list[Identified]:
    """Both methods on one source."""
    return [identify(signals[method], truth, method) for method in IDENTIFIERS]


def identification_metrics(
    signals: Signals, identified: Sequence[Identified], truth: InsertionTruth
) -> Iterator[Measurement]:
    """Measure both methods on one source.

    The noise that decides which transitions count is that of our reading, for both methods: they
    are judged on the same list. What the models can explain offline is no matter of method or
    estimated force: it is stated once, on the F/T reading.
    """
    noise_N = force_noise_N(signals["default"], truth)
    for found in identified:
        matching = match(truth.ruptures, found.alarms)
        values = rupture_metrics(matching, truth, noise_N)
        at_last = layer_frictions(truth.ruptures, found.alarms, noise_N)
        online = layer_frictions(truth.ruptures, found.alarms, noise_N, online=True)
        values |= friction_metrics(at_last) | online_friction_metrics(online)
        values |= enhanced_metrics(found, truth)
        if is_single_gel(truth):
            values |= table_one(signals[found.method], truth, found)
        if (found.source, found.method) == ("ft", "default"):
            values |= offline_metrics(signals[found.method], truth)
        if found.method == "default":
            values |= bound_metrics(signals["default"], truth, noise_N)
        for name, value in values.items():
            yield Measurement(found.source, found.method, name, value)
