"""A force that no tissue exerts: below what tissue can make it, or changed at rest.

Tissue resists: it holds the needle back at the tip and along the shaft. Where the
needle advances, or rests where it has advanced to, the force is not below zero. Where
it advances on, the friction of the layers traversed remains in it, whatever ruptures.
Where the needle is drawn back, friction pulls by no more than tissue has pushed before.

A force far below that is no rupture, and nothing is learnt from it. Tissue that moves
with the breath overtakes the needle and pulls at it as well, but slowly, and by no more
than its friction: such a pull is not foreign to tissue. A force that stays far below is
taken for the sensor's new zero in the end.

Nothing ruptures at a needle that rests, and nothing new holds it back: the force only
relaxes. One that changes quickly there is a fault of the sensor, or a push at the hub,
or its end. Slowly it may change with tissue that moves. Where the needle has stopped
after a rupture, the force then relaxes with a time constant of seconds: one that falls
on more quickly was no rupture.
"""

import math
from typing import NamedTuple

from identification.mixture.block import Block

STILL_PULLED = 0.5
"""A pull lasts while the force is below the least one of tissue by more than this
fraction of that distance; a force that is as low may pull soon."""

ONSET_S = 0.05
"""Time by which a rupture that the fall looks like may be dated before it."""


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
        # Less than the second value is a needle's inertia, or its weight.
        return max(3.0 * self.std_N, 0.1)


class NeedlePull(NamedTuple):
    """Whether the force pulls at the needle; immutable.

    Attributes:
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
    def may_pull(self) -> bool:
        """Whether the force has just become so low that it may pull soon.

        Alarms wait for that no longer than a step takes, with the lag of a virtual
        sensor.
        """
        return 0.0 < self.low_for_s <= 0.15

    def is_new_zero(self, time_s: float) -> bool:
        """Return whether the force has pulled for so long that the zero has changed.

        That is at a steady force, for as long as a push on the arm may take.
        """
        return self.is_pulled and time_s - self.low_s > 2.5

    def with_force(self, force: NetForce) -> "NeedlePull":
        """Return the same after the force of a block."""
        after = self._judged(force)
        step_N = force.value_N - self.recent_N
        # A quick fall is seen beside a mean of this time constant.
        recent_N = self.recent_N - math.expm1(-force.duration_s / 0.05) * step_N
        highest_N = self.highest_N
        if force.is_advancing and force.is_met and not after.is_pulled:
            highest_N = max(highest_N, force.value_N)
        after = after._replace(recent_N=recent_N, highest_N=highest_N)
        return after._with_fall(force)

    def _least_force_N(self, force: NetForce) -> float:
        """Return the least force of tissue where the needle is; -inf if unknown.

        A needle that is drawn back, and held by the tissue, is not taken for one that
        is pulled: a pull begins within a tenth of the way over which friction turns.
        """
        back_mm = 0.1 if self.is_pulled else 0.03
        if force.is_outside or force.behind_mm < back_mm:
            return 0.0
        return -self.highest_N if self.highest_N > 0.0 else -math.inf

    def _judged(self, force: NetForce) -> "NeedlePull":
        """Return the same with a judgement on the force of a block."""
        limit_N = force.limit_N
        below_N = self._least_force_N(force) - force.value_N
        # A force that may pull soon does so while it is below by a quarter.
        low_fraction = 0.25 if self.low_for_s else STILL_PULLED
        is_low = below_N > low_fraction * limit_N
        low_for_s = self.low_for_s + force.duration_s if is_low else 0.0
        # A fall of which so large a part is this quick is quicker than breathing:
        # friction takes at least 0.2 s to turn with it.
        quick_N = max(self.quick_N, self.recent_N - force.value_N)
        is_quick = quick_N > 0.35 * (self.peak_N - force.value_N)
        friction_N = min(self.friction_N, force.friction_N)
        is_below_friction = force.is_advancing and force.value_N < friction_N - limit_N
        below_friction_s = 0.0
        if is_below_friction and (is_quick or self.below_friction_s > 0.0):
            below_friction_s = self.below_friction_s + force.duration_s
        # A speed that falls, and the friction with it, is known late by so much.
        stays_below_friction = below_friction_s > 0.15
        is_beyond = force.value_N < -self.highest_N - limit_N
        is_begun_quickly = is_quick and not self.is_pulled
        is_new_foreign = (
            is_beyond or force.is_outside or stays_below_friction or is_begun_quickly
        )
        # Whoever lets go lets the force rise, faster than tissue does, to what it was.
        is_rising = self.recent_N + limit_N < force.value_N < self.peak_N
        is_let_go = self.is_pulled and self.is_foreign and is_rising
        pull_fraction = STILL_PULLED if self.is_pulled else 1.0
        is_below = below_N > pull_fraction * limit_N
        is_pulled = is_below or stays_below_friction or is_let_go
        return self._replace(
            is_pulled=is_pulled,
            is_foreign=is_pulled and (self.is_foreign or is_new_foreign),
            low_for_s=low_for_s,
            below_friction_s=below_friction_s,
            quick_N=quick_N,
        )

    def _with_fall(self, force: NetForce) -> "NeedlePull":
        """Return the same with the fall of the force followed."""
        # A fall is over if the force has not been lower for so long.
        is_over = force.value_N > self.peak_N or force.time_s - self.low_s > 0.3
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


SETTLED_S = 0.3
"""Time at rest after which a force has settled: a soft arm swings until then."""

CHANGE_SIGMAS = 6.0
"""Least quick change in standard deviations of the force's noise."""


