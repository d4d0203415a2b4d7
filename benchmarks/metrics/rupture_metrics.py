"""How well ruptures were found: recall, precision, delay, dating, overshoot."""

import numpy as np

from benchmarks.metrics.transition import Matching, is_visible
from benchmarks.signals.insertion_truth import InsertionTruth


def rupture_metrics(matching: Matching, truth: InsertionTruth, noise_N: float) -> dict[str, float]:
    """Numbers of one insertion by name; what does not exist in it has no entry.

    Args:
        matching: Of all true transitions with all alarms.
        truth: Of the run.
        noise_N: Of the source: it decides which transitions are ruptures and which are soft.

    Returns:
        Recall over ruptures and over soft transitions. Precision: alarms that belong to either,
        as a share of all; 1 without alarms, none of which was false. Medians over the ruptures
        found: alarm after onset, error of the estimated instant, travel from onset to alarm.
    """
    hard = [pair for pair in matching.found if is_visible(pair[0], noise_N)]
    missed = [rupture for rupture in matching.missed if is_visible(rupture, noise_N)]
    soft_found = len(matching.found) - len(hard)
    soft = soft_found + len(matching.missed) - len(missed)
    alarms = len(matching.found) + len(matching.false)
    values = {"rupture_precision": len(matching.found) / alarms if alarms else 1.0}
    if hard or missed:
        values["rupture_recall"] = len(hard) / (len(hard) + len(missed))
    if soft:
        values["soft_transition_recall"] = soft_found / soft
    if hard:
        delay = [alarm.alarm_s - rupture.onset_s for rupture, alarm in hard]
        dating = [abs(alarm.dated_s - rupture.onset_s) for rupture, alarm in hard]
        travel = [truth.depth_m[alarm.sample] - rupture.onset_m for rupture, alarm in hard]
        values["rupture_delay_ms"] = 1e3 * float(np.median(delay))
        values["rupture_dating_error_ms"] = 1e3 * float(np.median(dating))
        values["rupture_overshoot_mm"] = 1e3 * float(np.median(travel))
    return values
