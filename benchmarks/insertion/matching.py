"""True ruptures matched with reported ones."""

from collections.abc import Sequence

from benchmarks.insertion.methods import Alarm
from groundtruth import Rupture
from groundtruth.rupture_match import nearest_pairs

VISIBLE_N = 0.15
"""A true transition counts as a rupture when the true force drops by more than this,
whatever the noise of who looks for it; below it is a soft transition. The least drop of
ruptures in real liver (0.15 to 1.4 N); half that of the 25 % gel, the softest of the
published tissues."""


def is_visible(rupture: Rupture) -> bool:
    """Whether a true transition counts as a rupture."""
    return rupture.visible_drop_N > VISIBLE_N


Matching = tuple[list[tuple[Rupture, Alarm]], list[Rupture], list[Alarm]]
"""Pairs of a true rupture and its alarm, in the order of the ruptures; ruptures without
an alarm; alarms without a rupture."""


def match(ruptures: Sequence[Rupture], alarms: Sequence[Alarm]) -> Matching:
    """Give each alarm to at most one true rupture, nearest first.

    The other way round likewise. An alarm may belong to a rupture when it lies within
    `rupture_match.EARLY_s` before and `LATE_s` after its onset.
    """
    onsets_s = [rupture.onset_s for rupture in ruptures]
    pairs = nearest_pairs(onsets_s, [alarm.alarm_s for alarm in alarms])
    used = set(pairs.values())
    return (
        [(ruptures[i], alarms[pairs[i]]) for i in sorted(pairs)],
        [rupture for i, rupture in enumerate(ruptures) if i not in pairs],
        [alarm for j, alarm in enumerate(alarms) if j not in used],
    )
