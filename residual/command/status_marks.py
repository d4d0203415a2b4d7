"""What a reader of the picture must know about each stretch: tare, settling, skipped rows."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residual.command.replay import Replay
from residual.wrench_estimate import Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKS = ("tare", "filters settle", "skipped")
"""What the legend calls them."""

_COLORS = dict(zip(MARKS, ("#d5efd9", "#e4e4e4", "#c0392b"), strict=True))


def draw_status_marks(panel: "Axes", result: Replay, start_s: float) -> None:
    """Shade the tare and settling filters, and tick skipped rows along the lower edge.

    Args:
        panel: Where to draw.
        result: The estimates.
        start_s: Log time that is zero in the picture [s].
    """
    tare, settling, skipping = MARKS
    time_s = result.t_s - start_s
    if result.tare is not None:
        window = result.tare.window
        span = (window.start_s - start_s, window.end_s - start_s)
        panel.axvspan(*span, color=_COLORS[tare], linewidth=0, label=tare)
    for number, (first, last) in enumerate(runs(result.has_status(Status.SETTLING))):
        # A label on each span would stand in the legend as often.
        label = settling if number == 0 else None
        panel.axvspan(
            time_s[first], time_s[last], color=_COLORS[settling], linewidth=0, label=label
        )
    skipped = time_s[result.has_status(Status.SKIPPED)]
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
