"""What is wrong with a log's time stamps, in words."""

import numpy as np

from recordings.clock.row_clock import RowClock
from recordings.errors import LogError
from recordings.tables.table import FloatArray


class TimeStampWatch:
    """Counts stamps that do not advance, however many come at a time.

    A stamp advances if it is later than every stamp before it, or than those since the clock was
    set back, see `RowClock`. The others stay in the log: an online step skips them.
    """

    def __init__(self) -> None:
        self._rows = self._advanced = 0
        self._clock = RowClock()
        self._latest_s = -np.inf
        self._faults = {
            "clock set back, from where it counts anew": _Fault(),
            "stamps running backward": _Fault(),
            "stamps repeated": _Fault(),
        }

    def update(self, t_s: FloatArray) -> FloatArray:
        """Take finite time stamps in s, shape (n,).

        Returns:
            Time in s since the latest stamp that advanced, see `RowClock`.
        """
        dt_s = self._clock.update(t_s)
        advances = dt_s > 0.0
        self._advanced += int(np.count_nonzero(advances))
        latest_s = self._latest_before(t_s, advances)
        is_back = t_s < latest_s
        for fault, rows in zip(
            self._faults.values(),
            (advances & is_back, ~advances & is_back, dt_s == 0.0),
            strict=True,
        ):
            fault.add(np.flatnonzero(rows), self._rows, t_s, latest_s)
        self._rows += t_s.size
        return dt_s

    def _latest_before(self, t_s: FloatArray, advances: np.ndarray) -> FloatArray:
        """The latest stamp that advanced before each row."""
        stamps = np.concatenate(([self._latest_s], t_s))
        which = np.maximum.accumulate(np.where(advances, np.arange(1, len(t_s) + 1), 0))
        latest_s = stamps[np.concatenate(([0], which))]
        self._latest_s = float(latest_s[-1])
        return latest_s[:-1]

    def warnings(self) -> tuple[str, ...]:
        """Report stamps that do not advance; refuse a log in which none does.

        Returns:
            One warning for each kind of fault, with how many and where the first stands (rows
            count from 1).

        Raises:
            LogError: fewer than two stamps advance, so that no time step can be formed.
        """
        # The first of all counts as one that advances.
        if self._advanced < 2:
            raise LogError(
                f"no usable time: of {self._rows} samples none is later than the first; "
                "at least two time stamps must advance"
            )
        return tuple(
            f"time: {what}: {fault.count} (first: {fault.first})"
            for what, fault in self._faults.items()
            if fault.count
        )


class _Fault:
    """How many rows have a fault, and the first of them."""

    def __init__(self) -> None:
        self.count, self.first = 0, ""

    def add(self, rows: np.ndarray, offset: int, t_s: FloatArray, before_s: FloatArray) -> None:
        if rows.size and not self.count:
            row = int(rows[0])
            self.first = f"row {offset + row + 1}, {t_s[row]:.9g} s after {before_s[row]:.9g} s"
        self.count += rows.size


def check_time_stamps(t_s: FloatArray) -> tuple[str, ...]:
    """Report stamps of a whole log that do not advance, see `TimeStampWatch`.

    Args:
        t_s: finite time stamps in s, shape (n,).

    Returns:
        The warnings.

    Raises:
        LogError: fewer than two stamps advance, so that no time step can be formed.
    """
    watch = TimeStampWatch()
    watch.update(t_s)
    return watch.warnings()
