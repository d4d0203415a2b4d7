"""Hard contact: a force that grows faster per travel than soft tissue makes it.

A blunt tip of radius a on an elastic half space of modulus E and Poisson's ratio nu
meets the stiffness (Sneddon 1965)

    k = 2 a E / (1 - nu²)

With a = 0.65 mm (18 G) the stiffest human cartilage (aggregate modulus 0.48 to 1.58
MPa, Keenan et al. 2009) gives 2 N/mm, other soft tissue less. The softest lamellae of
bone (6.9 GPa, Zysset et al. 1999) give 10 kN/mm, so there arm and needle yield instead.
`MixtureConfig.hard_contact_N_per_m` is twice the stiffness of cartilage.

Friction grows as quickly after a rest, a reversal, and where the needle becomes faster;
so the growth counts only where the needle has advanced evenly.
"""

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
        is_known: Whether there is such a point.
    """

    depth_mm: float = 0.0
    force_N: float = 0.0
    speed_mm_s: float = 0.0
    is_known: bool = False


NO_POINT = ContactPoint()
"""Before the needle has advanced evenly."""


class HardContactState(NamedTuple):
    """What is remembered to find a hard contact; immutable.

    Attributes:
        first: Point from which the growth is taken.
        second: A step further.
        growth_N_per_mm: Growth of the force between the first point and the last block.
        is_new: Whether a hard contact was found with the last block.
        force_N: Highest force of the present hard contact; 0 without one.
    """

    first: ContactPoint = NO_POINT
    second: ContactPoint = NO_POINT
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
        # Part of the force at a hard contact below which that is over
        over_fraction = 0.5
        if self.is_hard and net_N < over_fraction * self.force_N:
            return HardContactState()
        growth_N_per_mm = 0.0
        if is_even:
            growth_N_per_mm = self._growth(block, net_N, bound_N_per_mm)
        is_hard = growth_N_per_mm > bound_N_per_mm
        force_N = max(self.force_N, net_N) if self.is_hard or is_hard else 0.0
        here = ContactPoint(block.depth_mm, net_N, block.speed_mm_s, is_known=True)
        first = self.first
        second = self.second
        if not is_even:
            first = NO_POINT
            second = NO_POINT
        elif not first.is_known:
            first = here
            second = here
        elif here.depth_mm - second.depth_mm >= STEP_MM:
            first = second
            second = here
        is_new = is_hard and not self.is_hard
        return HardContactState(first, second, growth_N_per_mm, is_new, force_N)

    def _growth(self, block: Block, net_N: float, bound_N_per_mm: float) -> float:
        """Return the growth of the force since the first point [N/mm]; 0 if unclear."""
        # Growth of a hard contact, at least: the bound times this travel
        min_growth_mm = 0.125
        # The same in standard deviations of a block's force
        growth_sigmas = 5.0
        # The needle may have become faster by this ratio, at most
        max_speed_ratio = 1.3
        if not self.first.is_known:
            return 0.0
        growth_N = net_N - self.first.force_N
        min_growth_N = max(
            min_growth_mm * bound_N_per_mm, growth_sigmas * block.noise_std_N
        )
        is_faster = block.speed_mm_s > max_speed_ratio * self.first.speed_mm_s
        if is_faster or growth_N < min_growth_N:
            return 0.0
        return growth_N / max(block.depth_mm - self.first.depth_mm, STEP_MM)
