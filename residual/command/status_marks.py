"""What a reader of the picture must know about each stretch: tare, settling, skipped rows."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residual.command.force_rows import ForceRows
from residual.command.taring import TareDone
from residual.wrench_estimate import Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKS = ("tare", "filters settle", "skipped")
"""What the legend calls them."""

_COLORS = dict(zip(MARKS, ("#d5efd9", "#e4e4e4", "#c0392b"), strict=True))


def draw_status_marks(
    panel: "Axes", rows: ForceRows, tare: TareDone | None, start_s: float
) -> None:
    """Shade the tare and settling filters, and tick skipped rows along the lower edge.

    Args:
        panel: Where to draw.
        rows: The estimates.
        tare: The tare, if one was taken.
        start_s: Log time that is zero in the picture [s].
    """
    taring, settling, skipping = MARKS
    time_s = rows.t_s - start_s
    if tare is not None:
        window = tare.window
        span = (window.start_s - start_s, window.end_s - start_s)
        panel.axvspan(*span, color=_COLORS[taring], linewidth=0, label=taring)
    for number, (first, last) in enumerate(runs(rows.has_status(Status.SETTLING))):
        # A label on each span would stand in the legend as often.
        label = settling if number == 0 else None
        panel.axvspan(
            time_s[first], time_s[last], color=_COLORS[settling], linewidth=0, label=label
        )
    skipped = time_s[rows.has_status(Status.SKIPPED)]
    if len(skipped):
        panel.plot(
            skipped,
            np.full(len(skipped), 0.015),
            "|",
            color=_COLORS[skipping],
            markersize=9,
            transform=panel.get_xaxis_transform(),
            label=skipping,
        )


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of every unbroken run of True."""
    edges = np.diff(np.concatenate(([0], flags.astype(np.int8), [0])))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return list(zip(starts.tolist(), ends.tolist(), strict=True))
