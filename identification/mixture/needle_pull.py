"""A force lower than tissue can make it: a fault of the sensor, or a push at the hub.

Tissue resists: it holds the needle back at the tip and along the shaft. Where the
needle advances, or rests where it has advanced to, the force is not below zero. Where
it advances on, the friction of the layers traversed remains in it, whatever ruptures.
Where the needle is drawn back, friction pulls by no more than tissue has pushed before.

A force far below that is no rupture, and nothing is learnt from it. Tissue that moves
with the breath overtakes the needle and pulls at it as well, but slowly, and by no more
than its friction: such a pull is not foreign to tissue. A force that stays far below is
taken for the sensor's new zero in the end.
"""

import math
from typing import NamedTuple

STILL_PULLED = 0.5
"""A pull lasts while the force is below the least one of tissue by more than this
fraction of that distance; a force that is as low may pull soon."""

BRAKING_S = 0.1
"""Time after the last advance for which a needle that brakes counts as advancing."""

ONSET_S = 0.05
"""Time by which a rupture that the fall looks like may be dated before it."""

BELOW_FRICTION_S = 0.15
"""Time for which a force must be below the friction that remains: a speed that falls,
and the friction with it, is known late by so much."""


class NetForce(NamedTuple):
    """Force of a block without the zero, and how it was come by.

    Attributes:
        value_N: Its mean.
        std_N: Its standard deviation.
        time_s: Of the block.
        duration_s: Its length.
        is_advancing: Whether the needle advances.
        behind_mm: Way back from the deepest point.
        is_met: Whether tissue has been met.
        is_outside: Whether the needle has come out of the tissue.
        friction_N: Least friction of the layers traversed, at the present speed.
    """

    value_N: float
    std_N: float
    time_s: float
    duration_s: float
    is_advancing: bool
    behind_mm: float
    is_met: bool = True
    is_outside: bool = False
    friction_N: float = 0.0

    @property
    def limit_N(self) -> float:
        """Distance below the least force of tissue from which on a force pulls."""
        # Standard deviations below the least force of tissue from which on a force
        # pulls
        pull_sigmas = 3.0
        # Least distance below it from which on a force pulls: less is a needle's
        # inertia, or its weight
        min_pull_N = 0.1
        return max(pull_sigmas * self.std_N, min_pull_N)