class RestForce(NamedTuple):
    """Whether the force on a needle at rest changes as no tissue changes it; immutable.

    Attributes:
        depth_mm: Where it rests.
        rest_s: For how long it has rested.
        mean_N: Mean force of late.
        settled_N: Force once it had settled.
        wait_s: Time for which the force has been other than usual.
        change_N: Quick change of the force, while it lasts, else 0.
        changed_s: Time since that change.
        falls_on: Whether the force falls on after a rupture.
    """

    depth_mm: float = 0.0
    rest_s: float = 0.0
    mean_N: float = 0.0
    settled_N: float = 0.0
    wait_s: float = 0.0
    change_N: float = 0.0
    changed_s: float = 0.0
    falls_on: bool = False

    @property
    def is_foreign(self) -> bool:
        """Whether no tissue changes the force so."""
        return self.change_N != 0.0 or self.falls_on

    def with_force(
        self, block: Block, net_N: float, slow_std_N: float, *, has_ruptured: bool
    ) -> "RestForce":
        """Return the same after the force of a block.

        Args:
            block: The block.
            net_N: Its force without the zero.
            slow_std_N: Standard deviation of the force's slow error.
            has_ruptured: Whether an alarm was raised shortly before the needle stopped.
        """
        # It rests within a fourteenth of the travel over which friction turns, beyond
        # the noise of its depth.
        play_mm = 0.02 + 3.0 * block.depth_std_mm
        begun = RestForce(block.depth_mm, mean_N=net_N, settled_N=net_N)
        if abs(block.depth_mm - self.depth_mm) > play_mm:
            return begun
        step_N = net_N - self.mean_N
        after = self._replace(rest_s=self.rest_s + block.duration_s)
        if self.change_N:
            changed_s = self.changed_s + block.duration_s
            # A force that has changed for so long is the usual one.
            if abs(step_N) < 0.5 * abs(self.change_N) or changed_s > 2.5:
                return begun._replace(depth_mm=self.depth_mm)
            return after._replace(changed_s=changed_s)
        if after.rest_s > SETTLED_S:
            after = after._with_fall(block, net_N, has_ruptured=has_ruptured)
            # Twice the least rupture seen in real liver, no noise, and a fraction of
            # the force: when the needle is drawn back, friction turns by less over the
            # travel that is still rest.
            noise_N = CHANGE_SIGMAS * block.noise_std_N
            if abs(step_N) > max(0.3, noise_N, 0.4 * abs(self.mean_N)):
                return after._with_wait(block, net_N, slow_std_N)
        # A beating heart changes the force more slowly than this mean.
        mean_N = self.mean_N - math.expm1(-block.duration_s / 0.1) * step_N
        settled_N = mean_N if after.rest_s <= SETTLED_S else self.settled_N
        return after._replace(mean_N=mean_N, settled_N=settled_N, wait_s=0.0)

    def _with_fall(
        self, block: Block, net_N: float, *, has_ruptured: bool
    ) -> "RestForce":
        """Return the same with a judgement on a force that falls after a rupture."""
        settled_s = self.rest_s - SETTLED_S
        # Tissue relaxes no faster; liver takes 8.5 s.
        relaxed_N = max(self.settled_N, 0.0) * math.exp(-settled_s / 1.5)
        margin_N = max(0.2, CHANGE_SIGMAS * block.noise_std_N)
        is_low = net_N < relaxed_N - margin_N
        falls_on = has_ruptured and settled_s < 2.0 and is_low
        return self._replace(falls_on=self.falls_on or falls_on)

    def _with_wait(self, block: Block, net_N: float, slow_std_N: float) -> "RestForce":
        """Return the same while a force is other than usual: is it the arm's motion?

        The slow error of the force holds what an arm adds that begins to move.
        """
        wait_s = self.wait_s + block.duration_s
        change_N = net_N - self.mean_N
        # An arm that begins to move has the needle out of its rest by then.
        if wait_s > 0.1 and abs(change_N) > 3.0 * slow_std_N:
            return self._replace(change_N=change_N, changed_s=0.0, wait_s=0.0)
        if wait_s > 0.6:  # a change that may be one of the arm's is the usual force
            return self._replace(mean_N=net_N, wait_s=0.0)
        return self._replace(wait_s=wait_s)
