"""What a reader of the chart must know about each stretch: tare, settling, skipped rows."""

import numpy as np
from numpy.typing import NDArray

from figures import Shading, Ticks, palette
from residual.command.force_rows import ForceRows
from residual.command.taring import TareDone
from residual.wrench_estimate import Status


def shadings(rows: ForceRows, tare: TareDone | None, start_s: float) -> tuple[Shading, ...]:
    """Return the stretches of the tare and of settling filters.

    Args:
        rows: The estimates.
        tare: The tare, if one was taken.
        start_s: Log time that is zero in the chart [s].
    """
    found = []
    if tare is not None:
        span = (tare.window.start_s - start_s, tare.window.end_s - start_s)
        found.append(Shading(label="tare", color=palette.TARE, spans=(span,)))
    time_s = rows.t_s - start_s
    settling = tuple(
        (float(time_s[first]), float(time_s[last]))
        for first, last in runs(rows.has_status(Status.SETTLING))
    )
    if settling:
        found.append(Shading(label="filters settle", color=palette.SETTLING, spans=settling))
    return tuple(found)


def skipped_ticks(rows: ForceRows, start_s: float) -> tuple[Ticks, ...]:
    """Return strokes at rows that were skipped."""
    places = (rows.t_s - start_s)[rows.has_status(Status.SKIPPED)]
    if not len(places):
        return ()
    return (Ticks(label="skipped", color=palette.SKIPPED, places=tuple(places.tolist())),)


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of every unbroken run of True."""
    edges = np.diff(np.concatenate(([0], flags.astype(np.int8), [0])))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return list(zip(starts.tolist(), ends.tolist(), strict=True))
