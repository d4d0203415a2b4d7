"""When the virtual sensor is tared while it runs over a log."""

import math
from collections import Counter
from typing import NamedTuple

from needleforce.cli.shared_options import SensorOptions
from needleforce.cli.terminal import CHOOSE_TARE, CommandError
from residual import Status, TareError, VirtualForceSensor
from residual.bias.model import Tare

AUTOMATIC_S = 2.0
"""Without a choice of the user's, so much from the start of the log is taken for free
motion [s]: whoever records an insertion starts before contact, but not long before."""

MAX_UNUSED_S = 0.1
"""A window whose first or last samples were not used for longer is reported as it was
used [s]; the filters bridge no longer gap."""

MAX_LISTED_REASONS = 4
"""Reasons of rejection that a message lists."""


class TareWindow(NamedTuple):
    """A stretch of motion without contact, and its tare once it was taken.

    Attributes:
        start_s: Start on the log's clock [s].
        end_s: End on the log's clock [s].
        note: In brackets, how it differs from the one that was asked for; mostly empty.
        tare: The tare; None before it was taken.
    """

    start_s: float
    end_s: float
    note: str = ""
    tare: Tare | None = None

    def __str__(self) -> str:
        return f"{self.start_s:.12g} to {self.end_s:.12g} s"


def parse_tare_window(text: str, first_s: float) -> TareWindow:
    """Return the window that ``--tare`` names.

    Args:
        text: Value of the option, START:END.
        first_s: Time of the log's first row [s].

    Raises:
        CommandError: The text names no window.
    """
    start, colon, end = text.partition(":")
    if not colon:
        raise CommandError(f"--tare {text}: expected START:END", CHOOSE_TARE)
    start_s = _parse_log_time(text, start, first_s) if start.strip() else first_s
    return TareWindow(start_s, _parse_log_time(text, end, first_s))


def _parse_log_time(option: str, text: str, first_s: float) -> float:
    """Return a time on the log's clock [s]; after a + it counts from the first row."""
    try:
        time_s = float(text)
    except ValueError:
        time_s = math.nan
    if not math.isfinite(time_s):
        raise CommandError(
            f"--tare {option}: {text!r} is no time, expected START:END",
            CHOOSE_TARE,
        )
    return first_s + time_s if text.strip().startswith("+") else time_s


def velocity_advice(rejected: Counter[str]) -> str:
    """Return what helps where velocities are why samples were rejected; else ""."""
    if not any(reason.startswith("dq ") for reason in rejected):
        return ""
    return "; --dq none leaves velocities out and estimates them from q"


def describe_rejections(rejected: Counter[str]) -> str:
    """Return how many samples were rejected, and for which reasons; empty if none."""
    common = rejected.most_common(MAX_LISTED_REASONS)
    reasons = [f"{count} x {reason}" for reason, count in common]
    if others := len(rejected) - len(reasons):
        reasons.append(f"{others} other reasons")
    return f"{rejected.total()}: {'; '.join(reasons)}" if reasons else ""


