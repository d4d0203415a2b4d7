"""When the sensor is to be tared: the option ``--tare START:END``."""

import math
from dataclasses import dataclass

from residual.command.errors import CommandError

_EXPECTED = "expected START:END in seconds, such as 0:4, or +0:+4 from the log's first stamp"
_LATE_CLOCK_S = 1e5


@dataclass(frozen=True, slots=True, kw_only=True)
class TareWindow:
    """A stretch of free motion in the log.

    Attributes:
        start_s: Its start on the log's clock [s].
        end_s: Its end [s].
    """

    start_s: float
    end_s: float

    def __str__(self) -> str:
        """In words; to the millisecond where a clock counts from 1970."""
        return f"{_digits(self.start_s)} to {_digits(self.end_s)} s"


def _digits(time_s: float) -> str:
    return f"{time_s:.6g}" if abs(time_s) < _LATE_CLOCK_S else f"{time_s:.3f}"


@dataclass(frozen=True, slots=True)
class TareOption:
    """What the option says; the window is known with the log's first stamp.

    Attributes:
        text: ``START:END``; either may be counted from the log's first stamp with a leading
            ``+``, and START may be left out.
    """

    text: str

    def __post_init__(self) -> None:
        """Check what can be checked without a log.

        Raises:
            CommandError: It is not a window.
        """
        self._ends(0.0)

    def window(self, first_s: float) -> TareWindow:
        """Return the window in a log that starts at ``first_s`` [s].

        Raises:
            CommandError: It does not end after it starts.
        """
        start_s, end_s = self._ends(first_s)
        plain_start_s, plain_end_s = self._ends(0.0)
        if start_s >= end_s and plain_start_s < plain_end_s:
            raise CommandError(
                f"--tare {self.text} does not fit the log, whose first stamp is {first_s:.9g} s; "
                f"if the unit is wrong, say --time COLUMN:UNIT; {_EXPECTED}"
            )
        if not start_s < end_s:
            raise CommandError(f"--tare {self.text}: START must come before END; {_EXPECTED}")
        return TareWindow(start_s=start_s, end_s=end_s)

    def require_inside(self, window: TareWindow, first_s: float, last_s: float) -> None:
        """Check that the log reaches as far as the window.

        Args:
            window: Of `window`.
            first_s: The log's first stamp [s].
            last_s: Its last [s]; inf while it is not known.

        Raises:
            CommandError: It does not.
        """
        if window.start_s >= last_s or window.end_s > last_s or window.end_s <= first_s:
            end = f"runs from {_digits(first_s)} to {_digits(last_s)} s"
            if math.isinf(last_s):
                end = f"starts at {_digits(first_s)} s"
            raise CommandError(f"--tare {self.text} lies outside the log, which {end}; {_EXPECTED}")

    def _ends(self, first_s: float) -> tuple[float, float]:
        start_text, colon, end_text = self.text.partition(":")
        if not colon:
            raise CommandError(f"--tare {self.text}: {_EXPECTED}")
        start_s = self._time(start_text, first_s) if start_text.strip() else first_s
        return start_s, self._time(end_text, first_s)

    def _time(self, text: str, first_s: float) -> float:
        text = text.strip()
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise CommandError(f"--tare {self.text}: {text!r} is no time; {_EXPECTED}")
        return first_s + value if text.startswith("+") else value
