"""How a layer ended, measured on the track around its rupture."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from identification.default_config import DefaultConfig
from identification.estimate import Rupture
from identification.layer_model import MM
from identification.membrane import Boundary
from identification.membrane_search import MembraneSearch
from identification.rupture_fit import ForceAfter
from identification.tear import (
    NOTHING_HELD,
    Held,
    end_probability,
    held_force,
    release_travel_m,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerEnding:
    """Forces at the end of a layer and what they say about the next.

    Attributes:
        boundary: Where the layer ends, and the force there, tip force included.
        has_membrane: Whether that is before the rupture.
        is_one_law: Whether the layer's force obeyed one law up to the rupture.
        after_N: Force after the rupture less all tip force: friction up to this layer, and of the
            next one on the length that was pushed in.
        after_var: Its variance [N^2].
        drop_N: Force released by the rupture, equation (10).
        drop_std_N: Its standard deviation.
        next_slope_N_per_mm: Growth of the force in the next layer.
        pushed_in_mm: Length of the next layer on the shaft when its membrane had been punctured.
        release_m: Travel over which the force fell; nan if not known.
        end_probability: How likely the rupture ended a layer, see `tear`.
        held: Tip force that it left if not.
    """

    boundary: Boundary
    has_membrane: bool
    is_one_law: bool
    after_N: float
    after_var: float
    drop_N: float
    drop_std_N: float
    next_slope_N_per_mm: float
    pushed_in_mm: float
    release_m: float
    end_probability: float = 1.0
    held: Held = NOTHING_HELD

    @property
    def friction_N(self) -> float:
        """Force after the rupture less what is believed to be held at the tip."""
        return self.after_N - self.held.mean_N

    @property
    def friction_var(self) -> float:
        """Variance of that [N^2]."""
        return self.after_var + self.held.variance


def layer_ending(
    points: NDArray[np.float64],
    search: MembraneSearch,
    rupture: Rupture,
    before: tuple[float, float],
    after: ForceAfter,
) -> LayerEnding:
    """Measure the end of a layer.

    Args:
        points: Track points, see `track`.
        search: What was found of a membrane before its rupture.
        rupture: Its rupture.
        before: Force before that, and its variance [N^2].
        after: Force after it.
    """
    before_N, before_var = before
    here = Boundary(rupture.depth_m, 0.0, before_N, before_var, rupture.speed_m_s)
    boundary = here if search.boundary is None else search.boundary
    return LayerEnding(
        boundary=boundary,
        has_membrane=search.boundary is not None,
        is_one_law=search.is_one_law,
        after_N=after.force_N,
        after_var=after.variance,
        drop_N=before_N - after.force_N,
        drop_std_N=math.sqrt(before_var + after.variance),
        next_slope_N_per_mm=after.slope_N_per_mm,
        pushed_in_mm=MM * (rupture.depth_m - boundary.depth_m),
        release_m=release_travel_m(points, rupture.depth_m, after.force_N),
    )


def weigh_tear(ending: LayerEnding, earlier: Sequence[float], config: DefaultConfig) -> LayerEnding:
    """The same ending with what the rupture may have left at the tip.

    Args:
        ending: As measured.
        earlier: How likely each rupture before ended a layer.
        config: Settings.
    """
    share = ending.drop_N / max(ending.drop_N + ending.after_N, 1e-6)
    probability = end_probability(ending.release_m, share, earlier, config)
    held = held_force(ending.after_N, probability, config)
    return replace(ending, end_probability=probability, held=held)
