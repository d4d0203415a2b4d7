"""Every identification number of one simulated insertion."""

from collections.abc import Iterator, Sequence

from benchmarks.methods.identified import IDENTIFIERS, Identified, identify
from benchmarks.methods.offline_fit import offline_metrics
from benchmarks.metrics.bound_metrics import bound_metrics
from benchmarks.metrics.enhanced_metrics import enhanced_metrics
from benchmarks.metrics.friction_metrics import (
    friction_metrics,
    layer_frictions,
    online_friction_metrics,
)
from benchmarks.metrics.measurement import Measurement
from benchmarks.metrics.rupture_metrics import rupture_metrics
from benchmarks.metrics.table_one import is_single_gel, table_one
from benchmarks.metrics.transition import force_noise_N, match
from benchmarks.row import Method
from benchmarks.signals.insertion_truth import InsertionTruth
from benchmarks.signals.needle_signal import NeedleSignal

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
