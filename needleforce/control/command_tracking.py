"""Does an arm follow? Its commanded and its measured motion of the last second."""

import math

import numpy as np

from foundation.arrays import Array

MEMORY_s = 1.0
"""Memory of both motions: a joint that drifts shows within it."""

FOLLOWING_LAG_s = 0.03
"""Time by which an arm may lag behind its commands."""

MAX_LAG_FRACTION = 0.5
"""Fraction of the commanded path by which an arm may be behind it."""

MIN_PATH_rad = 2e-3
"""Least motion that is compared: noise and backlash stay below."""


class CommandTracking:
    """Compares commanded and measured motion of the joints.

    Args:
        max_rad: Motion of a joint that was not commanded, at most.
    """

    def __init__(self, max_rad: float) -> None:
        self._max_rad = max_rad
        self.pause()

    def restart(self) -> None:
        """Forget the motion so far."""
        self._path_rad = 0.0
        self._measured_rad = np.zeros(1)
        self._commanded_rad = np.zeros(1)

    def pause(self) -> None:
        """Stop comparing: the arm is not commanded and may go where others lead it."""
        self._position_rad: Array | None = None
        self.restart()

    def check(self, position_rad: Array, command_rad_s: Array, step_s: float) -> str:
        """Return what is wrong after one cycle; empty if the arm follows.

        Args:
            position_rad: Where the joints are, shape (n,), in an array of its own.
            command_rad_s: Velocity commanded in this cycle, shape (n,).
            step_s: Time of the cycle.
        """
        decay = math.exp(-step_s / MEMORY_s)
        if self._position_rad is None:
            self._position_rad = position_rad
        moved_rad = position_rad - self._position_rad
        self._position_rad = position_rad
        self._measured_rad = decay * (self._measured_rad + moved_rad)
        self._commanded_rad = decay * (self._commanded_rad + step_s * command_rad_s)
        speed_rad_s = math.sqrt(float(command_rad_s.dot(command_rad_s)))
        self._path_rad = decay * (self._path_rad + step_s * speed_rad_s)
        lag_rad = FOLLOWING_LAG_s * speed_rad_s
        deviation_rad = self._commanded_rad - self._measured_rad
        commanded_rad = math.sqrt(float(self._commanded_rad.dot(self._commanded_rad)))
        behind_rad = float(deviation_rad.dot(self._commanded_rad)) / max(
            commanded_rad,
            1e-9,  # finite where there was no motion
        )
        if behind_rad > MAX_LAG_FRACTION * self._path_rad + MIN_PATH_rad + lag_rad:
            return "the arm does not follow its commands"
        largest_rad = float(np.abs(deviation_rad).max())
        if largest_rad > self._max_rad + lag_rad:
            return f"a joint has moved by {largest_rad:.2g} rad that were not commanded"
        return ""
