"""Few rows of a table of any length that look the same in a picture."""

from collections.abc import Mapping, Sequence

import numpy as np

MOST_ROWS = 20_000


class RowOverview:
    """Keeps, of every stretch of rows, those in which a value is least or largest.

    Short tables are kept whole. When there are too many rows, stretches become twice as long, so
    that memory stays bounded and no spike or rupture is lost.

    Args:
        tracked: the columns whose extremes count.
        most_rows: more are never kept, but for those of one `add`.
    """

    def __init__(self, tracked: Sequence[str], most_rows: int = MOST_ROWS) -> None:
        self._tracked, self._most_rows = tuple(tracked), most_rows
        self._stretch = 1
        self._parts: list[dict[str, np.ndarray]] = []
        self._kept = self._seen = 0

    def add(self, columns: Mapping[str, np.ndarray]) -> None:
        """Take further rows.

        Args:
            columns: name to values, shape (n,) or (n, k); the same in every call, the tracked
                among them.
        """
        rows = len(next(iter(columns.values())))
        numbers = np.arange(self._seen, self._seen + rows)
        self._seen += rows
        self._append({_NUMBER: numbers, **columns})
        while self._kept > self._most_rows:
            self._stretch *= 2
            whole = self._joined()
            self._parts, self._kept = [], 0
            self._append(whole)

    def columns(self) -> dict[str, np.ndarray]:
        """Return the rows kept, in order; empty before the first `add`."""
        columns = self._joined()
        columns.pop(_NUMBER, None)
        return columns

    def _append(self, columns: dict[str, np.ndarray]) -> None:
        if self._stretch > 1:
            kept = self._extremes(columns)
            columns = {name: values[kept] for name, values in columns.items()}
        self._parts.append({name: np.array(values) for name, values in columns.items()})
        self._kept += len(columns[_NUMBER])

    def _joined(self) -> dict[str, np.ndarray]:
        if not self._parts:
            return {}
        return {
            name: np.concatenate([part[name] for part in self._parts]) for name in self._parts[0]
        }

    def _extremes(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the indices of the rows to keep, ascending."""
        stretch = columns[_NUMBER] // self._stretch
        starts = np.flatnonzero(np.diff(stretch, prepend=-1))
        of_row = np.cumsum(np.diff(stretch, prepend=-1) != 0) - 1
        kept = [starts]
        tracked = [np.atleast_2d(columns[name].T) for name in self._tracked]
        for values in np.concatenate(tracked, dtype=np.float64):
            for sign in (1.0, -1.0):
                signed = np.where(np.isnan(values), np.inf, sign * values)
                least = np.minimum.reduceat(signed, starts)
                hits = np.flatnonzero(signed == least[of_row])
                kept.append(hits[np.unique(of_row[hits], return_index=True)[1]])
        return np.unique(np.concatenate(kept))


_NUMBER = "number of the row"
