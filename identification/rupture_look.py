"""A look at a rupture that has begun and not ended: what it has measured so far."""

from typing import NamedTuple

from identification.layer_ending import LayerEnding
from identification.layer_hindsight import IdentifiedLayer
from identification.rupture_fit import AfterRows, ForceAfter


class RuptureLook(NamedTuple):
    """Measured a stage per tick, see `rupture_stages`; the track stays what it is meanwhile.

    What a stage could not measure, where points are too few, stays None.

    Attributes:
        is_final: Whether the rupture is settled by it.
        stages: Worked off.
        before: Force before the rupture, and its variance [N^2].
        after_rows: What the force after the rupture is measured from.
        after: That force.
        ending: How the layer ended.
        has_come_back: Whether the force is back on its old line.
        identified: The unknowns of the layer left.
    """

    is_final: bool
    stages: int = 0
    before: tuple[float, float] | None = None
    after_rows: AfterRows | None = None
    after: ForceAfter | None = None
    ending: LayerEnding | None = None
    has_come_back: bool = False
    identified: IdentifiedLayer | None = None
