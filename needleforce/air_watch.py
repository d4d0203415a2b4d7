"""In free air nothing acts on the needle: a force that shows there is an error.

A payload that was gripped anew after the tare, a cable, a sensor that has moved: free
air shows them before the tissue hides them.
"""

import math
from typing import NamedTuple

MEAN_S = 0.15
"""Time constant of the mean: as long a memory as a mean over 0.3 s."""

ODD_SIGMAS = 4.0
"""Mean force in free air, in its own deviations, that is no chance: once in 16,000
insertions. Its error is slow, one draw in each."""

GONE_SIGMAS = 1.0
"""Mean force below which it counts as gone."""

GONE_S = 1.0
"""Time for which it stays there: a force that turns crosses zero."""

MAX_ONSET_S = 1.0
"""A contact is told from free air within this time: a force that resists and began
later may be the contact's."""


class AirWatch(NamedTuple):
    """What the axial force in free air has shown since the tare; immutable.

    Attributes:
        mean_N: Mean force of late.
        odd_s: Time for which it has been no chance.
        quiet_s: Time for which it has been gone.
        doubt_N: Deviation of the axial force that it has shown; 0 for none.
    """

    mean_N: float = 0.0
    odd_s: float = 0.0
    quiet_s: float = 0.0
    doubt_N: float = 0.0

    def with_force(self, axial_N: float, std_N: float, dt_s: float) -> "AirWatch":
        """Return the same after a sample in free air.

        Args:
            axial_N: Axial force, positive where it resists.
            std_N: Its deviation.
            dt_s: Time since the sample before.
        """
        mean_N = self.mean_N - math.expm1(-dt_s / MEAN_S) * (axial_N - self.mean_N)
        size_N = abs(mean_N)
        is_odd = size_N > ODD_SIGMAS * std_N
        odd_s = self.odd_s + dt_s if is_odd else 0.0
        quiet_s = self.quiet_s + dt_s if size_N < GONE_SIGMAS * std_N else 0.0
        doubt_N = self.doubt_N
        if doubt_N > 0.0:
            doubt_N = 0.0 if quiet_s > GONE_S else max(size_N, std_N)
        elif is_odd and (mean_N < 0.0 or odd_s > MAX_ONSET_S):
            doubt_N = size_N
        return AirWatch(mean_N, odd_s, quiet_s, doubt_N)

    def in_tissue(self) -> "AirWatch":
        """Return the same where the needle has met tissue: the doubt stays."""
        return AirWatch(mean_N=self.mean_N, doubt_N=self.doubt_N)


FIRST_AIR_WATCH = AirWatch()
"""After a tare."""
