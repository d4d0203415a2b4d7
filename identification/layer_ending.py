"""How a layer ended, measured on the track around its rupture."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from identification.default_config import DefaultConfig
from identification.estimate import Rupture
from identification.layer_model import MM
from identification.membrane import membrane_depth
from identification.rupture_fit import fit_rupture, force_before


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerEnding:
    """Forces at the end of a layer and what they say about the next.

    Attributes:
        boundary_m: Where the layer ends; the rupture, or where its membrane began to be pushed in.
        has_membrane: Whether the two differ.
        before_N: Force at the boundary, tip force included.
        before_var: Its variance [N^2].
        after_N: Force after the rupture less all tip force and less what the next layer already
            rubs: friction up to this layer.
        after_var: Its variance [N^2].
        drop_N: Force released by the rupture, equation (10).
        drop_std_N: Its standard deviation.
        next_slope_N_per_mm: Growth of the force in the next layer.
    """

    boundary_m: float
    has_membrane: bool
    before_N: float
    before_var: float
    after_N: float
    after_var: float
    drop_N: float
    drop_std_N: float
    next_slope_N_per_mm: float


def layer_ending(
    points: NDArray[np.float64],
    start_m: float,
    rupture: Rupture,
    noise_N2: float,
    config: DefaultConfig,
    first: LayerEnding | None = None,
) -> LayerEnding | None:
    """Measure the end of a layer that had begun, its own puncture over, by `start_m`.

    After the puncture of a membrane the next layer springs back along the shaft: it rubs on the
    length the membrane had been pushed in, a share of its slope that the prior guesses.

    Args:
        points: Track points, see `track`.
        start_m: Depth from which on the layer was met undisturbed.
        rupture: Its rupture.
        noise_N2: Long-run variance of one block.
        config: Settings.
        first: What an earlier look found: its boundary stands, as the track forgets.

    Returns:
        The ending, or None while too few points are at hand.
    """
    fit = fit_rupture(points, rupture.depth_m, rupture.speed_m_s, noise_N2, config)
    if fit is None:
        return None
    boundary, before = rupture.depth_m, (fit.before_N, fit.before_var)
    if first is not None and first.has_membrane:
        boundary, before = first.boundary_m, (first.before_N, first.before_var)
    elif first is None:
        membrane = membrane_depth(points, start_m, rupture.depth_m)
        at_boundary = None if membrane is None else force_before(points, membrane, noise_N2)
        if membrane is not None and at_boundary is not None:
            boundary, before = membrane, at_boundary
    pushed_in = MM * (rupture.depth_m - boundary)
    rubbing = pushed_in * fit.slope_N_per_mm
    return LayerEnding(
        boundary_m=boundary,
        has_membrane=pushed_in > 0.0,
        before_N=before[0],
        before_var=before[1],
        after_N=fit.after_N - config.friction_share * rubbing,
        after_var=fit.after_var + (config.friction_share_std * rubbing) ** 2,
        drop_N=fit.drop_N,
        drop_std_N=math.sqrt(fit.before_var + fit.after_var),
        next_slope_N_per_mm=fit.slope_N_per_mm,
    )
