"""What a command still found at the end of a long recording."""

from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recordings.columns.force_codes import FORCE_STATUS

LATE_ROWS = 80_000
"""Longer than a cycle of a recording of `long_recording`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LateRows:
    """Of the last `LATE_ROWS` rows, or all if there are fewer.

    Attributes:
        ruptures: Found in them; None for a command that looks for none.
        skipped: Rows that the command could not use.
    """

    ruptures: int | None
    skipped: int


def late_rows(path: Path) -> LateRows:
    """Read the end of a table that `residual` or `identification` has written as CSV."""
    with path.open(encoding="utf-8") as lines:
        names = next(lines).strip().split(",")
        last = deque(lines, maxlen=LATE_ROWS)
    wanted = ("force_status",) if "force_status" in names else ("absorbed", "rupture")
    values = np.loadtxt(
        last, delimiter=",", usecols=[names.index(name) for name in wanted], ndmin=2
    )
    if wanted == ("force_status",):
        skipped = np.count_nonzero(values[:, 0] == FORCE_STATUS.index("skipped"))
        return LateRows(ruptures=None, skipped=int(skipped))
    return LateRows(
        ruptures=int(np.count_nonzero(values[:, 1])),
        skipped=int(np.count_nonzero(values[:, 0] == 0.0)),
    )