class NeedlePull(NamedTuple):
    """Whether the force pulls at the needle; immutable.

    Attributes:
        idle_s: Time since the needle advanced last.
        is_pulled: Whether the force pulls.
        is_foreign: Whether it pulls as no tissue does, moving tissue included.
        low_for_s: Time for which it has been so low that it may pull soon.
        below_friction_s: Time for which it has been below the friction that remains.
        highest_N: Highest force with which tissue has pushed.
        friction_N: Least friction of the layers traversed, before the present fall.
        recent_N: Mean force of late.
        quick_N: Most by which the force was lower than that in the present fall.
        peak_N: Force before the present fall.
        peak_s: When the fall began.
        low_N: Lowest force since then.
        low_s: When it was reached.
    """

    idle_s: float = BRAKING_S
    is_pulled: bool = False
    is_foreign: bool = False
    low_for_s: float = 0.0
    below_friction_s: float = 0.0
    highest_N: float = 0.0
    friction_N: float = 0.0
    recent_N: float = 0.0
    quick_N: float = 0.0
    peak_N: float = 0.0
    peak_s: float = 0.0
    low_N: float = 0.0
    low_s: float = 0.0

    @property
    def fall_N(self) -> float:
        """How far the force has fallen."""
        return self.peak_N - self.low_N

    @property
    def may_pull(self) -> bool:
        """Whether the force has just become so low that it may pull soon."""
        # Longest time for which alarms wait whether a force that is low will pull: a
        # step is over sooner, with the lag of a virtual sensor
        max_wait_s = 0.15
        return 0.0 < self.low_for_s <= max_wait_s

    def is_new_zero(self, time_s: float) -> bool:
        """Return whether the force has pulled for so long that the zero has changed."""
        # Longest pull at a steady force, as long as a push on the arm: then the zero
        # has changed
        max_pull_s = 2.5
        return self.is_pulled and time_s - self.low_s > max_pull_s

    def restarted(self) -> "NeedlePull":
        """Return the same without a pull, once the zero has changed."""
        return NeedlePull(highest_N=self.highest_N)

    def with_force(self, force: NetForce) -> "NeedlePull":
        """Return the same after the force of a block."""
        idle_s = 0.0 if force.is_advancing else self.idle_s + force.duration_s
        after = self._replace(idle_s=idle_s)._judged(force)._with_recent(force)
        is_push = force.is_advancing and force.is_met and not after.is_pulled
        if is_push and force.value_N > self.highest_N:
            after = after._replace(highest_N=force.value_N)
        return after._with_fall(force)

    def _least_force_N(self, force: NetForce) -> float:
        """Return the least force of tissue where the needle is; -inf if unknown."""
        # Way back up to which a pull may begin: a tenth of the way over which friction
        # turns, so that a needle that is drawn back, and held by the tissue, is not
        # taken for one that is pulled
        begin_back_mm = 0.03
        # The same once it is pulled
        still_back_mm = 0.1
        back_mm = still_back_mm if self.is_pulled else begin_back_mm
        if force.is_outside or force.behind_mm < back_mm:
            return 0.0
        return -self.highest_N if self.highest_N > 0.0 else -math.inf

    def _judged(self, force: NetForce) -> "NeedlePull":
        """Return the same with a judgement on the force of a block."""
        # A force that may pull soon does so while it is below by more than this
        # fraction
        still_low = 0.25
        # Part of a fall by which the force is then lower, if the fall is quicker than
        # breathing: friction takes at least 0.2 s to turn with it
        quick_fraction = 0.35
        limit_N = force.limit_N
        below_N = self._least_force_N(force) - force.value_N
        low_fraction = still_low if self.low_for_s else STILL_PULLED
        is_low = below_N > low_fraction * limit_N
        low_for_s = self.low_for_s + force.duration_s if is_low else 0.0
        quick_N = max(self.quick_N, self.recent_N - force.value_N)
        is_quick = quick_N > quick_fraction * (self.peak_N - force.value_N)
        friction_N = min(self.friction_N, force.friction_N)
        is_below_friction = force.is_advancing and force.value_N < friction_N - limit_N
        has_fallen = is_quick or self.below_friction_s > 0.0
        below_friction_s = 0.0
        if is_below_friction and has_fallen:
            below_friction_s = self.below_friction_s + force.duration_s
        stays_below_friction = below_friction_s > BELOW_FRICTION_S
        is_beyond = force.value_N < -self.highest_N - limit_N
        is_new_foreign = is_beyond or force.is_outside or stays_below_friction
        is_new_foreign = is_new_foreign or (is_quick and not self.is_pulled)
        pull_fraction = STILL_PULLED if self.is_pulled else 1.0
        is_pulled = below_N > pull_fraction * limit_N or stays_below_friction
        # Whoever lets go lets the force rise, faster than tissue does, to what it was.
        is_rising = self.recent_N + limit_N < force.value_N < self.peak_N
        is_let_go = self.is_pulled and self.is_foreign and is_rising
        is_pulled = is_pulled or is_let_go
        return self._replace(
            is_pulled=is_pulled,
            is_foreign=is_pulled and (self.is_foreign or is_new_foreign),
            low_for_s=low_for_s,
            below_friction_s=below_friction_s,
            quick_N=quick_N,
        )

    def _with_recent(self, force: NetForce) -> "NeedlePull":
        """Return the same with the mean force of late."""
        # Time constant of the force that a quick fall is seen beside
        recent_s = 0.05
        step_N = force.value_N - self.recent_N
        recent_N = self.recent_N - math.expm1(-force.duration_s / recent_s) * step_N
        return self._replace(recent_N=recent_N)

    def _with_fall(self, force: NetForce) -> "NeedlePull":
        """Return the same with the fall of the force followed."""
        # A fall is over if the force has not been lower for so long
        over_s = 0.3
        is_over = force.value_N > self.peak_N or force.time_s - self.low_s > over_s
        if is_over and not self.is_pulled:
            return self._replace(
                friction_N=force.friction_N,
                quick_N=0.0,
                peak_N=force.value_N,
                peak_s=force.time_s,
                low_N=force.value_N,
                low_s=force.time_s,
            )
        # While the force pulls only a clearly lower one counts as a further fall.
        margin_N = STILL_PULLED * force.limit_N if self.is_pulled else 0.0
        if force.value_N < self.low_N - margin_N:
            return self._replace(low_N=force.value_N, low_s=force.time_s)
        return self
