"""True transitions against reported ruptures: which are visible, and who belongs to whom."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.methods import Alarm
from benchmarks.signals import InsertionTruth, NeedleSignal
from groundtruth import Rupture

VISIBLE_SIGMAS = 5.0
"""A true transition counts as a rupture when the true force visibly drops by more than so many
times the source's noise; below that it is a soft transition."""
EARLY_s = 0.2
"""An alarm may come this much before the onset: a derivative criterion sees the force level off
before it drops."""
LATE_s = 1.5
"""It may come this much after the onset: the longest release takes 0.25 s (0.5 mm at 2 mm/s), the
published virtual sensor (K = 5/s) needs three lags of 0.2 s to show nine tenths of it, and as much
again is left to the method. True onsets are 1.25 s apart at the least in drawn stacks without
membranes (10 mm at 8 mm/s), so where windows overlap the nearest onset decides."""


def force_noise_N(signal: NeedleSignal, truth: InsertionTruth) -> float:
    """Noise of a source: standard deviation of its reading in the free approach.

    From the end of the tare to first contact; nan when there is no such time.
    """
    free = (truth.t_s > truth.tare_end_s) & (truth.t_s < truth.contact_s)
    return float(np.std(signal.force_N[free])) if free.any() else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class Matching:
    """Who belongs to whom.

    Attributes:
        found: Pairs of a true rupture and its alarm, in the order of the ruptures.
        missed: True ruptures without an alarm.
        false: Alarms without a true rupture.
    """

    found: tuple[tuple[Rupture, Alarm], ...]
    missed: tuple[Rupture, ...]
    false: tuple[Alarm, ...]


def match(ruptures: Sequence[Rupture], alarms: Sequence[Alarm]) -> Matching:
    """Give each alarm to at most one true rupture and the other way round, nearest first.

    An alarm may belong to a rupture when it lies within `EARLY_s` before and `LATE_s` after its
    onset.
    """
    candidates = sorted(
        (abs(alarm.alarm_s - rupture.onset_s), i, j)
        for i, rupture in enumerate(ruptures)
        for j, alarm in enumerate(alarms)
        if -EARLY_s <= alarm.alarm_s - rupture.onset_s <= LATE_s
    )
    alarm_of: dict[int, int] = {}
    for _, i, j in candidates:
        if i not in alarm_of and j not in alarm_of.values():
            alarm_of[i] = j
    taken = set(alarm_of.values())
    return Matching(
        found=tuple((ruptures[i], alarms[alarm_of[i]]) for i in sorted(alarm_of)),
        missed=tuple(rupture for i, rupture in enumerate(ruptures) if i not in alarm_of),
        false=tuple(alarm for j, alarm in enumerate(alarms) if j not in taken),
    )


def is_visible(rupture: Rupture, noise_N: float) -> bool:
    """Whether a true transition counts as a rupture for a source with that noise."""
    return rupture.visible_drop_N > VISIBLE_SIGMAS * noise_N


# How well ruptures were found: recall, precision, delay, dating, overshoot.


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
