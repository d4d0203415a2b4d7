"""Looks for the membrane a layer ended with as soon as its rupture has alarmed.

All that this needs is known then; the tick that measures the force drop, millimetres later, is
spared half of its work.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.default_config import DefaultConfig
from identification.membrane import Boundary, find_membrane

_MOST_PUSHED_M = 13e-3
"""No membrane gives more: the capsule of bovine liver 11 mm."""


class MembraneSearch(NamedTuple):
    """What was found.

    Attributes:
        boundary: Where the membrane before the rupture began, None if there was none.
        is_one_law: Whether the layer's force obeyed one law up to the rupture.
    """

    boundary: Boundary | None
    is_one_law: bool


def search_membrane(
    rows: NDArray[np.float64], start_m: float, rupture_m: float, config: DefaultConfig
) -> MembraneSearch:
    """The membrane before a rupture, and whether the layer obeyed one law.

    A boundary further back than any membrane gives is a soft transition that was missed. What
    follows it is searched again; the friction of both parts is measured together.

    Args:
        rows: Rows of the layer, see `layer_rows`.
        start_m: Depth from which on the layer was met undisturbed, its own puncture over.
        rupture_m: Depth of its rupture.
        config: Settings.
    """
    found = find_membrane(rows, start_m, rupture_m)
    if found is None:
        return MembraneSearch(None, True)
    if rupture_m - found.depth_m <= _MOST_PUSHED_M:
        return MembraneSearch(found, False)
    again = find_membrane(rows, found.depth_m + config.first_look_m, rupture_m)
    if again is not None and rupture_m - again.depth_m > _MOST_PUSHED_M:
        again = None
    return MembraneSearch(again, False)
