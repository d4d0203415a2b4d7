"""When the sensor is to be tared: the option ``--tare START:END``."""

import math
from dataclasses import dataclass

from residual.command.errors import CommandError

_EXPECTED = "expected START:END in seconds, such as 0:4, or +0:+4 from the log's first stamp"


@dataclass(frozen=True, slots=True, kw_only=True)
class TareWindow:
    """A stretch of free motion in the log.

    Attributes:
        start_s: Its start on the log's clock [s].
        end_s: Its end [s].
    """

    start_s: float
    end_s: float


def parse_tare_window(text: str, first_s: float, last_s: float) -> TareWindow:
    """Read a window.

    Args:
        text: ``START:END``; either may be counted from the log's first stamp with a leading
            ``+``, and START may be left out.
        first_s: First stamp of the log [s].
        last_s: Last stamp [s].

    Raises:
        CommandError: It is not a window, or not one inside the log.
    """
    start_text, colon, end_text = text.partition(":")
    if not colon:
        raise CommandError(f"--tare {text}: {_EXPECTED}")
    start_s = _time(start_text, first_s, text) if start_text.strip() else first_s
    end_s = _time(end_text, first_s, text)
    if not start_s < end_s:
        raise CommandError(f"--tare {text}: START must come before END; {_EXPECTED}")
    if start_s >= last_s or end_s > last_s or end_s <= first_s:
        raise CommandError(
            f"--tare {text} lies outside the log, which runs from {first_s:.9g} to {last_s:.9g} s; "
            f"{_EXPECTED}"
        )
    return TareWindow(start_s=start_s, end_s=end_s)


def _time(text: str, first_s: float, whole: str) -> float:
    text = text.strip()
    try:
        value = float(text)
    except ValueError as error:
        raise CommandError(f"--tare {whole}: {text!r} is no time; {_EXPECTED}") from error
    if not math.isfinite(value):
        raise CommandError(f"--tare {whole}: {text!r} is no time; {_EXPECTED}")
    return first_s + value if text.startswith("+") else value
