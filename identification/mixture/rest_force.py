"""Force on a needle that rests: it only relaxes.

Nothing ruptures at a needle that rests, and nothing new holds it back. A force that
changes quickly there is a fault of the sensor, or a push at the hub, or its end. Slowly
it may change with tissue that moves. Where the needle has stopped after a rupture, the
force then relaxes with a time constant of seconds: one that falls on more quickly was
no rupture.
"""

import math
from typing import NamedTuple

SETTLED_S = 0.3
"""Time at rest after which a force has settled: a soft arm swings until then."""

CHANGE_SIGMAS = 6.0
"""Least quick change in standard deviations of the force's noise."""


class HeldForce(NamedTuple):
    """Force of a block and place of the needle.

    Attributes:
        value_N: Force without its zero.
        noise_std_N: Standard deviation of its noise.
        slow_std_N: Standard deviation of its slow error.
        depth_mm: Of the tip.
        depth_std_mm: Standard deviation of the depth's noise.
        duration_s: Length of the block.
        has_ruptured: Whether an alarm was raised shortly before the needle stopped.
    """

    value_N: float
    noise_std_N: float
    slow_std_N: float
    depth_mm: float
    depth_std_mm: float
    duration_s: float
    has_ruptured: bool = False


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

    def with_force(self, force: HeldForce) -> "RestForce":
        """Return the same after the force of a block."""
        # Travel within which a needle rests, beyond the noise of its depth: a
        # fourteenth of that over which friction turns
        rest_mm = 0.02
        # Standard deviations of the depth's noise by which a needle may seem to move
        depth_sigmas = 3.0
        # Time constant of the mean that a force is compared with: a beating heart
        # changes it more slowly
        mean_s = 0.1
        play_mm = rest_mm + depth_sigmas * force.depth_std_mm
        if abs(force.depth_mm - self.depth_mm) > play_mm:
            return RestForce(
                depth_mm=force.depth_mm, mean_N=force.value_N, settled_N=force.value_N
            )
        after = self._replace(rest_s=self.rest_s + force.duration_s)
        if self.change_N:
            return after._with_change(force)
        if after.rest_s > SETTLED_S:
            after = after._with_fall(force)
            change_N = force.value_N - self.mean_N
            if abs(change_N) > self._limit_N(force):
                return after._with_wait(force)
        step_N = force.value_N - self.mean_N
        mean_N = self.mean_N - math.expm1(-force.duration_s / mean_s) * step_N
        settled_N = mean_N if after.rest_s <= SETTLED_S else self.settled_N
        return after._replace(mean_N=mean_N, settled_N=settled_N, wait_s=0.0)

    def _limit_N(self, force: HeldForce) -> float:
        """Return the change from which on a force is other than usual."""
        # Least quick change, twice the least rupture seen in real liver
        min_change_N = 0.3
        # Least quick change as a fraction of the force: when the needle is drawn back,
        # friction turns by less over the travel that is still rest
        change_fraction = 0.4
        noise_N = CHANGE_SIGMAS * force.noise_std_N
        return max(min_change_N, noise_N, change_fraction * abs(self.mean_N))

    def _with_fall(self, force: HeldForce) -> "RestForce":
        """Return the same with a judgement on a force that falls after a rupture."""
        # Shortest time constant with which tissue relaxes: liver takes 8.5 s
        relaxation_s = 1.5
        # Least fall below what relaxation leaves that is none of tissue
        min_fall_N = 0.2
        # Time after the force has settled in which a fall after a rupture is looked for
        falling_s = 2.0
        settled_s = self.rest_s - SETTLED_S
        relaxed_N = max(self.settled_N, 0.0) * math.exp(-settled_s / relaxation_s)
        margin_N = max(min_fall_N, CHANGE_SIGMAS * force.noise_std_N)
        is_low = force.value_N < relaxed_N - margin_N
        falls_on = force.has_ruptured and settled_s < falling_s and is_low
        return self._replace(falls_on=self.falls_on or falls_on)

    def _with_wait(self, force: HeldForce) -> "RestForce":
        """Return the same while a force is other than usual: is it the arm's motion?"""
        # Least quick change in standard deviations of the force's slow error, which
        # holds what an arm adds that begins to move
        slow_sigmas = 3.0
        # Time for which a change lasts at least: an arm that begins to move has the
        # needle out of its rest by then
        min_wait_s = 0.1
        # Time after which a change that may be one of the arm's is the usual force
        max_wait_s = 0.6
        wait_s = self.wait_s + force.duration_s
        change_N = force.value_N - self.mean_N
        is_clear = abs(change_N) > slow_sigmas * force.slow_std_N
        if wait_s > min_wait_s and is_clear:
            return self._replace(change_N=change_N, changed_s=0.0, wait_s=0.0)
        if wait_s > max_wait_s:
            return self._replace(mean_N=force.value_N, wait_s=0.0)
        return self._replace(wait_s=wait_s)

    def _with_change(self, force: HeldForce) -> "RestForce":
        """Return the same while a quick change lasts; a needle then rests anew."""
        # Time after which a force that has changed is the usual one
        max_changed_s = 2.5
        changed_s = self.changed_s + force.duration_s
        is_back = abs(force.value_N - self.mean_N) < 0.5 * abs(self.change_N)
        if is_back or changed_s > max_changed_s:
            return RestForce(
                depth_mm=self.depth_mm, mean_N=force.value_N, settled_N=force.value_N
            )
        return self._replace(changed_s=changed_s)


NEVER_AT_REST = RestForce()
"""Of a needle that advances."""
