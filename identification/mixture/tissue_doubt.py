"""What keeps an estimate from being what it is elsewhere: see `TissueWarning`.

**Hard contact: a force that grows faster per travel than soft tissue makes it.**
A blunt tip of radius a on an elastic half space of modulus E and Poisson's ratio nu
meets the stiffness (Sneddon 1965)

    k = 2 a E / (1 - nu²)

With a = 0.65 mm (18 G) the stiffest human cartilage (aggregate modulus 0.48 to 1.58
MPa, Keenan et al. 2009) gives 2 N/mm, other soft tissue less. The softest lamellae of
bone (6.9 GPa, Zysset et al. 1999) give 10 kN/mm, so there arm and needle yield instead.
`MixtureConfig.hard_contact_N_per_m` is twice the stiffness of cartilage.

Friction grows as quickly after a rest, a reversal, and where the needle becomes faster;
so the growth counts only where the needle has advanced evenly.

**A needle that advances and is pulled: tissue that moves overtakes it.**
Tissue at rest resists a needle that advances, at its tip and along its shaft. Where
tissue moves with the breath, by 5 to 20 mm and faster than the needle, its friction
turns and pulls the needle inwards once a breath. Neither friction nor stiffness is then
known any better than by half of the swing of the force: over a breath friction acts
both ways. A pull shows that, and so does breathing that was learnt as noise of the
force and is too large a part of it.

**The filter watches its own innovations.**
An innovation is what a block's force differs by from what the mixture predicted. Where
the model holds, its mean square is what was predicted. Newtons beyond that, for long
and beyond the deviation that is stated for the tip's force, no hypothesis explains:
whoever reads that deviation must be told before anyone knows the cause.
"""

import math
from typing import NamedTuple

from identification.mixture.block import Block

STEP_MM = 0.1
"""Travel between two points that the growth is taken from: it is that over one to two
steps."""


class ContactPoint(NamedTuple):
    """A point that the growth of the force is taken from.

    Attributes:
        depth_mm: Depth of the tip.
        force_N: Axial force without its zero.
        speed_mm_s: Speed of the needle.
    """

    depth_mm: float
    force_N: float
    speed_mm_s: float


class HardContactState(NamedTuple):
    """What is remembered to find a hard contact; immutable.

    Attributes:
        first: Point from which the growth is taken; None before the needle has advanced
            evenly.
        second: A step further.
        growth_N_per_mm: Growth of the force between the first point and the last block;
            0 if it is unclear.
        is_new: Whether a hard contact was found with the last block.
        force_N: Highest force of the present hard contact; 0 without one.
    """

    first: ContactPoint | None = None
    second: ContactPoint | None = None
    growth_N_per_mm: float = 0.0
    is_new: bool = False
    force_N: float = 0.0

    @property
    def is_hard(self) -> bool:
        """Whether the tip is at something hard."""
        return self.force_N > 0.0

    def with_force(
        self, block: Block, net_N: float, bound_N_per_mm: float, *, is_even: bool
    ) -> "HardContactState":
        """Return the same after the force of a block.

        Args:
            block: The block.
            net_N: Its force without the zero.
            bound_N_per_mm: Growth beyond which a contact is hard.
            is_even: Whether the needle has advanced evenly.
        """
        highest_N = max(self.force_N, net_N)
        if self.is_hard and net_N < 0.5 * self.force_N:
            return HardContactState()
        if not is_even:
            return HardContactState(force_N=highest_N if self.is_hard else 0.0)
        here = ContactPoint(block.depth_mm, net_N, block.speed_mm_s)
        first = self.first or here
        second = self.second or here
        # What counts is more than an eighth of a millimetre at the bound shows, and no
        # noise, of a needle that has become hardly faster.
        growth_N = net_N - first.force_N
        min_growth_N = max(0.125 * bound_N_per_mm, 5.0 * block.noise_std_N)
        growth_N_per_mm = 0.0
        if here.speed_mm_s <= 1.3 * first.speed_mm_s and growth_N >= min_growth_N:
            growth_N_per_mm = growth_N / max(here.depth_mm - first.depth_mm, STEP_MM)
        if here.depth_mm - second.depth_mm >= STEP_MM:
            first = second
            second = here
        is_hard = growth_N_per_mm > bound_N_per_mm
        is_new = is_hard and not self.is_hard
        force_N = highest_N if self.is_hard or is_hard else 0.0
        return HardContactState(first, second, growth_N_per_mm, is_new, force_N)


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
        min_pull_N = 0.1  # less is the inertia or the weight of a needle
        net_N = block.force_N - self.zero_N
        std_N = math.sqrt(variance_N2 + self.zero_variance_N2)
        remaining = math.exp(-block.duration_s / REMEMBERED_S)
        highest_N = max(self.highest_N * remaining, net_N)
        lowest_N = min(self.lowest_N * remaining, net_N)
        is_low = net_N < -max(3.0 * std_N, min_pull_N)
        is_pulled = is_sliding and self.is_met and is_low
        pulled_s = self.pulled_s + block.duration_s if is_pulled else 0.0
        # Where friction turns with the breath the deviation of what breathing adds is
        # more than a fifth of the highest force of late: breaths of 5 and 10 mm from
        # end to end showed 0.35 to 0.6, layers at rest less, but for noise and where
        # they begin. Noise of an arm passes for breathing in part.
        swing_N = max(0.2 * highest_N, 2.0 * std_N, min_pull_N)
        is_swinging = self.is_met and math.sqrt(breathing_N2) > swing_N
        swinging_s = self.swinging_s + block.duration_s if is_swinging else 0.0
        moves_until_s = self.moves_until_s
        # Friction that turns pulls for less than half a breath, and where a layer
        # begins the force bends for less than a breath. A known motion of up to 2 mm is
        # followed: ruptures are found beside it.
        if pulled_s >= 0.2 or swinging_s >= 4.0 or amplitude_mm > 2.0:
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


