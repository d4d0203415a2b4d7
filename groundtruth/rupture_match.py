"""Reported ruptures that belong to true ones."""

from collections.abc import Sequence

EARLY_s = 0.2
"""An alarm may come this much before the onset: a derivative criterion sees the force
level off before it drops."""

LATE_s = 1.5
"""It may come this much after the onset: the longest release takes 0.25 s (0.5 mm at 2
mm/s), the published virtual sensor (K = 5/s) needs three lags of 0.2 s to show nine
tenths of it, and as much again is left to the method. True onsets are 1.25 s apart at
the least in drawn stacks without membranes (10 mm at 8 mm/s), so where windows overlap
the nearest onset decides."""


def nearest_pairs(
    true: Sequence[float],
    found: Sequence[float],
    before: float = EARLY_s,
    after: float = LATE_s,
) -> dict[int, int]:
    """Return the index of the found value that belongs to each true one.

    True values without one are left out. A found value is at most so much before or
    after the true one, and belongs to one true value at most, nearest first.

    Args:
        true: True values, such as onsets of ruptures [s].
        found: Values that were found, such as times of alarms [s].
        before: How much a found value may precede the true one.
        after: How much it may follow.
    """
    candidates = sorted(
        (abs(value - onset), i, j)
        for i, onset in enumerate(true)
        for j, value in enumerate(found)
        if -before <= value - onset <= after
    )
    pairs: dict[int, int] = {}
    for _, i, j in candidates:
        if i not in pairs and j not in pairs.values():
            pairs[i] = j
    return pairs
