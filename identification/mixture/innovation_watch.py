"""The filter watches its own innovations.

An innovation is what a block's force differs by from what the mixture predicted. Where
the model holds, its mean square is what was predicted. Newtons beyond that, for long
and beyond the deviation that is stated for the tip's force, no hypothesis explains:
whoever reads that deviation must be told before anyone knows the cause.
"""

import math
from typing import NamedTuple


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
        self,
        innovation_N: float,
        variance_N2: float,
        time_s: float,
        duration_s: float,
        tip_std_N: float,
    ) -> "InnovationWatch":
        """Return the same after an innovation in tissue.

        Args:
            innovation_N: Of a block's force.
            variance_N2: Its predicted variance.
            time_s: Since the reset.
            duration_s: Of the block.
            tip_std_N: That is stated for the force at the tip without this doubt, or
                for the force itself if that is more.
        """
        # Time constant of the fast mean: as long a memory as a mean over 0.3 s
        fast_s = 0.15
        # Of the slow mean: as long a memory as a mean over 3 s
        slow_s = 1.5
        # Unexplained force in the fast mean that is no chance, in deviations of the
        # tip's force. Ordinary insertions show 0.8 in one of a hundred blocks, ruptures
        # left out.
        fast_sigmas = 3.0
        # The same in the slow mean, where they show 0.16 at most
        slow_sigmas = 1.0
        # Deviation of the tip's force that the unexplained force is compared with, at
        # least
        min_std_N = 0.01
        # The force counts as unexplained for so much longer: as long as the slow mean
        # remembers
        remembered_s = 3.0
        excess_N2 = innovation_N * innovation_N - variance_N2
        fast = -math.expm1(-duration_s / fast_s)
        slow = -math.expm1(-duration_s / slow_s)
        fast_N2 = self.fast_N2 + fast * (excess_N2 - self.fast_N2)
        slow_N2 = self.slow_N2 + slow * (excess_N2 - self.slow_N2)
        tip_N2 = max(tip_std_N, min_std_N) ** 2
        doubt_N = self.doubt_at(time_s)
        until_s = self.doubted_until_s
        if fast_N2 > fast_sigmas**2 * tip_N2 or slow_N2 > slow_sigmas**2 * tip_N2:
            doubt_N = max(doubt_N, math.sqrt(max(fast_N2, slow_N2)))
            until_s = time_s + remembered_s
        return InnovationWatch(fast_N2, slow_N2, doubt_N, until_s)