class InnovationWatch(NamedTuple):
    """What the innovations have shown; immutable.

    Attributes:
        fast_N2: Fast mean of the innovations' squares, less their predicted variances.
        slow_N2: Slow mean of the same.
        doubt_N: Unexplained force that was seen, as a deviation.
        doubted_until_s: It is to be reported until then, since the reset.
    """

    fast_N2: float = 0.0
    slow_N2: float = 0.0
    doubt_N: float = 0.0
    doubted_until_s: float = 0.0

    def doubt_at(self, time_s: float) -> float:
        """Return the unexplained force at a time since the reset, 0 for none."""
        return self.doubt_N if time_s < self.doubted_until_s else 0.0

    def restarted(self) -> "InnovationWatch":
        """Return the same where a rupture has explained the innovations of late."""
        return self._replace(fast_N2=0.0, slow_N2=0.0)

    def with_innovation(
        self, innovation_N: float, variance_N2: float, block: Block, tip_std_N: float
    ) -> "InnovationWatch":
        """Return the same after an innovation in tissue.

        Args:
            innovation_N: Of a block's force.
            variance_N2: Its predicted variance.
            block: The block.
            tip_std_N: That is stated for the force at the tip without this doubt, or
                for the force itself if that is more.
        """
        # Their memories are as long as those of means over 0.3 s and over 3 s.
        excess_N2 = innovation_N * innovation_N - variance_N2
        fast = -math.expm1(-block.duration_s / 0.15)
        slow = -math.expm1(-block.duration_s / 1.5)
        fast_N2 = self.fast_N2 + fast * (excess_N2 - self.fast_N2)
        slow_N2 = self.slow_N2 + slow * (excess_N2 - self.slow_N2)
        after = self._replace(fast_N2=fast_N2, slow_N2=slow_N2)
        # In deviations of the tip's force, ordinary insertions show 0.8 in the fast
        # mean in one of a hundred blocks, ruptures left out, and 0.16 in the slow one.
        tip_N2 = max(tip_std_N, 0.01) ** 2
        if fast_N2 <= 3.0**2 * tip_N2 and slow_N2 <= tip_N2:
            return after
        # It counts as unexplained for as long as the slow mean remembers.
        doubt_N = max(self.doubt_at(block.time_s), math.sqrt(max(fast_N2, slow_N2)))
        return after._replace(doubt_N=doubt_N, doubted_until_s=block.time_s + 3.0)
