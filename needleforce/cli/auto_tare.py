"""The tare of a session that `live` and `view` take by themselves."""

import math

from foundation.advice import Advice, Message
from needleforce.cli.terminal import CommandError, say
from needleforce.session import InsertionSession, SessionEstimate
from residual import Status, TareError
from residual.advice import TareAdvice

_ADVICES: dict[Advice, str] = {
    TareAdvice.IGNORE_CONTACT: "",
    TareAdvice.COMPENSATE_GRAVITY: "give needleforce force --gravity-compensated",
}
"""Words of the command for what a refused tare advises; it has no option for some."""


class SessionTare:
    """Tares a session after so much motion without contact, and again where that is
    refused.
    """

    def __init__(self, every_s: float) -> None:
        if not 0.0 < every_s < math.inf:
            raise CommandError(f"--tare {every_s:g}: expected seconds of free motion")
        self._every_s = self._next_s = every_s

    def after(self, session: InsertionSession, now: SessionEstimate) -> bool:
        """Tare if it is time, after an update; whether it has."""
        if (
            session.tared
            or now.status is not Status.NOT_TARED
            or now.time_s <= self._next_s
        ):
            return False
        self._next_s = now.time_s + self._every_s
        try:
            session.tare()
        except TareError as error:
            reason = Message.of(error).in_words(_ADVICES)
            say(f"no tare at {now.time_s:.1f} s: {reason}")
        return session.tared
