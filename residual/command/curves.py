"""One line of the picture: which rows it has, and how much room it needs."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.command.force_rows import ForceRows
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


def broken_at_gaps(curve: Curve, rows: ForceRows) -> CurveRows:
    """Return what is drawn: a skipped row leaves no hole, a gap in time does."""
    kept = ~rows.has_status(Status.SKIPPED)
    t_s = rows.t_s[kept]
    gaps = np.flatnonzero(rows.after_gap[kept])
    return CurveRows(
        t_s=np.insert(t_s, gaps, t_s[gaps]),
        value=np.insert(curve.value[kept], gaps, np.nan),
        std=np.insert(curve.std[kept], gaps, np.nan),
        is_tared=np.insert(rows.has_status(Status.OK)[kept], gaps, False),
    )


def limits(curves: list[Curve], rows: ForceRows) -> tuple[float, float]:
    """Return lower and upper limit of a panel.

    Room is made for tared rows with their bands, and for zero; what was not tared may leave the
    picture, unless there is nothing else.
    """
    shown, width = rows.has_status(Status.OK), 2.0
    if not shown.any():
        shown, width = rows.has_status(Status.NOT_TARED), 0.0
    edges = [c.value[shown] + sign * c.std[shown] for c in curves for sign in (-width, width)]
    finite = np.concatenate([[0.0], *edges])
    finite = finite[np.isfinite(finite)]
    low, high = float(finite.min()), float(finite.max())
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin
