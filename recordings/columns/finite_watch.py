"""Rows of a channel that hold no number."""

import numpy as np

from recordings.errors import LogError
from recordings.tables.table import FloatArray


class FiniteWatch:
    """Counts rows with NaN or infinity, however many come at a time.

    Args:
        name: the channel's, for messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._rows = self._bad = self._first_bad = 0
        self._any_finite = False

    def update(self, values: FloatArray) -> None:
        """Take values, shape (n,) or (n, k)."""
        finite = np.isfinite(values)
        whole = finite if values.ndim == 1 else finite.all(axis=1)
        if not whole.all():
            bad = np.flatnonzero(~whole)
            self._first_bad = self._first_bad or self._rows + int(bad[0]) + 1
            self._bad += bad.size
        self._any_finite = self._any_finite or bool(finite.any())
        self._rows += len(values)

    def warnings(self) -> tuple[str, ...]:
        """Report rows that are not finite.

        Raises:
            LogError: there was no finite value at all.
        """
        if not self._bad:
            return ()
        if not self._any_finite:
            raise LogError(f"{self._name} has no finite value in {self._rows} rows")
        return (
            f"{self._name}: rows with NaN or infinity: {self._bad} (first: row {self._first_bad})",
        )
