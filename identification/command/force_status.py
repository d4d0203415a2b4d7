"""Rows whose force an estimator has marked as not usable."""

import numpy as np
from numpy.typing import NDArray

from recordings.log_stream import LogChunk

_NOT_USABLE = (1, 2, 3)
"""Not tared, filters settle, skipped: how ``python -m residual`` marks rows; 0 is usable."""


class ForceStatus:
    """Takes out forces that are marked: one from before the tare is off by a newton.

    Args:
        is_ignored: Take all forces as they are.
    """

    def __init__(self, *, is_ignored: bool) -> None:
        self._is_ignored, self._left_out = is_ignored, 0

    def force_N(self, chunk: LogChunk) -> NDArray[np.float64]:
        """Return the force, NaN where it is not usable, shape (n,).

        Args:
            chunk: Rows with `force_N` and perhaps `status`.
        """
        force_N, status = chunk.channels["force_N"], chunk.channels.get("status")
        if status is None or self._is_ignored:
            return force_N
        is_marked = np.isin(status, _NOT_USABLE)
        self._left_out += int(is_marked.sum())
        return np.where(is_marked, np.nan, force_N)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was left out, if anything was."""
        if not self._left_out:
            return ()
        return (
            f"rows whose status says that the force is not tared or not settled were left out: "
            f"{self._left_out} (--ignore-status takes them)",
        )
