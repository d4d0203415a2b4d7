"""Predicts where the arm will be once a command acts, from those on their way.

    q(t + T) = q(t) + integral of the commands sent within T before t

with the delay T from command to measured motion (Smith, Chem. Eng. Prog. 1957). An
error of T adds an error of at most that time times the speed of a joint.
"""

import math
from collections import deque

import numpy as np

from foundation.arrays import Array
from needleforce.control.errors import SettingError, require_positive

MAX_DELAY_s = 0.3
"""No loop of control lives with longer delays."""


class DelayPrediction:
    """Remembers commands until the measured positions show them.

    Args:
        joints: Number n of joints.
        delay_s: The delay T, as `needleforce lag` measures it; 0 for no prediction.

    Attributes:
        motion_ahead_rad: How far the joints will move beyond what is measured now,
            shape (n,).

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
        self._joints = joints
        self._commands = deque[tuple[float, Array]]()  # a time, and the velocity in it
        self.reset()

    def reset(self) -> None:
        """Forget what was commanded, for an arm that has not followed it."""
        self._commands.clear()
        self._commands_s = 0.0
        self.motion_ahead_rad = np.zeros(self._joints)

    def note_command(self, dq_rad_s: Array, dt_s: float) -> None:
        """Remember a velocity, shape (n,), that was commanded for a time until now.

        Of a time beyond the delay only the end counts; what is no positive number is
        left out.
        """
        if self._delay_s == 0.0 or not 0.0 < dt_s < math.inf:
            return
        dt_s = min(dt_s, self._delay_s)
        self._commands.append((dt_s, dq_rad_s))
        self._commands_s += dt_s
        self.motion_ahead_rad = self.motion_ahead_rad + dt_s * dq_rad_s
        while (shown_s := self._commands_s - self._delay_s) > 0.0:
            oldest_s, oldest_rad_s = self._commands.popleft()
            if shown_s < oldest_s:
                self._commands.appendleft((oldest_s - shown_s, oldest_rad_s))
            shown_s = min(shown_s, oldest_s)
            self._commands_s -= shown_s
            self.motion_ahead_rad = self.motion_ahead_rad - shown_s * oldest_rad_s