class TareSchedule:
    """Starts the tare recording and takes the tare when their times come.

    Args:
        sensor: The sensor that is tared.
        rejected: Reasons for which samples were rejected, counted by the caller.
        options: Whether and when a tare is wanted.
        first_s: Time of the log's first row [s].

    Attributes:
        done: The window whose tare was taken; None before.

    Raises:
        CommandError: The window lies outside the log, or the tare is refused.
    """

    def __init__(
        self,
        sensor: VirtualForceSensor,
        rejected: Counter[str],
        options: SensorOptions,
        first_s: float,
    ) -> None:
        self.done: TareWindow | None = None
        self._sensor = sensor
        self._options = options
        self._first_s = first_s
        self._rejected = rejected
        self._rejected_at_start = Counter[str]()
        self._window: TareWindow | None = None
        if options.tare is not None:
            window = parse_tare_window(options.tare, first_s)
            self._require_inside(window, math.inf)
            self._window = window._replace(start_s=max(window.start_s, first_s))
        self._must_start = self._window is not None
        self._has_settled = False
        self._first_used_s = math.nan
        self._latest_used_s = math.nan

    def before(self, t_s: float) -> None:
        """Start the recording or take the tare, before the sample of this time [s]."""
        window = self._window
        if window is None or self.done is not None:
            return
        if self._must_start and t_s >= window.start_s:
            self._sensor.start_tare_recording()
            self._rejected_at_start = self._rejected.copy()
            self._must_start = False
        if t_s > window.end_s:
            self._take_tare(window)

    def after(self, t_s: float, status: Status) -> None:
        """Note whether the filters have settled, after the sample of this time [s].

        Without a window of the user's, the automatic one begins then.
        """
        if self._must_start or self.done is not None:
            return
        self._latest_used_s = t_s
        if math.isnan(self._first_used_s):
            self._first_used_s = t_s
        if status is not Status.NOT_TARED:
            return
        self._has_settled = True
        if self._window is None and not self._options.no_tare:
            self._window = TareWindow(t_s, t_s + AUTOMATIC_S)

    def finish(self, last_s: float, *, is_whole: bool) -> None:
        """Take a tare whose window ends with the log.

        Args:
            last_s: Time of the log's last row [s].
            is_whole: The log was read to its end; one that was broken off may end
                before the window.
        """
        window = self._window
        if self._options.no_tare or self.done is not None:
            return
        if window is not None and last_s >= window.end_s:
            self._take_tare(window)
        elif is_whole:
            if self._options.tare is not None and window is not None:
                self._require_inside(window, last_s)
            self._refuse_saturated()
            raise CommandError(
                f"the log ends before the filters have settled and {AUTOMATIC_S:g} s "
                "of free motion were seen, so it cannot be tared"
                f"{self._rejections_since_start}",
                CHOOSE_TARE,
            )

    @property
    def _rejections_since_start(self) -> str:
        rejected = self._rejected - self._rejected_at_start
        if not rejected:
            return ""
        advice = velocity_advice(rejected)
        return f"; samples were rejected, {describe_rejections(rejected)}{advice}"

    def _require_inside(self, window: TareWindow, last_s: float) -> None:
        """Refuse a window that ends before it starts, or lies outside the log."""
        first = f"{self._first_s:.12g} s"
        if not window.start_s < window.end_s:
            raise CommandError(
                f"--tare {self._options.tare}: START must come before END in a log "
                f"whose first stamp is {first}; if the unit is wrong, say --time "
                "COLUMN:UNIT",
                CHOOSE_TARE,
            )
        if self._first_s < window.end_s <= last_s and window.start_s < last_s:
            return
        log = f"runs from {first} to {last_s:.12g} s"
        if math.isinf(last_s):
            log = f"starts at {first}"
        raise CommandError(
            f"--tare {self._options.tare}: lies outside the log, which {log}",
            CHOOSE_TARE,
        )

    def _refuse_saturated(self) -> None:
        """Refuse torques that were beyond their range from the start, if that shows."""
        error = self._sensor.explain_saturation()
        if error is not None:
            count = self._rejected.total()
            text = f"no tare: {count} samples were rejected for torques beyond their"
            raise error.reworded(f"{text} range: {error}")

    def _take_tare(self, window: TareWindow) -> None:
        """Tare the sensor on what was recorded in a window."""
        window = self._used_part(window)
        if not self._has_settled:
            self._refuse_saturated()
            raise CommandError(
                f"no tare from {window}{window.note}: the filters had not settled by "
                f"then"
                f"{self._rejections_since_start}",
                CHOOSE_TARE,
            )
        try:
            tare = self._sensor.tare(ignore_contact=self._options.force_tare)
        except TareError as error:
            text = f"no tare from {window}{window.note}: {error}"
            raise error.reworded(text) from error
        self.done = window._replace(tare=tare)

    def _used_part(self, window: TareWindow) -> TareWindow:
        """Return the part of a window from which samples were used."""
        first_s = self._first_used_s
        latest_s = self._latest_used_s
        part = window
        if first_s > window.start_s + MAX_UNUSED_S:
            part = part._replace(start_s=first_s)
        if latest_s < window.end_s - MAX_UNUSED_S:
            part = part._replace(end_s=latest_s)
        if part == window:
            return window
        return part._replace(note=f" (of {window}; the rest has no samples to use)")
