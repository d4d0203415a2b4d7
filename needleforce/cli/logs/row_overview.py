"""Few rows of a long log that look the same in a figure, and the figure's x axis."""

from collections.abc import Mapping, Sequence

import numpy as np

from foundation.arrays import Array

MAX_ROWS = 20_000
"""Rows of a log that a figure shows; more are thinned."""

MAX_KEPT = 3
"""Rows that are kept between thinnings, in multiples of the rows that are shown."""

_NUMBER = "number of the row"


def time_axis(t_s: Array) -> tuple[float, str]:
    """Return the time that is zero in a chart of stamps, shape (n,), and the label."""
    # Beyond it, as in seconds since 1970, an axis has no digits for what happened [s]
    late_clock_s = 1e5
    first_s = float(t_s[0])
    if abs(first_s) > late_clock_s:
        return first_s, "time since the first sample [s]"
    return 0.0, "time of the log [s]"


def axis_span(x: Array) -> tuple[float, float] | None:
    """Return the limits of an axis for places of shape (n,), None without any."""
    x = x[np.isfinite(x)]
    return (float(x.min()), float(x.max())) if len(x) else None


class RowOverview:
    """Rows for a figure: all of a short log, else those with extremes of each stretch.

    Args:
        tracked: Columns whose extremes are kept.
        max_rows: Rows that are kept at most in the end.
    """

    def __init__(self, tracked: Sequence[str], max_rows: int = MAX_ROWS) -> None:
        self._tracked = tuple(tracked)
        self._max_rows = max_rows
        self._tables: list[dict[str, np.ndarray]] = []
        self._rows_seen = 0
        self._rows_kept = 0

    def add(self, columns: Mapping[str, np.ndarray]) -> None:
        """Take further rows.

        Args:
            columns: Of shape (n,) or (n, k), the same columns in every call.
        """
        rows = len(next(iter(columns.values())))
        numbers = np.arange(self._rows_seen, self._rows_seen + rows)
        self._tables.append({_NUMBER: numbers, **columns})
        self._rows_seen += rows
        self._rows_kept += rows
        if self._rows_kept > MAX_KEPT * self._max_rows:
            self._tables = [self.columns()]
            self._rows_kept = len(self._tables[0][_NUMBER])

    def columns(self) -> dict[str, np.ndarray]:
        """Return the rows kept, in order; empty before the first `add`."""
        names = self._tables[0] if self._tables else ()
        whole = {
            name: np.concatenate([table[name] for table in self._tables])
            for name in names
        }
        if self._rows_kept <= self._max_rows:
            return whole
        chosen = self._rows_with_extremes(whole)
        return {name: column[chosen] for name, column in whole.items()}

    def _rows_with_extremes(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return indices of the first row and the extremes of every stretch.

        The stretches are equally long parts of the log.
        """
        values = np.column_stack([columns[name] for name in self._tracked])
        values = values.astype(np.float64)
        rows_per_stretch = 2 * values.shape[1] + 1
        stretches = max(self._max_rows // rows_per_stretch, 1)
        first_numbers = np.arange(stretches) * self._rows_seen // stretches
        starts = np.unique(np.searchsorted(columns[_NUMBER], first_numbers))
        starts = starts[starts < self._rows_kept]
        chosen = [starts]
        for start, stretch in zip(starts, np.split(values, starts[1:]), strict=True):
            is_missing = np.isnan(stretch)
            lowest = np.where(is_missing, np.inf, stretch).argmin(axis=0)
            highest = np.where(is_missing, -np.inf, stretch).argmax(axis=0)
            chosen += [start + lowest, start + highest]
        return np.unique(np.concatenate(chosen))
