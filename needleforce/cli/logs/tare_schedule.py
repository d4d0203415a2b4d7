"""When the virtual sensor is tared while it runs over a log."""

import math
from collections import Counter
from typing import NamedTuple

from foundation.advice import Advice, Message
from needleforce.cli.shared_options import SensorOptions
from needleforce.cli.terminal import CommandError
from residual import Status, TareError, VirtualForceSensor
from residual.advice import TareAdvice
from residual.bias.model import Tare
from residual.errors import VelocityError

# When the sensor is tared.

AUTOMATIC_S = 2.0
"""Without a choice of the user's, so much from the start of the log is taken for free
motion [s]: whoever records an insertion starts before contact, but not long before."""


_WINDOW = (
    "expected START:END in seconds, such as 0:4, or +0:+4 from the log's first stamp"
)


_CHOICES = "choose where the needle is free with --tare START:END, or go without with --no-tare"


_UNITS = (
    "Say unit and factor of the columns: --q q_*:deg, --dq dq_*:deg/s or dq_*:rad/s:-1"
)


_ADVICES: dict[Advice, str] = {
    TareAdvice.IGNORE_CONTACT: ", or --force-tare if you know better",
    TareAdvice.COMPENSATE_GRAVITY: "give --gravity-compensated",
    TareAdvice.KEEP_GRAVITY: "leave --gravity-compensated out",
    TareAdvice.NEGATE_TORQUE: "negate it, as in --tau tau_*:Nm:-1",
    TareAdvice.SEND_MEASURED_TORQUE: (
        "leave --external-torque out and read it with --tau"
    ),
    TareAdvice.SEND_NEGATED_TORQUE: (
        "leave --external-torque out and negate it, as in --tau tau_*:Nm:-1"
    ),
    TareAdvice.MOVE_FREELY: "choose a longer window, without gaps in time",
}
"""Options for what a refused tare advises."""


class TareWindow(NamedTuple):
    """A stretch of motion without contact, in seconds of the log's clock, and its
    tare if taken.
    """

    start_s: float
    end_s: float
    tare: Tare | None = None

    def __str__(self) -> str:
        return f"{self.start_s:.12g} to {self.end_s:.12g} s"


def tare_window(text: str, first_s: float) -> TareWindow:
    """Return the window of ``--tare`` in a log that starts at ``first_s`` [s]."""
    start, colon, end = text.partition(":")
    if not colon:
        raise CommandError(f"--tare {text}: {_WINDOW}")
    start_s = _log_time(text, start, first_s) if start.strip() else first_s
    return TareWindow(start_s, _log_time(text, end, first_s))


def _log_time(option: str, text: str, first_s: float) -> float:
    """Return a time on the log's clock [s]; after a + it counts from the log's
    start.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CommandError(f"--tare {option}: {text!r} is no time; {_WINDOW}")
    return first_s + value if text.strip().startswith("+") else value


def rejections(rejected: Counter[str]) -> str:
    """Return how many samples were rejected, and how often for which reasons; empty
    if none.
    """
    reasons = [f"{count} x {reason}" for reason, count in rejected.most_common(4)]
    if others := len(rejected) - len(reasons):
        reasons.append(f"{others} other reasons")
    return f"{rejected.total()}: {'; '.join(reasons)}" if reasons else ""


class TareSchedule:
    """Starts the tare recording and takes the tare when their times come."""

    def __init__(
        self,
        sensor: VirtualForceSensor,
        rejected: Counter[str],
        options: SensorOptions,
        first_s: float,
    ) -> None:
        self._sensor = sensor
        self._options = options
        self._first_s = first_s
        self._rejected_before = Counter[str]()
        self._rejected = rejected
        self._window: TareWindow | None = None
        if options.tare is not None:
            window = tare_window(options.tare, first_s)
            self._require_inside(window, math.inf)
            self._window = window._replace(start_s=max(window.start_s, first_s))
        self._must_start = self._window is not None
        self._has_settled = False
        self.done: TareWindow | None = None

    def before(self, t_s: float) -> None:
        """Act before the sample of time ``t_s`` [s] is given to the sensor."""
        window = self._window
        if window is None or self.done is not None:
            return
        if self._must_start and t_s >= window.start_s:
            self._sensor.start_tare_recording()
            self._rejected_before = self._rejected.copy()
            self._must_start = False
        if t_s > window.end_s:
            self._tare(window)

    def after(self, t_s: float, status: Status) -> None:
        """Learn from the status of the sample of time ``t_s`` [s] when the filters
        have settled.
        """
        if status is not Status.NOT_TARED or self._must_start:
            return
        self._has_settled = True
        if self._window is None and not self._options.no_tare:
            self._window = TareWindow(t_s, t_s + AUTOMATIC_S)

    def finish(self, last_s: float, *, is_whole: bool) -> None:
        """Take a tare whose window ends with the log; one that was broken off may
        end before.
        """
        window = self._window
        if self._options.no_tare or self.done is not None:
            return
        if window is not None and last_s >= window.end_s:
            self._tare(window)
        elif is_whole:
            if self._options.tare is not None and window is not None:
                self._require_inside(window, last_s)
            raise CommandError(
                f"the log ends before the filters have settled and {AUTOMATIC_S:g} s of free "
                f"motion were seen, so it cannot be tared{self._rejections}; {_CHOICES}"
            )

    @property
    def _rejections(self) -> str:
        text = rejections(self._rejected - self._rejected_before)
        return f"; samples were rejected, {text}" if text else ""

    def _require_inside(self, window: TareWindow, last_s: float) -> None:
        is_inside = self._first_s < window.end_s <= last_s and window.start_s < last_s
        if is_inside and window.start_s < window.end_s:
            return
        first = f"{self._first_s:.12g} s"
        last = f"{last_s:.12g} s"
        log = (
            f"starts at {first}"
            if math.isinf(last_s)
            else f"runs from {first} to {last}"
        )
        what = f"lies outside the log, which {log}"
        if not window.start_s < window.end_s:
            what = f"START must come before END in a log whose first stamp is {first}; "
            what += "if the unit is wrong, say --time COLUMN:UNIT"
        raise CommandError(f"--tare {self._options.tare}: {what}; {_WINDOW}")

    def _tare(self, window: TareWindow) -> None:
        what = f"no tare from {window}"
        if not self._has_settled:
            why = self._rejections or "; choose a window that ends later"
            raise CommandError(f"{what}: the filters had not settled by then{why}")
        try:
            tare = self._sensor.tare(ignore_contact=self._options.force_tare)
        except TareError as error:
            reason = Message.of(error).in_words(_ADVICES)
            choices = _UNITS if isinstance(error, VelocityError) else f"Or {_CHOICES}"
            raise CommandError(f"{what}: {reason}. {choices}") from error
        self.done = window._replace(tare=tare)
