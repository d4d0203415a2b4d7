"""A force that pulls at a needle that advances: no tissue does that.

Tissue resists: it holds the needle back at the tip and along the shaft. A force far
below zero while the needle advances is a fault of the sensor, or a hand that pushes at
the hub. It is no rupture, and nothing is learnt from it. A force that stays there is
taken for the sensor's new zero in the end.
"""

from typing import NamedTuple

PULL_SIGMAS = 3.0
"""Standard deviations below zero from which on a force pulls."""

MIN_PULL_N = 0.1
"""And at least so far below: less is a needle's inertia, or its weight."""

STILL_PULLED = 0.5
"""Part of that below which a force that has pulled still does."""

BRAKING_S = 0.1
"""Time after the last advance for which a needle that brakes counts as advancing."""

BACK_MM = 0.1
"""Way back from the deepest point up to which a needle that is pulled still is."""

BEGIN_BACK_MM = 0.03
"""The same where a pull begins: a tenth of the way over which friction turns, so that a
needle that is drawn back, and held by the tissue, is not taken for one that is pulled.
"""

OVER_S = 0.3
"""A fall is over if the force has not been lower for so long."""

ONSET_S = 0.05
"""Time by which a rupture that the fall looks like may be dated before it."""

MAX_PULL_S = 2.5
"""Longest pull at a steady force, as long as a push on the arm: then the zero has
changed."""


class NetForce(NamedTuple):
    """Force of a block without the zero, and how it was come by.

    Attributes:
        value_N: Its mean.
        std_N: Its standard deviation.
        time_s: Of the block.
        duration_s: Its length.
        is_advancing: Whether the needle advances.
        behind_mm: Way back from the deepest point.
    """

    value_N: float
    std_N: float
    time_s: float
    duration_s: float
    is_advancing: bool
    behind_mm: float


class NeedlePull(NamedTuple):
    """Whether the force pulls at the needle; immutable.

    Attributes:
        idle_s: Time since the needle advanced last.
        is_pulled: Whether the force pulls.
        may_pull: Whether it is so low that it may pull soon.
        peak_N: Force before the present fall.
        peak_s: When the fall began.
        low_N: Lowest force since then.
        low_s: When it was reached.
    """

    idle_s: float = BRAKING_S
    is_pulled: bool = False
    may_pull: bool = False
    peak_N: float = 0.0
    peak_s: float = 0.0
    low_N: float = 0.0
    low_s: float = 0.0

    @property
    def fall_N(self) -> float:
        """How far the force has fallen."""
        return self.peak_N - self.low_N

    def is_new_zero(self, time_s: float) -> bool:
        """Return whether the force has pulled for so long that the zero has changed."""
        return self.is_pulled and time_s - self.low_s > MAX_PULL_S

    def with_force(self, force: NetForce) -> "NeedlePull":
        """Return the same after the force of a block."""
        idle_s = 0.0 if force.is_advancing else self.idle_s + force.duration_s
        limit_N = max(PULL_SIGMAS * force.std_N, MIN_PULL_N)
        may_pull = force.value_N < -STILL_PULLED * limit_N
        may_begin = idle_s < BRAKING_S and force.behind_mm < BEGIN_BACK_MM
        has_begun = may_begin and force.value_N < -limit_N
        is_pulled = has_begun or (self.is_pulled and may_pull)
        is_pulled = is_pulled and force.behind_mm < BACK_MM
        is_over = force.value_N > self.peak_N or force.time_s - self.low_s > OVER_S
        after = self._replace(
            idle_s=idle_s, is_pulled=is_pulled, may_pull=may_pull and not is_over
        )
        if is_over and not is_pulled:
            return after._replace(
                peak_N=force.value_N,
                peak_s=force.time_s,
                low_N=force.value_N,
                low_s=force.time_s,
            )
        # While the force pulls only a clearly lower one counts as a further fall.
        margin_N = STILL_PULLED * limit_N if is_pulled else 0.0
        if force.value_N < self.low_N - margin_N:
            return after._replace(low_N=force.value_N, low_s=force.time_s)
        return after
