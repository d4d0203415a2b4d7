"""Rows whose force an estimator has marked as not usable."""

import numpy as np
from numpy.typing import NDArray

from recordings.columns.force_codes import FORCE_STATUS, WORTHLESS
from recordings.log_stream import LogChunk

_USABLE = FORCE_STATUS.index("ok")
_WORTHLESS = sum(WORTHLESS.values())


class ForceStatus:
    """Takes out forces that are marked: one from before the tare is off by a newton.

    These are the rows that `insertion.InsertionSession` keeps from its identifier.

    Args:
        is_ignored: Take all forces as they are.
    """

    def __init__(self, *, is_ignored: bool) -> None:
        self._is_ignored, self._marked, self._warned = is_ignored, 0, 0

    def force_N(self, chunk: LogChunk) -> NDArray[np.float64]:
        """Return the force, NaN where it is not usable, shape (n,).

        Args:
            chunk: Rows with `force_N`, perhaps `force_status` and `force_cautions`.
        """
        force_N = chunk.channels["force_N"]
        if self._is_ignored:
            return force_N
        usable = np.full(len(force_N), float(_USABLE))
        is_marked = chunk.channels.get("force_status", usable) != _USABLE
        cautions = np.nan_to_num(chunk.channels.get("force_cautions", np.zeros(len(force_N))))
        is_worthless = (cautions.astype(np.int64) & _WORTHLESS) != 0
        self._marked += int(is_marked.sum())
        self._warned += int((is_worthless & ~is_marked).sum())
        return np.where(is_marked | is_worthless, np.nan, force_N)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was left out, if anything was."""
        reasons = {
            "whose status says that the force is not tared or not settled": self._marked,
            f"with a caution ({', '.join(WORTHLESS)})": self._warned,
        }
        return tuple(
            f"rows {reason} were left out: {count} (--ignore-status takes them)"
            for reason, count in reasons.items()
            if count
        )
