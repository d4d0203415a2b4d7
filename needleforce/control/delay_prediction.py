"""Predicts where the arm will be once a command acts, from those on their way.

    q(t + T) = q(t) + integral of the commands sent within T before t

with the delay T from command to measured motion (Smith, Chem. Eng. Prog. 1957). An
error of T adds an error of at most that time times the speed of a joint.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.control.errors import SettingError
from needleforce.control.setting_checks import require_positive

MAX_DELAY_s = 0.3
"""No loop of control lives with longer delays."""


class _Mark(NamedTuple):
    """What had been commanded at a time.

    Attributes:
        time_s: Since the start.
        commanded_rad: Motion commanded until then, shape (n,).
    """

    time_s: float
    commanded_rad: Array


class DelayPrediction:
    """Remembers commands until the measured positions show them.

    Args:
        joints: Number n of joints.
        delay_s: The delay T, as `needleforce lag` measures it; 0 for no prediction.

    Raises:
        SettingError: The delay is negative, not finite or above `MAX_DELAY_s`.
    """

    def __init__(self, joints: int, delay_s: float) -> None:
        require_positive({"delay_s": delay_s}, or_zero=("delay_s",))
        if delay_s > MAX_DELAY_s:
            raise SettingError(
                f"delay_s is {delay_s:g}, expected at most {MAX_DELAY_s:g} seconds",
            )
        self._delay_s = float(delay_s)
        self._rest = _Mark(0.0, np.zeros(joints))
        self._marks = deque[_Mark]()
        self.reset()

    def reset(self) -> None:
        """Forget what was commanded, for an arm that has not followed it."""
        self._marks.clear()
        self._marks.append(self._rest)

    def note_command(self, dq_rad_s: Array, dt_s: float) -> None:
        """Remember a velocity, shape (n,), that was commanded for a time until now.

        Of a time beyond the delay only the end counts; what is no positive number is
        left out.
        """
        if self._delay_s > 0.0 and 0.0 < dt_s < math.inf:
            dt_s = min(dt_s, self._delay_s)
            time_s, commanded_rad = self._marks[-1]
            mark = _Mark(time_s + dt_s, commanded_rad + dt_s * dq_rad_s)
            self._marks.append(mark)
            self._forget_before(mark.time_s - self._delay_s)

    def find_motion_ahead(self) -> Array:
        """Return how far joints will move beyond what is measured now, shape (n,)."""
        newest = self._marks[-1]
        if len(self._marks) < 2:
            return self._rest.commanded_rad
        acted_rad = self._commanded_until(newest.time_s - self._delay_s)
        return newest.commanded_rad - acted_rad

    def _forget_before(self, time_s: float) -> None:
        """Forget marks that lie before the last one at a time, or before it."""
        while self._marks[1].time_s <= time_s and len(self._marks) > 2:
            self._marks.popleft()

    def _commanded_until(self, time_s: float) -> Array:
        """Return the motion commanded until a time between the two oldest marks."""
        before = self._marks[0]
        after = self._marks[1]
        part = (time_s - before.time_s) / (after.time_s - before.time_s)
        change_rad = after.commanded_rad - before.commanded_rad
        return before.commanded_rad + min(max(part, 0.0), 1.0) * change_rad
