"""The joint velocity that an arm is sent: held for some cycles, then braked to rest."""

import math

import numpy as np

from foundation.arrays import Array

MAX_SILENT_CYCLES = 5
"""A velocity is held for so many cycles without a new one; then the arm brakes."""

BRAKE_ACCELERATION_rad_s2 = 5.0
"""Below the least limit of a Franka joint (7.5 rad/s^2, joint 2 of the FER)."""

BRAKE_JERK_rad_s3 = 2500.0
"""Below the least limit of a Franka joint (3750 rad/s^3, joint 2 of the FER)."""

PLANNED_FRACTION = 0.6
"""Of the jerk: the rest makes up for what a cycle's step adds."""


class VelocityHold:
    """Gives the velocity of every cycle; without a new command it brakes.

    Braking is limited in acceleration and jerk, joint by joint, from the velocity that
    was really sent.

    Args:
        joints: How many there are.
        period_s: Of a cycle.
    """

    def __init__(self, joints: int, period_s: float) -> None:
        self._period_s = period_s
        self._velocity_rad_s = np.zeros(joints)  # that was sent last
        self._acceleration_rad_s2 = np.zeros(joints)  # between the last two
        self._command_rad_s = np.zeros(joints)
        self._silent_cycles = MAX_SILENT_CYCLES

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing moves any more."""
        return not (self._velocity_rad_s.any() or self._acceleration_rad_s2.any())

    def command(self, velocity_rad_s: Array) -> None:
        """Take the velocity of the coming cycles, shape (n,)."""
        self._command_rad_s = velocity_rad_s
        self._silent_cycles = 0

    def brake(self) -> None:
        """Forget the command."""
        self._silent_cycles = MAX_SILENT_CYCLES

    def advance(self) -> Array:
        """Return the velocity of the next cycle, shape (n,) [rad/s]."""
        if self._silent_cycles < MAX_SILENT_CYCLES:
            self._silent_cycles += 1
            velocity_rad_s = self._command_rad_s
        else:
            velocity_rad_s = self._braked_rad_s()

        change_rad_s = velocity_rad_s - self._velocity_rad_s
        self._acceleration_rad_s2 = change_rad_s / self._period_s
        self._velocity_rad_s = velocity_rad_s
        return velocity_rad_s

    def _braked_rad_s(self) -> Array:
        """Return the velocity one cycle on, on the way to rest."""
        dt_s = self._period_s
        jerk_step_rad_s2 = BRAKE_JERK_rad_s3 * dt_s
        speed_rad_s = np.abs(self._velocity_rad_s)
        # So much deceleration can be taken back before the joint is at rest.
        planned_jerk_rad_s3 = PLANNED_FRACTION * BRAKE_JERK_rad_s3
        room_rad_s2 = np.sqrt(2.0 * planned_jerk_rad_s3 * speed_rad_s)
        wanted_rad_s2 = -np.sign(self._velocity_rad_s) * np.minimum(
            room_rad_s2, BRAKE_ACCELERATION_rad_s2
        )
        acceleration_rad_s2 = np.clip(
            wanted_rad_s2,
            self._acceleration_rad_s2 - jerk_step_rad_s2,
            self._acceleration_rad_s2 + jerk_step_rad_s2,
        )
        velocity_rad_s = self._velocity_rad_s + acceleration_rad_s2 * dt_s
        # A joint rests where neither this step nor the next exceeds the jerk.
        last_rad_s2 = -self._velocity_rad_s / dt_s
        is_slow = np.abs(last_rad_s2) <= jerk_step_rad_s2
        last_change_rad_s2 = np.abs(last_rad_s2 - self._acceleration_rad_s2)
        is_last = is_slow & (last_change_rad_s2 <= jerk_step_rad_s2)
        return np.where(is_last, 0.0, velocity_rad_s)


def usable_velocity(velocity_rad_s: object, joints: int) -> Array | None:
    """Return a velocity as an array, shape (n,); None if it cannot be commanded."""
    try:
        velocity = np.array(velocity_rad_s, dtype=float)
    except (TypeError, ValueError):
        return None

    is_finite = velocity.shape == (joints,) and math.isfinite(velocity.sum())
    return velocity if is_finite else None
