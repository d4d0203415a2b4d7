"""Looks for the membrane a layer ended with, a stage per tick, once its rupture has alarmed.

All that this needs is known then; the ticks that measure the force drop, millimetres later, are
spared it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.default_config import DefaultConfig
from identification.membrane import Boundary, judge_membranes
from identification.membrane_fit import STARTS, MembraneFits, fit_membranes
from identification.membrane_layer import ScaledLayer, scale_layer

_MOST_PUSHED_M = 13e-3
"""No membrane gives more: the capsule of bovine liver 11 mm."""
_AT_ONCE = 8
"""Candidates of one stage."""


class MembraneSearch(NamedTuple):
    """What was found.

    Attributes:
        boundary: Where the membrane before the rupture began, None if there was none.
        is_one_law: Whether the layer's force obeyed one law up to the rupture.
    """

    boundary: Boundary | None
    is_one_law: bool


class SearchWork(NamedTuple):
    """What has been done of a search.

    Attributes:
        from_m: Depth from which on the layer is searched.
        is_second: Whether only what follows a missed transition is.
        layer: What is searched, None before the first stage.
        fits: Of the candidates tried so far.
    """

    from_m: float
    is_second: bool = False
    layer: ScaledLayer | None = None
    fits: tuple[MembraneFits, ...] = ()


def search_step(
    work: SearchWork, rows: NDArray[np.float64], rupture_m: float, config: DefaultConfig
) -> SearchWork | MembraneSearch:
    """Work off the next stage of a search.

    Args:
        work: What has been done; at first the depth from which on the layer was met undisturbed,
            its own puncture over.
        rows: Rows of the layer, see `layer_rows`.
        rupture_m: Depth of its rupture.
        config: Settings.

    Returns:
        What has been done now, or what was found.
    """
    if work.layer is None:
        layer = scale_layer(rows, work.from_m, rupture_m)
        if layer is None:
            return _conclude(work, None, rupture_m, config)
        return work._replace(layer=layer)
    tried = _AT_ONCE * len(work.fits)
    if tried < len(STARTS):
        fits = fit_membranes(work.layer, STARTS[tried : tried + _AT_ONCE])
        return work._replace(fits=(*work.fits, fits))
    every = MembraneFits(*(np.concatenate(parts) for parts in zip(*work.fits, strict=True)))
    return _conclude(work, judge_membranes(work.layer, every), rupture_m, config)


def _conclude(
    work: SearchWork, found: Boundary | None, rupture_m: float, config: DefaultConfig
) -> SearchWork | MembraneSearch:
    """What a layer searched through tells.

    A boundary further back than any membrane gives is a soft transition that was missed. What
    follows it is searched again; the friction of both parts is measured together.
    """
    is_near = found is not None and rupture_m - found.depth_m <= _MOST_PUSHED_M
    if work.is_second:
        return MembraneSearch(found if is_near else None, False)
    if found is None or is_near:
        return MembraneSearch(found, found is None)
    return SearchWork(found.depth_m + config.first_look_m, is_second=True)
