"""The few rows of a long log that look the same in a figure, and their axis."""

from collections.abc import Mapping, Sequence

import numpy as np

# Figures: their axis, and few rows of a log of any length that look the same.

LATE_CLOCK_S = 1e5  # seconds since 1970 would leave an axis no digits for what happened


MOST_ROWS = 20_000  # more rows than these are thinned for a figure


def time_axis(t_s: np.ndarray) -> tuple[float, str]:
    """Return the log time that is zero in a chart [s], and the label of its axis."""
    first_s = float(t_s[0])
    if abs(first_s) > LATE_CLOCK_S:
        return first_s, "time since the first sample [s]"
    return 0.0, "time of the log [s]"


def span(x: np.ndarray) -> tuple[float, float] | None:
    """Return the limits of an axis, None for one of nothing."""
    x = x[np.isfinite(x)]
    return (float(x.min()), float(x.max())) if len(x) else None


_NUMBER = "number of the row"


class RowOverview:
    """Keeps rows for a figure: all of a short log, else those with the extremes of
    each stretch.
    """

    def __init__(self, tracked: Sequence[str], most_rows: int = MOST_ROWS) -> None:
        self._tracked = tuple(tracked)
        self._most_rows = most_rows
        self._parts: list[dict[str, np.ndarray]] = []
        self._seen = self._kept = 0

    def add(self, columns: Mapping[str, np.ndarray]) -> None:
        """Take further rows, columns of shape (n,) or (n, k); the same in every
        call.
        """
        rows = len(next(iter(columns.values())))
        self._parts.append(
            {_NUMBER: np.arange(self._seen, self._seen + rows), **columns}
        )
        self._seen = self._seen + rows
        self._kept = self._kept + rows
        if self._kept > 10 * self._most_rows:
            self._parts = [self.columns()]
            self._kept = len(self._parts[0][_NUMBER])

    def columns(self) -> dict[str, np.ndarray]:
        """Return the rows kept, in order; empty before the first `add`."""
        names = self._parts[0] if self._parts else ()
        whole = {
            name: np.concatenate([part[name] for part in self._parts]) for name in names
        }
        if self._kept <= self._most_rows:
            return whole
        values = np.column_stack([whole[name] for name in self._tracked]).astype(
            np.float64
        )
        # In stretches of equal length of the log: the first row, and every least and
        # largest value.
        stretches = max(self._most_rows // (2 * values.shape[1] + 1), 1)
        numbers = np.arange(stretches) * self._seen // stretches
        edges = np.unique(np.searchsorted(whole[_NUMBER], numbers))
        kept = [edges := edges[edges < self._kept]]
        for first, stretch in zip(edges, np.split(values, edges[1:]), strict=True):
            kept.append(
                first + np.where(np.isnan(stretch), np.inf, stretch).argmin(axis=0)
            )
            kept.append(
                first + np.where(np.isnan(stretch), -np.inf, stretch).argmax(axis=0)
            )
        chosen = np.unique(np.concatenate(kept))
        return {name: column[chosen] for name, column in whole.items()}
