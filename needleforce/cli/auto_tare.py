"""The tare that `live` and `view` take by themselves."""

import math

from needleforce.cli.advice import describe_error
from needleforce.cli.terminal import CommandError, say
from needleforce.session import InsertionSession, SessionEstimate
from residual import Status, TareError

STEPS_PER_S = 1000.0
"""Steps of a tare in a second: a quarter of a slow loop's time, and it takes about a
second whatever its rate."""

ALL_STEPS_PER_S = 1e12
"""So many that one update does all of a tare."""


class SessionTare:
    """Tares a session after some motion without contact, and again where refused.

    Args:
        every_s: Motion before the first tare, and between two attempts [s].
        at_once: Whether nothing waits for the updates, as in a recording: the next one
            then does all of a tare.

    Raises:
        CommandError: The time is not positive, or infinite.
    """

    def __init__(self, every_s: float, *, at_once: bool = False) -> None:
        if not 0.0 < every_s < math.inf:
            raise CommandError(f"--tare {every_s:g}: expected seconds of free motion")
        self._every_s = every_s
        self._next_s = every_s
        self._steps_per_s = ALL_STEPS_PER_S if at_once else STEPS_PER_S
        self._is_taring = False
        self._update_s = 0.0  # time of the latest update, on the session's clock

    def after(self, session: InsertionSession, estimate: SessionEstimate) -> bool:
        """Start a tare if it is time; it is fitted beside the updates that follow.

        Args:
            session: The session.
            estimate: What its latest update returned.

        Returns:
            Whether it was tared now; why it was not is said on stderr.
        """
        time_s = estimate.time_s
        step_s = time_s - self._update_s
        self._update_s = time_s
        if self._is_taring:
            return self._end(session, time_s)
        is_waiting = time_s <= self._next_s
        if session.tared or estimate.status is not Status.NOT_TARED or is_waiting:
            return False
        try:
            steps = max(1, round(self._steps_per_s * step_s))
            session.start_tare(steps_per_tick=steps)
        except TareError as error:
            self._refuse(error, time_s)
        self._is_taring = session.taring
        return False

    def _end(self, session: InsertionSession, time_s: float) -> bool:
        """Note how a tare has ended, if it has; return whether the session is tared."""
        if session.taring:
            return False
        self._is_taring = False
        if session.tare_refusal is not None:
            self._refuse(session.tare_refusal, time_s)
        return session.tared

    def _refuse(self, error: TareError, time_s: float) -> None:
        """Say why there is no tare, and wait for the next attempt."""
        self._next_s = time_s + self._every_s
        reason = describe_error(error, is_watching=True)
        say(f"no tare at {time_s:.1f} s, {reason}")
