"""One column of a Parquet file as an array of numbers."""

from typing import Any

import numpy as np

from recordings.clock.nanoseconds import start_of_clock, to_seconds
from recordings.tables.table import FloatArray


def is_number_column(kind: Any, types: Any) -> bool:
    """Return whether a column of this type can be read as numbers.

    Args:
        kind: its type in the file.
        types: the module `pyarrow.types`.
    """
    if _is_list(kind, types):
        kind = kind.value_type
    tests = (types.is_floating, types.is_integer, types.is_boolean, types.is_decimal)
    return types.is_timestamp(kind) or any(test(kind) for test in tests)


class ParquetColumn:
    """Turns the batches of one column into arrays of equal shape.

    Args:
        arrow: the module `pyarrow`.
    """

    def __init__(self, arrow: Any) -> None:
        self._arrow = arrow
        self._width: int | None = None
        self.start_ns = 0

    def read(self, cells: Any, start_ns: int) -> FloatArray:
        """Return a batch's values, NaN where a cell is empty.

        A list column gets the width of its first list; lists of another length are NaN. Of a
        column of time stamps, `start_ns` of the first batch is kept.

        Args:
            cells: the batch, a `pyarrow.Array`.
            start_ns: the clock's start if the file says it, else 0.

        Returns:
            Shape (n,), or (n, k) for lists; time stamps in seconds since `self.start_ns`.
        """
        types = self._arrow.types
        if _is_list(cells.type, types):
            return self._lists(cells)
        if types.is_timestamp(cells.type):
            return self._stamps(cells, start_ns)
        return self._numbers(cells)

    def whole(self, cells: Any) -> np.ndarray:
        """Return a batch's whole numbers as they are, nothing where it holds others or none."""
        if not self._arrow.types.is_integer(cells.type) or cells.null_count:
            return np.empty(0)
        return cells.to_numpy(zero_copy_only=False)

    def _numbers(self, cells: Any) -> FloatArray:
        # Without the check of `safe`, which refuses integers that a double rounds.
        numbers = cells.cast(self._arrow.float64(), safe=False)
        return numbers.to_numpy(zero_copy_only=False)

    def _lists(self, cells: Any) -> FloatArray:
        lengths = cells.value_lengths().fill_null(0).to_numpy(zero_copy_only=False)
        if self._width is None:
            self._width = int(lengths[0])
        whole = lengths == self._width
        values = np.full((len(lengths), self._width), np.nan)
        kept = cells.filter(self._arrow.array(whole)).flatten()
        values[whole] = self._numbers(kept).reshape(-1, self._width)
        return values

    def _stamps(self, cells: Any, start_ns: int) -> FloatArray:
        whole = cells.is_valid().to_numpy(zero_copy_only=False)
        kind = self._arrow.timestamp("ns", cells.type.tz)
        stamps = cells.cast(kind).cast(self._arrow.int64()).fill_null(0)
        stamps_ns = stamps.to_numpy(zero_copy_only=False)
        if self.start_ns == 0 and whole.any():
            self.start_ns = start_ns or start_of_clock(int(stamps_ns[whole][0]))
        seconds = to_seconds(stamps_ns, self.start_ns)
        seconds[~whole] = np.nan
        return seconds


def _is_list(kind: Any, types: Any) -> bool:
    return types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)
