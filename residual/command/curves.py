"""One line of the picture: which rows it has, and how much room it needs."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.command.replay import Replay
from residual.wrench_estimate import Status


class Curve(NamedTuple):
    """A component to draw.

    Attributes:
        name: For the legend.
        color: Of line and band.
        value: One per row of the log, shape (n,).
        std: Its standard deviation, shape (n,).
    """

    name: str
    color: str
    value: NDArray[np.float64]
    std: NDArray[np.float64]


class CurveRows(NamedTuple):
    """A curve without skipped rows, interrupted by NaN at gaps in time; all of shape (m,)."""

    t_s: NDArray[np.float64]
    value: NDArray[np.float64]
    std: NDArray[np.float64]
    is_tared: NDArray[np.bool_]


def broken_at_gaps(curve: Curve, result: Replay, max_gap_s: float) -> CurveRows:
    """Return what is drawn: a skipped row leaves no hole, a gap longer than ``max_gap_s`` does."""
    kept = ~result.has_status(Status.SKIPPED)
    t_s = result.t_s[kept]
    gaps = np.flatnonzero(np.diff(t_s) > max_gap_s) + 1
    return CurveRows(
        t_s=np.insert(t_s, gaps, t_s[gaps]),
        value=np.insert(curve.value[kept], gaps, np.nan),
        std=np.insert(curve.std[kept], gaps, np.nan),
        is_tared=np.insert(result.has_status(Status.OK)[kept], gaps, False),
    )


def limits(curves: list[Curve], result: Replay) -> tuple[float, float]:
    """Return lower and upper limit of a panel.

    Room is made for tared rows with their bands, and for zero; what was not tared may leave the
    picture, unless there is nothing else.
    """
    shown, width = result.has_status(Status.OK), 2.0
    if not shown.any():
        shown, width = result.has_status(Status.NOT_TARED), 0.0
    edges = [c.value[shown] + sign * c.std[shown] for c in curves for sign in (-width, width)]
    finite = np.concatenate([[0.0], *edges])
    finite = finite[np.isfinite(finite)]
    low, high = float(finite.min()), float(finite.max())
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin
