"""A needle that advances and is pulled: tissue that moves overtakes it.

Tissue at rest resists a needle that advances, at its tip and along its shaft. Where
tissue moves with the breath, by 5 to 20 mm and faster than the needle, its friction
turns and pulls the needle inwards once a breath. Neither friction nor stiffness is then
known any better than by half of the swing of the force: over a breath friction acts
both ways. A pull shows that, and so does breathing that was learnt as noise of the
force and is too large a part of it.
"""

import math
from typing import NamedTuple

from identification.estimate import Outputs, widen_forces
from identification.mixture.block import Block

REMEMBERED_S = 15.0
"""Tissue that has pulled moves for so much longer: two breaths at 8 a minute."""


class TissuePull(NamedTuple):
    """Whether tissue has pulled at the advancing needle; immutable.

    Attributes:
        zero_N: Force in free air before the first contact.
        zero_variance_N2: Variance of that.
        is_met: Whether tissue has been met.
        pulled_s: Time for which it has pulled in one go.
        swinging_s: Time for which breathing has been a large part of the force.
        moves_until_s: Tissue counts as moving until then, since the reset.
        highest_N: Highest force of late, without its zero.
        lowest_N: Lowest force of late.
        doubt_N: Standard deviation of friction that the swing of the force leaves.
    """

    zero_N: float = 0.0
    zero_variance_N2: float = 0.0
    is_met: bool = False
    pulled_s: float = 0.0
    swinging_s: float = 0.0
    moves_until_s: float = -REMEMBERED_S
    highest_N: float = 0.0
    lowest_N: float = 0.0
    doubt_N: float = 0.0

    def is_moving(self, time_s: float) -> bool:
        """Return whether tissue counts as moving at a time since the reset."""
        return time_s < self.moves_until_s

    def with_zero(
        self, zero_N: float, variance_N2: float, *, is_met: bool
    ) -> "TissuePull":
        """Return the same with the force in free air; from the contact on it is kept.

        Where tissue comes and goes, what is taken for free air later may be none.
        """
        if self.is_met:
            return self
        return self._replace(zero_N=zero_N, zero_variance_N2=variance_N2, is_met=is_met)

    def with_force(
        self,
        block: Block,
        variance_N2: float,
        amplitude_mm: float,
        breathing_N2: float,
        *,
        is_sliding: bool,
    ) -> "TissuePull":
        """Return the same after the force of a block.

        Args:
            block: The block.
            variance_N2: Variance of its force, without what moving tissue adds.
            amplitude_mm: Of the tissue's motion, if it is known, else 0.
            breathing_N2: Variance of the force that was learnt to be breathing.
            is_sliding: Whether the needle has advanced for long enough that friction
                along all of the shaft opposes it.
        """
        # Standard deviations below zero from which on the force pulls
        pull_sigmas = 3.0
        # And at least so far below: less is the inertia or the weight of a needle
        min_pull_N = 0.1
        # The force pulls for so long at least: friction that turns does for half a
        # breath
        min_pull_s = 0.2
        # Amplitude of a motion found in the force up to which ruptures are found beside
        # it
        max_followed_mm = 2.0
        # Part of the highest force of late that the deviation of what breathing adds
        # exceeds where friction turns with it. Breaths of 5 and 10 mm from end to end
        # showed 0.35 to 0.6, layers at rest less, but for noise and where they begin
        swing_fraction = 0.2
        # And that of the force by so much: noise of an arm passes for breathing in part
        swing_sigmas = 2.0
        # For a breath at 15 a minute: where a layer begins, the force bends for less
        min_swing_s = 4.0
        net_N = block.force_N - self.zero_N
        std_N = math.sqrt(variance_N2 + self.zero_variance_N2)
        remaining = math.exp(-block.duration_s / REMEMBERED_S)
        highest_N = max(self.highest_N * remaining, net_N)
        lowest_N = min(self.lowest_N * remaining, net_N)
        is_sliding = is_sliding and self.is_met
        is_pulled = is_sliding and net_N < -max(pull_sigmas * std_N, min_pull_N)
        pulled_s = self.pulled_s + block.duration_s if is_pulled else 0.0
        moves_until_s = self.moves_until_s
        swing_N = max(swing_fraction * highest_N, swing_sigmas * std_N, min_pull_N)
        is_swinging = self.is_met and math.sqrt(breathing_N2) > swing_N
        swinging_s = self.swinging_s + block.duration_s if is_swinging else 0.0
        is_shown = pulled_s >= min_pull_s or swinging_s >= min_swing_s
        if is_shown or amplitude_mm > max_followed_mm:
            moves_until_s = block.time_s + REMEMBERED_S
        elif amplitude_mm > 0.0:
            moves_until_s = min(moves_until_s, block.time_s)
        doubt_N = self.doubt_N
        if block.time_s < moves_until_s:
            doubt_N = max(doubt_N, 0.5 * (highest_N - lowest_N))
        return self._replace(
            pulled_s=pulled_s,
            swinging_s=swinging_s,
            moves_until_s=moves_until_s,
            highest_N=highest_N,
            lowest_N=lowest_N,
            doubt_N=doubt_N,
        )

    def widen(self, outputs: Outputs) -> Outputs:
        """Return what is reported of a sample with the doubt in its deviations.

        Neither stiffness nor friction then counts as identified.
        """
        return widen_forces(outputs, self.doubt_N, keeps_identified=False)
