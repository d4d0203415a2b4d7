"""A session that tares itself: over a recording, or beside an arm.

log = read_log("insertion.csv", required=["q", "tau"], joints=robot.joint_names)
for q_rad, estimate in replay_session(InsertionSession(robot), log):
print(estimate.time_s, estimate.identification.tip_force_N)
"""

from collections.abc import Callable, Iterator
from itertools import repeat
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.recordings import Log
from needleforce.session import InsertionSession, SessionEstimate
from residual import Status, TareError


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
        # A thousand steps in a second: a quarter of a slow loop's time, and the tare
        # takes about a second whatever the loop's rate.
        self._steps_per_s = 1e12 if at_once else 1e3
        self._on_refusal = on_refusal
        self._is_taring = False
        self._update_s = 0.0  # time of the latest update, on the session's clock

    def after(self, session: InsertionSession, estimate: SessionEstimate) -> bool:
        """Start a tare if it is time; it is fitted beside the updates that follow.

        Args:
            session: The session.
            estimate: What its latest update returned.

        Returns:
            Whether it was tared now.
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
        """Report why there is no tare, and wait for the next attempt."""
        self._next_s = time_s + self._every_s
        self._on_refusal(time_s, error)


class ReplayedSample(NamedTuple):
    """A sample of a recording, and what the session made of it.

    Attributes:
        q_rad: Joint positions, shape (n,).
        estimate: What the session estimates.
    """

    q_rad: Array
    estimate: SessionEstimate


def replay_session(
    session: InsertionSession,
    log: Log,
    tare: AutoTare | None = None,
) -> Iterator[ReplayedSample]:
    """Run a session over a recording of joint signals, sample by sample.

    The first sample has the time step of the second.

    Args:
        session: A session that has seen nothing.
        log: The recording, with the channels ``q``, ``tau`` and perhaps ``dq``.
        tare: When it is tared; None for after 4 s of motion without contact.
    """
    if tare is None:
        tare = AutoTare(4.0, at_once=True)
    velocities = log["dq_rad_s"] if "dq_rad_s" in log else repeat(None)
    steps_s = np.diff(log.t_s, prepend=2.0 * log.t_s[0] - log.t_s[1]).tolist()
    signals = zip(log["q_rad"], velocities, log["tau_Nm"], steps_s, strict=False)
    for q_rad, dq_rad_s, tau_Nm, step_s in signals:
        estimate = session.update(q_rad, dq_rad_s, tau_Nm, step_s)
        tare.after(session, estimate)
        yield ReplayedSample(q_rad, estimate)
