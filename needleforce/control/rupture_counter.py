"""Ruptures, counted by a program that knows how the needle is commanded.

By itself the identification must wait whether a fall of the force is a needle that
brakes. At a steady command it is none, but a beating heart, a jerky arm and slow noise
make the force fall, too, again and again. So a fall counts if it is large, or likely a
rupture, and several times the largest of the last seconds; with an alarm of the
identification, a confirmed one, any larger one counts.
"""

import math

from identification.estimate import Estimate, RuptureState

FORCE_LAG_s = 3e-3
"""Time constant of the force: it removes the noise of single samples."""

PEAK_MEMORY_s = 0.1
"""Time constant of the force before a fall: most ruptures are over
sooner."""

MAX_RISE_N_per_s = 15.0
"""A force that rises more quickly is a jerk of the arm, no push of tissue."""

BLOCK_s = 0.2
"""Falls newer than this are not ordinary yet: they may be the rupture itself."""

ORDINARY_MEMORY_s = 5.0
"""Time constant with which the largest ordinary fall is forgotten: over a
breath or two."""

RUPTURE_s = 0.3
"""So long after a counted rupture the force may still fall because of it."""

SETTLED_IN_TISSUE_s = 1.0
"""Time in tissue after which a heartbeat has been felt, so that falls can be
compared."""

LARGE_FALL = 0.03
"""Fraction of the force whose fall is large."""

LARGE_FIRST_FALL = 0.15
"""The same before `SETTLED_IN_TISSUE_s`, when no heartbeat is known yet."""

LARGE_FALL_N = 0.08
"""A smaller fall is not large, however small the force is: the force has such
errors."""

ORDINARY_RATIO = 2.0
"""A rupture is a fall by so many times the ordinary one."""

MIN_FALL_N = 0.03
"""Least fall of a likely rupture, and of an alarm: noise of the force stays below."""

MIN_FALL_s = 1.5e-3
"""A fall that does not last so long is a jerk of the arm: at 1 kHz, two samples."""

MIN_DISTANCE_m = 3e-3
"""Two ruptures less far apart are one."""


class RuptureCounter:
    """Counts the layers that a needle has left; see the module.

    Attributes:
        count: Ruptures so far.
    """

    def __init__(self) -> None:
        self.count = 0
        self._rupture_m = -math.inf  # depth of the last rupture
        self._force_N = 0.0
        self._peak_N = 0.0  # force before a fall
        self._in_tissue_s = 0.0
        self._fallen_s = 0.0  # time since a likely rupture
        self._ordinary_N = 0.0  # largest fall of the last seconds that was no rupture
        self._block_N = 0.0  # largest fall of the present block
        self._previous_N = 0.0  # largest fall of the block before it
        self._block_s = 0.0  # age of the block; below zero a rupture still falls

    def update(
        self,
        identification: Estimate,
        axial_N: float,
        depth_m: float,
        dt_s: float,
        *,
        is_steady: bool,
    ) -> bool:
        """Return whether one more layer has been left.

        Args:
            identification: Of the force sensor.
            axial_N: Its axial force; a sample that is not finite is skipped.
            depth_m: Of the tip.
            dt_s: Time since the last call.
            is_steady: Whether the commanded speed is.
        """
        if not math.isfinite(axial_N):
            return False
        in_contact = identification.in_contact
        in_tissue_s = self._in_tissue_s + (dt_s if in_contact else -dt_s)
        self._in_tissue_s = max(in_tissue_s, 0.0)
        self._filter_force(axial_N, dt_s, is_steady)
        fall_N = self._peak_N - self._force_N
        self._note_fall(fall_N if in_contact else min(fall_N, LARGE_FALL_N), dt_s)
        alarm = identification.rupture
        if alarm:
            fall_N = max(self._peak_N, alarm.force_N) - self._force_N
        is_likely = is_steady and self._is_likely(identification, fall_N)
        self._fallen_s = self._fallen_s + dt_s if is_likely else 0.0
        is_alarm = alarm is not None and fall_N > max(self._ordinary_N, MIN_FALL_N)
        is_rupture = in_contact and (is_alarm or self._fallen_s > MIN_FALL_s)
        rupture_m = alarm.depth_m if alarm else depth_m
        if not is_rupture or rupture_m < self._rupture_m + MIN_DISTANCE_m:
            return False
        self.count += 1
        self._rupture_m = depth_m
        self._in_tissue_s = 0.0
        # Its own fall is left out.
        self._block_s = -RUPTURE_s
        self._block_N = 0.0
        self._previous_N = 0.0
        return True

    def _filter_force(self, axial_N: float, dt_s: float, is_steady: bool) -> None:
        """Smooth the force, and let the force before a fall follow it slowly.

        What falls after a counted rupture is that rupture, and what falls while the
        command changes is the motion: then nothing counts as a fall.
        """
        self._force_N -= math.expm1(-dt_s / FORCE_LAG_s) * (axial_N - self._force_N)
        self._peak_N += dt_s / PEAK_MEMORY_s * (self._force_N - self._peak_N)
        if self._block_s < 0.0 or not is_steady:
            self._peak_N = self._force_N
        max_rise_N = MAX_RISE_N_per_s * dt_s
        self._peak_N += min(max(self._force_N - self._peak_N, 0.0), max_rise_N)

    def _note_fall(self, fall_N: float, dt_s: float) -> None:
        """Update the largest fall that was no rupture; newer ones than a block wait."""
        self._block_s += dt_s
        self._block_N = max(self._block_N, fall_N)
        self._ordinary_N *= math.exp(-dt_s / ORDINARY_MEMORY_s)
        if self._block_s > BLOCK_s:
            self._ordinary_N = max(self._ordinary_N, self._previous_N)
            self._previous_N = self._block_N
            self._block_N = 0.0
            self._block_s = 0.0

    def _is_likely(self, identification: Estimate, fall_N: float) -> bool:
        """Return whether a fall at a steady command is likely a rupture."""
        is_settled = self._in_tissue_s > SETTLED_IN_TISSUE_s
        is_expected = identification.rupture_state is RuptureState.EXPECTED
        fraction = LARGE_FALL if is_settled else LARGE_FIRST_FALL
        is_large = fall_N > max(fraction * self._peak_N, LARGE_FALL_N)
        is_candidate = (is_settled and is_expected) or (
            is_large and self._in_tissue_s > RUPTURE_s + BLOCK_s
        )
        return is_candidate and fall_N > max(
            ORDINARY_RATIO * self._ordinary_N, MIN_FALL_N
        )
