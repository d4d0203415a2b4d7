"""Table I: cumulative friction of a single gel, true, offline and online."""

import numpy as np

from benchmarks.methods.alarm import cumulative_friction_Ns_per_m
from benchmarks.methods.identified import Identified
from benchmarks.methods.offline_fit import offline_fit
from benchmarks.signals.insertion_truth import InsertionTruth
from benchmarks.signals.needle_signal import NeedleSignal


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
