"""A look at a rupture that has begun and not ended: what it has measured so far."""

from typing import NamedTuple

from identification.layer_ending import LayerEnding
from identification.rupture_fit import ForceAfter


class RuptureLook(NamedTuple):
    """Measured a stage per tick, see `rupture_stages`; the track stays what it is meanwhile.

    Attributes:
        is_final: Whether the rupture is settled by it.
        stages: Worked off.
        after: Force after the rupture, None before that stage or where points are too few.
        ending: How the layer ended, None alike.
        has_come_back: Whether the force is back on its old line.
    """

    is_final: bool
    stages: int = 0
    after: ForceAfter | None = None
    ending: LayerEnding | None = None
    has_come_back: bool = False
