"""When a session is tared: when a program asks for it, or after some free motion.

The tare itself is fitted beside the updates, see `InsertionSession.start_tare`.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

from residual import Status, TareError

if TYPE_CHECKING:
    from needleforce.session import InsertionSession, SessionEstimate


class TareRun:
    """A tare of a session, from the call that asks for it to its end.

    Args:
        steps_per_s: Steps of the fit in a second of samples. With a thousand a tare
            takes about a second whatever the loop's rate, and a quarter of the time of
            a slow loop.

    Attributes:
        is_running: Whether a tare is under way.
        refusal: Why the latest one was refused; None if it was not.
    """

    def __init__(self, steps_per_s: float = 1e3) -> None:
        self.is_running = False
        self.refusal: TareError | None = None
        self._steps_per_s = steps_per_s
        self._fit_from_s = 0.0  # time at which recording ends, on the session's clock
        self._update_s = 0.0  # time of the latest update, and of the step before it
        self._step_s = 0.0

    def start(self, session: "InsertionSession", *, recording_s: float = 0.0) -> None:
        """Begin a tare, unless one is under way; `is_running` says whether it could.

        Args:
            session: The session, at rest in free air.
            recording_s: Free motion that is recorded first; 0 for a tare on what is
                recorded already.
        """
        if self.is_running:
            return
        self.refusal = None
        self.is_running = True
        if recording_s > 0.0:
            session.start_tare_recording()
            self._fit_from_s = self._update_s + recording_s
        else:
            self._fit(session)

    def after(self, session: "InsertionSession", estimate: "SessionEstimate") -> bool:
        """Go on after an update of the session.

        Args:
            session: The session.
            estimate: What its latest update returned.

        Returns:
            Whether a tare has ended with it, for better or worse: see `refusal`.
        """
        self._step_s = estimate.time_s - self._update_s
        self._update_s = estimate.time_s
        if not self.is_running:
            return False
        if self._fit_from_s > 0.0:
            if estimate.time_s >= self._fit_from_s:
                self._fit(session)
        elif not session.taring:
            self.is_running = False
            if not session.tared:
                self.refusal = session.tare_refusal or TareError(
                    "the tare was given up: another recording began meanwhile"
                )
        return not self.is_running

    def _fit(self, session: "InsertionSession") -> None:
        """Begin to fit what was recorded."""
        self._fit_from_s = 0.0
        steps = max(1, round(self._steps_per_s * self._step_s))
        try:
            session.start_tare(steps_per_tick=steps)
        except TareError as error:
            self.is_running = False
            self.refusal = error


class AutoTare:
    """Tares a session after some motion without contact, and again where refused.

    Args:
        every_s: Motion before the first tare, and between two attempts.
        at_once: Whether nothing waits for the updates, as in a recording: the next one
            then does all of a tare.
        on_refusal: Takes the time [s] at which a tare was refused, and why.
    """

    def __init__(
        self,
        every_s: float,
        *,
        at_once: bool = False,
        on_refusal: Callable[[float, TareError], None] = lambda time_s, error: None,
    ) -> None:
        self._every_s = every_s
        self._next_s = every_s
        self._run = TareRun(1e12) if at_once else TareRun()
        self._on_refusal = on_refusal

    def after(self, session: "InsertionSession", estimate: "SessionEstimate") -> bool:
        """Start a tare if it is time; it is fitted beside the updates that follow.

        Args:
            session: The session.
            estimate: What its latest update returned.

        Returns:
            Whether it was tared now.
        """
        time_s = estimate.time_s
        has_ended = self._run.after(session, estimate)
        is_untared = estimate.status is Status.NOT_TARED and not session.tared
        if is_untared and not has_ended and time_s > self._next_s:
            self._run.start(session)
            has_ended = not self._run.is_running
        if has_ended and self._run.refusal is not None:
            self._next_s = time_s + self._every_s
            self._on_refusal(time_s, self._run.refusal)
        return has_ended and session.tared
