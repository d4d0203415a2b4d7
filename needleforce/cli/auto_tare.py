"""The tare that `live` and `view` take by themselves."""

import math

from needleforce.cli.advice import WATCH_ADVICE, describe_error
from needleforce.cli.terminal import CommandError, say
from needleforce.session import InsertionSession, SessionEstimate
from residual import Status, TareError


class SessionTare:
    """Tares a session after some motion without contact, and again where refused.

    Args:
        every_s: Motion before the first tare, and between two attempts [s].

    Raises:
        CommandError: The time is not positive, or infinite.
    """

    def __init__(self, every_s: float) -> None:
        if not 0.0 < every_s < math.inf:
            raise CommandError(f"--tare {every_s:g}: expected seconds of free motion")
        self._every_s = every_s
        self._next_s = every_s

    def after(self, session: InsertionSession, estimate: SessionEstimate) -> bool:
        """Tare if it is time.

        Args:
            session: The session.
            estimate: What its latest update returned.

        Returns:
            Whether it was tared now; why it was not is said on stderr.
        """
        is_waiting = estimate.time_s <= self._next_s
        if session.tared or estimate.status is not Status.NOT_TARED or is_waiting:
            return False
        self._next_s = estimate.time_s + self._every_s
        try:
            session.tare()
        except TareError as error:
            reason = describe_error(error, WATCH_ADVICE)
            say(f"no tare at {estimate.time_s:.1f} s, {reason}")
        return session.tared
