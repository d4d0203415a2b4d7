"""Tares a sensor while a log runs through it."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from residual.command.errors import CommandError
from residual.command.tare_window import TareOption, TareWindow
from residual.errors import TareError, VelocityError
from residual.tare import Tare
from residual.virtual_force_sensor import VirtualForceSensor
from residual.wrench_estimate import Status

AUTOMATIC_S = 2.0
"""Without a choice of the user's, so much from the start of the log is taken for free motion [s]:
whoever records an insertion starts before contact, but not long before."""

_COLUMNS = "--dq says names, unit and factor of the columns, as in --dq dq_*:deg/s or dq_*:rad/s:-1"
_CHOICES = "choose where the needle is free with --tare START:END, or go without with --no-tare"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TareRequest:
    """What the user wants.

    Attributes:
        where: Where to tare; ``automatic`` for the first `AUTOMATIC_S` once the filters have
            settled, None for no tare.
        force: Whether to tare even where contact is seen.
    """

    where: TareOption | Literal["automatic"] | None = "automatic"
    force: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TareDone:
    """A tare that was taken.

    Attributes:
        window: Where.
        tare: The fit.
    """

    window: TareWindow
    tare: Tare

    @property
    def largest_offset_Nm(self) -> float:
        """Largest constant offset of a joint [Nm]."""
        return float(np.abs(self.tare.mean[self.tare.basis.groups["offset"]]).max())


class Taring:
    """Starts the recording and takes the tare when their times come.

    Args:
        sensor: The sensor that the log runs through.
        request: What the user wants.
        first_s: First stamp of the log [s].

    Raises:
        CommandError: The window does not suit the log.
    """

    def __init__(self, sensor: VirtualForceSensor, request: TareRequest, first_s: float) -> None:
        self._sensor, self._request, self._first_s = sensor, request, first_s
        self._window: TareWindow | None = None
        if isinstance(request.where, TareOption):
            self._window = request.where.window(first_s)
            request.where.require_inside(self._window, first_s, math.inf)
        self._must_start = self._window is not None
        self._seen = 0
        self.done: TareDone | None = None

    def before(self, t_s: float) -> None:
        """Act before the sample of time ``t_s`` [s] is taken.

        Raises:
            CommandError: The tare was due and is refused.
        """
        window = self._window
        if window is None or self.done is not None:
            return
        if self._must_start and t_s >= window.start_s:
            self._sensor.start_recording()
            self._must_start = False
        if t_s > window.end_s:
            self._tare(window)

    def after(self, t_s: float, status: Status) -> None:
        """Learn from the status of the sample of time ``t_s`` [s] when the filters have settled."""
        if status is not Status.NOT_TARED or self._must_start:
            return
        self._seen += 1
        if self._request.where == "automatic" and self._window is None:
            self._window = TareWindow(start_s=t_s, end_s=t_s + AUTOMATIC_S)

    def finish(self, last_s: float, *, is_whole: bool) -> None:
        """Take a tare whose window ends with the log.

        Args:
            last_s: Latest stamp of the log [s].
            is_whole: Whether the log was read to its end; if not, it may end before the tare.

        Raises:
            CommandError: It is refused, or the log is too short for a tare.
        """
        where, window = self._request.where, self._window
        if where is None or self.done is not None:
            return
        if window is None or last_s < window.end_s:
            if not is_whole:
                return
            if isinstance(where, TareOption) and window is not None:
                where.require_inside(window, self._first_s, last_s)
            raise CommandError(
                f"the log ends before the filters have settled and {AUTOMATIC_S:g} s of free "
                f"motion were seen, so it cannot be tared; {_CHOICES}"
            )
        self._tare(window)

    def _tare(self, window: TareWindow) -> None:
        what = f"no tare from {window}"
        if not self._seen:
            raise CommandError(
                f"{what}: the filters had not settled by then; choose a window that ends later"
            )
        try:
            tare = self._sensor.tare(force=self._request.force)
        except TareError as error:
            reason = str(error).replace("force=True", "--force-tare")
            choices = _COLUMNS if isinstance(error, VelocityError) else f"Or {_CHOICES}"
            raise CommandError(f"{what}: {reason}. {choices}") from error
        self.done = TareDone(window=window, tare=tare)
