"""One component of the chart: which rows it has, and how much room it needs."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from figures import Curve, LineStyle, palette
from residual.command.force_rows import ForceRows
from residual.wrench_estimate import Status


class Component(NamedTuple):
    """A component to draw.

    Attributes:
        name: For the legend.
        style: Of the line.
        value: One per row of the log, shape (n,).
        std: Its standard deviation, shape (n,).
    """

    name: str
    style: LineStyle
    value: NDArray[np.float64]
    std: NDArray[np.float64]


class ComponentRows(NamedTuple):
    """A component without skipped rows, interrupted by NaN at gaps in time; all of shape (m,)."""

    t_s: NDArray[np.float64]
    value: NDArray[np.float64]
    std: NDArray[np.float64]
    is_tared: NDArray[np.bool_]


def broken_at_gaps(component: Component, rows: ForceRows) -> ComponentRows:
    """Return what is drawn: a skipped row leaves no hole, a gap in time does."""
    kept = ~rows.has_status(Status.SKIPPED)
    t_s = rows.t_s[kept]
    gaps = np.flatnonzero(rows.after_gap[kept])
    return ComponentRows(
        t_s=np.insert(t_s, gaps, t_s[gaps]),
        value=np.insert(component.value[kept], gaps, np.nan),
        std=np.insert(component.std[kept], gaps, np.nan),
        is_tared=np.insert(rows.has_status(Status.OK)[kept], gaps, False),
    )


def component_curves(component: Component, rows: ForceRows, start_s: float) -> list[Curve]:
    """Return the tared part with its band, and the part that was not tared.

    Before a tare the band is the prior's, wider than any chart: the line alone tells more.

    Args:
        component: What to draw.
        rows: The estimates.
        start_s: Log time that is zero in the chart [s].
    """
    drawn = broken_at_gaps(component, rows)
    time_s, tared = drawn.t_s - start_s, drawn.is_tared
    untared = Curve(
        style=replace(palette.UNTARED, color=component.style.color)
        if not tared.any()
        else palette.UNTARED,
        x=time_s,
        y=np.where(tared, np.nan, drawn.value),
        label="not tared" if tared.any() else f"{component.name}, not tared",
    )
    if not tared.any():
        return [untared]
    told = Curve(
        style=component.style,
        x=time_s,
        y=np.where(tared, drawn.value, np.nan),
        label=component.name,
        std=np.where(tared, drawn.std, np.nan),
        band_label=f"{component.name}, ± 2 std",
    )
    return [told] if tared.all() else [untared, told]


def limits(components: list[Component], rows: ForceRows) -> tuple[float, float]:
    """Return lower and upper limit of a panel.

    Room is made for tared rows with their bands, and for zero; what was not tared may leave the
    chart, unless there is nothing else.
    """
    shown, width = rows.has_status(Status.OK), 2.0
    if not shown.any():
        shown, width = rows.has_status(Status.NOT_TARED), 0.0
    edges = [c.value[shown] + sign * c.std[shown] for c in components for sign in (-width, width)]
    finite = np.concatenate([[0.0], *edges])
    finite = finite[np.isfinite(finite)]
    low, high = float(finite.min()), float(finite.max())
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin
