"""Time between the samples that were absorbed, over those that were not."""

import numbers

from residual.errors import SampleError
from residual.sample_check import LONGEST_STEP_S, check_interval

ROUNDING_S = 1e-5
"""Sums of time steps that come this near to a limit have reached it [s]: stamps since 1970 are
rounded to a quarter of a microsecond, and rounding must not decide on a tick more or less."""


class SampleClock:
    """Adds the time of skipped samples to that of the next sound one.

    A clock that goes back a little comes forward again: samples are skipped until it has caught
    up. One that was set back by more, or forward by more than a day, goes on from there.

    Args:
        most_back_s: How far back still counts as a little [s].
    """

    def __init__(self, most_back_s: float) -> None:
        self._most_back_s = most_back_s
        self.missed_s = 0.0
        """Time since the last sample that was absorbed [s], negative after a step back."""

    def elapsed(self, dt_s: float) -> float:
        """Time since the last sample that was absorbed [s].

        Raises:
            SampleError: For a time step that does not advance, or for a clock that was set.
        """
        dt_s = check_interval(dt_s)
        if not self.missed_s:
            return dt_s
        elapsed_s = dt_s + self.missed_s
        if elapsed_s <= 0.0:
            raise SampleError(
                f"dt_s is {dt_s!r} s after a clock that went back by {-self.missed_s:.3g} s; "
                "skipped until it has caught up"
            )
        return min(elapsed_s, LONGEST_STEP_S)

    def miss(self, dt_s: float) -> None:
        """A sample was skipped: its time still passes, if it has a sound one."""
        is_number = isinstance(dt_s, numbers.Real) and not isinstance(dt_s, bool)
        if is_number and -self._most_back_s < dt_s <= LONGEST_STEP_S:
            self.missed_s += float(dt_s)
