"""A tare that a service asks for, fitted beside the samples that follow."""

from typing import NamedTuple

from needleforce.session import InsertionSession, SessionEstimate
from residual import TareError


class ServiceAnswer(NamedTuple):
    """What a service answers.

    Attributes:
        success: Whether it was done.
        message: What was done, or why not.
    """

    success: bool
    message: str


class TareRun:
    """Tares a session; a second time it first records free motion anew.

    Args:
        recording_s: Free motion recorded before a second tare [s].

    Attributes:
        is_running: Whether a tare is under way.
    """

    def __init__(self, recording_s: float) -> None:
        self._recording_s = recording_s
        self._fit_from_s: float | None = None
        self._latest_s = 0.0
        self.is_running = False

    def start(self, session: InsertionSession) -> ServiceAnswer | None:
        """Begin a tare; None if its end is to be waited for."""
        if self.is_running:
            return ServiceAnswer(False, "a tare is under way already")
        self.is_running = True
        if session.tared:
            session.start_tare_recording()
            self._fit_from_s = self._latest_s + self._recording_s
            return None
        return self._fit(session, step_s=0.0)

    def after(
        self, session: InsertionSession, estimate: SessionEstimate
    ) -> ServiceAnswer | None:
        """Return how a tare has ended, if it did with this update.

        Args:
            session: The session.
            estimate: What its latest update returned.
        """
        step_s = estimate.time_s - self._latest_s
        self._latest_s = estimate.time_s
        if not self.is_running:
            return None
        if self._fit_from_s is not None:
            if estimate.time_s < self._fit_from_s:
                return None
            self._fit_from_s = None
            return self._fit(session, step_s)
        return self._end(session)

    def _fit(self, session: InsertionSession, step_s: float) -> ServiceAnswer | None:
        """Begin to fit what was recorded."""
        try:
            # Steps of the fit in a second of samples: it takes about a second at any
            # rate.
            steps_per_s = 1000.0
            session.start_tare(steps_per_tick=max(1, round(steps_per_s * step_s)))
        except TareError as error:
            self.is_running = False
            return ServiceAnswer(False, f"{error}; {error.advice}")
        return None

    def _end(self, session: InsertionSession) -> ServiceAnswer | None:
        """Return how the fit has ended; None while it goes on."""
        if session.taring:
            return None
        self.is_running = False
        refusal = session.tare_refusal
        if refusal is not None:
            return ServiceAnswer(False, f"{refusal}; {refusal.advice}")
        return ServiceAnswer(True, "tared")
