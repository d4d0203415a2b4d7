"""True ruptures matched with reported ones."""

from collections.abc import Sequence
from typing import NamedTuple

from benchmarks.insertion.methods import Alarm
from groundtruth import Rupture

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
    """Give each alarm to at most one true rupture, nearest first.

    The other way round likewise. An alarm may belong to a rupture when it lies within
    `EARLY_s` before and `LATE_s` after its onset.
    """
    onsets_s = [rupture.onset_s for rupture in ruptures]
    pairs = nearest_pairs(
        onsets_s, [alarm.alarm_s for alarm in alarms], EARLY_s, LATE_s
    )
    used = set(pairs.values())
    return Matching(
        found=tuple((ruptures[i], alarms[pairs[i]]) for i in sorted(pairs)),
        missed=tuple(rupture for i, rupture in enumerate(ruptures) if i not in pairs),
        false=tuple(alarm for j, alarm in enumerate(alarms) if j not in used),
    )


def nearest_pairs(
    true: Sequence[float], seen: Sequence[float], before: float, after: float
) -> dict[int, int]:
    """Return the index of the found value that belongs to each true one.

    True values without one are left out. A found value is at most so much before or
    after the true one, and belongs to one true value at most, nearest first.
    """
    candidates = sorted(
        (abs(value - onset), i, j)
        for i, onset in enumerate(true)
        for j, value in enumerate(seen)
        if -before <= value - onset <= after
    )
    pairs: dict[int, int] = {}
    for _, i, j in candidates:
        if i not in pairs and j not in pairs.values():
            pairs[i] = j
    return pairs
