"""How much time passes between the rows of a log, whatever its clock does."""

import math

import numpy as np

from recordings.tables.table import FloatArray

_SET_AFTER_S = 0.1
_SET_AFTER_ROWS = 3
"""A row that is not later than those before came late. When so many rows in a row, over so much
time, are later than each other but not than those before, it was not they: the clock was set."""


class RowClock:
    """Time from row to row; a row that comes late is no step, a clock that was set back is left.

    A clock that goes back a little soon catches up; until then rows do not advance. If it stays
    behind, it counts from there, however many rows come at a time.
    """

    def __init__(self) -> None:
        self._latest_s = -math.inf
        self._behind_s = math.inf
        self._rows, self._ran_s = 0, 0.0

    def update(self, t_s: FloatArray) -> FloatArray:
        """Take further rows.

        Args:
            t_s: time stamps in s, shape (n,).

        Returns:
            Time in s since the latest row that advanced, shape (n,): not positive for a row that
            does not, inf for the first of all. The row at which a set clock is understood
            advances by the time for which it has run.
        """
        dt_s = np.diff(t_s, prepend=self._latest_s)
        if (dt_s > 0.0).all():
            if t_s.size:
                self._latest_s, self._rows = float(t_s[-1]), 0
            return dt_s
        return np.array([self._step(now_s) for now_s in t_s.tolist()])

    def _step(self, now_s: float) -> float:
        dt_s = now_s - self._latest_s
        if dt_s > 0.0:
            self._latest_s, self._rows = now_s, 0
            return dt_s
        # A stamp that is no number says nothing of the clock.
        if not dt_s < 0.0 or (self._rows and now_s == self._behind_s):
            return dt_s
        if not self._rows or now_s < self._behind_s:
            self._rows, self._ran_s = 0, 0.0
        else:
            self._ran_s += now_s - self._behind_s
        self._rows, self._behind_s = self._rows + 1, now_s
        if self._rows < _SET_AFTER_ROWS or self._ran_s < _SET_AFTER_S:
            return dt_s
        self._latest_s, self._rows = now_s, 0
        return self._ran_s
