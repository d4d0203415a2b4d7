"""One zero for the depths that are shown: the planned entry, or the first contact.

A session counts depth from where it was tared, which says nothing to a reader. What is
shown counts from the planned entry where a plan has one, else from the first contact
with tissue, and says which.
"""

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from identification import LayerEstimate
    from needleforce.session import SessionEstimate

PLANNED_ENTRY = "below the planned entry"
FIRST_CONTACT = "below first contact"
LOG_ZERO = "as in the log, without contact"


class DepthZero(NamedTuple):
    """Where shown depths count from.

    Attributes:
        depth_m: Depth of that place as the session counts.
        name: Behind a depth, such as ``below first contact``.
    """

    depth_m: float
    name: str

    def shown_mm(self, depth_m: float) -> float:
        """Return a depth of the session as it is shown [mm]."""
        return 1e3 * (depth_m - self.depth_m)

    def end_std_mm(self, layer: "LayerEstimate") -> float | None:
        """Return the standard deviation of a layer's end as it is shown [mm].

        Below the first contact the error of that contact is in it; None where the
        method states none.
        """
        end_std_m = layer.end_depth_std_m
        if end_std_m is None:
            return None
        zero_std_m = 0.0
        if self.name == FIRST_CONTACT:
            zero_std_m = layer.rupture.contact_depth_std_m or 0.0
        return 1e3 * math.hypot(end_std_m, zero_std_m)


def find_depth_zero(estimate: "SessionEstimate") -> DepthZero:
    """Return where the depths of an estimate count from when they are shown."""
    below_m = estimate.depth_in_tissue_m
    if below_m is None:
        return DepthZero(0.0, "from the tare, before contact")
    name = FIRST_CONTACT if estimate.deviation is None else PLANNED_ENTRY
    return DepthZero(estimate.depth_m - below_m, name)
