"""How far a joint signal may jump between two samples."""

import math

import numpy as np
from numpy.typing import NDArray

from speedup import Vector, compiled
from urdf import Robot

SIGMAS = 12.0
"""A jump within this many standard deviations of the signal's noise is noise."""
TORQUE_SHARE = 0.02
"""Share of the effort limit by which a torque may step for no reason. On the LWR that is 3.5 Nm at
the shoulder, 5 N at 0.65 m, and 0.8 Nm at the wrist; what a force on the tool explains may step by
more, see `residual.contact_step`."""
LEAST_TORQUE_NM = 0.7
"""Never less than this: the gears of a moving wrist of 12 Nm make as much in a millisecond."""
TORQUE_SHARE_PER_S = 2.0
"""Share of the effort limit per second, beyond the step: for lost samples."""
ACCELERATION_RAD_S2 = 20.0
"""An arm that inserts a needle stays far below."""
LEAST_POSITION_RAD = 1e-4
UNKNOWN_EFFORT_NM = 300.0
"""Stands in where a description gives no effort limit: the shoulder of an arm for ten kilograms.
Torques from motor currents step by 20 Nm there where the friction of its gears turns round."""
CLOCK_S = 5e-3
"""Time by which the stamps of a computer may be off from those of the robot [s]. At the speeds of a
needle it is nothing: 0.1 rad/s make half a milliradian of it."""
LONGEST_HELD_S = 0.1
"""No source of positions is slower than ten samples a second."""
HELD_ACCELERATION_RAD_S2 = 4.0
"""Change of an estimated velocity that positions do not tell while they repeat. Far less than what
a single step may be off by: an arm at rest repeats its positions for ever."""


@compiled
def fresh_distance(now: Vector, last: Vector, weight: Vector, joints: int) -> float:
    """Root of the sum of squares of the weighted differences of two samples.

    Infinite if all positions or all torques repeat.

    Args:
        now: A sample, positions first and torques last, shape (2 n,) or (3 n,).
        last: The one before.
        weight: What differences are multiplied with, not 0.
        joints: n.
    """
    off = (now - last) * weight
    if (off[0] == 0.0 and not off[:joints].any()) or (off[-1] == 0.0 and not off[-joints:].any()):
        return math.inf
    return math.sqrt(np.vdot(off, off))  # `dot` warns of an overflow


class SpikeGates:
    """Largest believable jump of position (less its velocity times the time), velocity and torque.

    Args:
        robot: Gives the effort limits.
        has_velocity: Whether samples carry a velocity.
        delay_s: Age of the velocity that positions are foretold with [s].
    """

    def __init__(self, robot: Robot, *, has_velocity: bool, delay_s: float) -> None:
        n = self._joints = robot.nv
        self._has_velocity, self._delay_s = has_velocity, delay_s
        limit = robot.effort_limit_Nm
        self.effort_Nm = np.where(np.isfinite(limit) & (limit > 0), limit, np.inf)
        """Effort limits [Nm], infinite where the description gives none, shape (n,)."""
        self._effort = np.where(np.isfinite(self.effort_Nm), limit, UNKNOWN_EFFORT_NM)
        self.learn(np.zeros((3 if has_velocity else 2) * n))

    def learn(self, noise: NDArray[np.float64]) -> None:
        """Tell the noise of all signals: position, velocity if there is one, torque."""
        n = self._joints
        # The difference of two samples has sqrt(2) times the noise of one.
        self._base = SIGMAS * np.sqrt(2.0) * noise
        self._base[:n] += LEAST_POSITION_RAD
        self._base[-n:] += np.maximum(TORQUE_SHARE * self._effort, LEAST_TORQUE_NM)
        sure = self._base.copy()
        if self._has_velocity:
            sure[n:-n] += ACCELERATION_RAD_S2 * 1e-4
        self.narrowest = float(sure.min())
        """What is surely nearer than this is within all gates; a NaN is not."""
        self.weight = self.narrowest / sure
        """What differences are multiplied with before, at most 1, shape of a sample."""

    def is_near(self, off: NDArray[np.float64]) -> bool:
        """Whether a difference is within the narrowest gates, all signals together."""
        return math.hypot(*(off * self.weight).tolist()) < self.narrowest

    @property
    def torque_Nm(self) -> NDArray[np.float64]:
        """Torque that may step within no time, shape (n,)."""
        return self._base[-self._joints :]

    def beyond(
        self,
        off: NDArray[np.float64],
        velocity: NDArray[np.float64],
        dt_s: float,
        swept_rad: NDArray[np.float64] | None = None,
    ) -> NDArray[np.bool_]:
        """Which differences are beyond what an arm can do.

        Args:
            off: Differences of all signals, positions less what the velocity foretells.
            velocity: Joint velocity [rad/s], shape (n,).
            dt_s: Time between the two samples [s].
            swept_rad: See `sweep`; None if positions had not repeated.

        Returns:
            A row for each signal, shape (k, n).
        """
        n = self._joints
        gate = self._base.copy()
        late_s = dt_s + self._delay_s
        # A tick too: a sample that comes twice is no spike.
        unsure_s = dt_s + CLOCK_S
        gate[:n] += np.abs(velocity) * unsure_s + ACCELERATION_RAD_S2 * dt_s * late_s
        if swept_rad is not None:
            gate[:n] += swept_rad
        if self._has_velocity:
            gate[n:-n] += ACCELERATION_RAD_S2 * dt_s
        gate[-n:] += TORQUE_SHARE_PER_S * dt_s * self._effort
        return (np.abs(off) > gate).reshape(-1, n)

    def sweep(
        self,
        swept_rad: NDArray[np.float64] | None,
        velocity: NDArray[np.float64],
        dt_s: float,
        held_s: float,
    ) -> NDArray[np.float64]:
        """Way that positions may owe after one more sample in which they repeated [rad].

        A source of positions that is slower than the clock makes up for it in one step.

        Args:
            swept_rad: After the sample before, shape (n,); None if that one was new.
            velocity: Of this sample [rad/s], shape (n,).
            dt_s: Time between the two [s].
            held_s: Time for which positions have repeated [s].
        """
        speed = np.abs(velocity)
        if not self._has_velocity:
            speed = speed + HELD_ACCELERATION_RAD_S2 * min(held_s, LONGEST_HELD_S)
        if swept_rad is None:
            return speed * dt_s
        # Forgets, so that noise of the velocity does not add up while an arm rests.
        return swept_rad * max(1.0 - dt_s / LONGEST_HELD_S, 0.0) + speed * dt_s
