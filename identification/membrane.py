"""Finds the membrane that was pushed in before a rupture (rupture time differs from exit time).

With a glove or a capsule between two layers the tip reaches the boundary, pushes the membrane in
and punctures it later: t_r is not t_{i+1} (Section II). Up to the boundary the force of the layer
grows; from there on the layer's own part stays and the membrane is a spring, in general a
non-linear one (a parabola: Okamura, Simone, O'Leary 2004).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.membrane_fit import STARTS, MembraneFits, fit_membranes, unit_covariance
from identification.membrane_layer import ScaledLayer, scale_layer, smooth_squares
from identification.track import DEPTH, FORCE, SPEED

_UNKNOWNS = 7
_EVIDENCE = 30.0
"""Gain of log-likelihood, twice, over a smooth cubic: five to six standard deviations."""
_BETTER = 0.75
"""Share of the cubic's sum of squares that must not be exceeded: with little noise any tissue is
significantly no cubic."""

Array = NDArray[np.float64]


class Boundary(NamedTuple):
    """Where a layer ended.

    Attributes:
        depth_m: Depth: that of its rupture, or where its membrane began to be pushed in.
        std_m: Its standard deviation.
        force_N: Force there.
        force_var: Its variance [N^2].
        speed_m_s: Speed there.
    """

    depth_m: float
    std_m: float
    force_N: float
    force_var: float
    speed_m_s: float


def find_membrane(rows: Array, start_m: float, rupture_m: float) -> Boundary | None:
    """Where the membrane that a layer ended with began, or None if there was none.

    Args:
        rows: Rows of the layer, see `layer_rows`.
        start_m: Depth from which on the layer was met undisturbed.
        rupture_m: Where the rupture happened.
    """
    layer = scale_layer(rows, start_m, rupture_m)
    return None if layer is None else judge_membranes(layer, fit_membranes(layer, STARTS))


def judge_membranes(layer: ScaledLayer, fits: MembraneFits) -> Boundary | None:
    """The boundary, if a membrane explains the layer much better than a smooth cubic does.

    A single non-linear spring, as a capsule at the very surface is, has no boundary in it and
    stays one (fictitious) layer, as in Section III-B.

    Args:
        layer: The layer.
        fits: Of all `STARTS`.
    """
    best = int(np.argmin(fits.squares))
    if not np.isfinite(fits.squares[best]):
        return None
    variance = max(float(fits.squares[best]), 1e-12) / (len(layer.rows) - _UNKNOWNS)
    smooth = smooth_squares(layer)
    evidence = (smooth - fits.squares[best]) / variance
    if evidence < _EVIDENCE or fits.squares[best] > _BETTER * smooth:
        return None
    if not _is_steeper(fits.solutions[best], 1.0 - STARTS[best]):
        return None
    covariance = variance * unit_covariance(layer, float(STARTS[best]))
    return _membrane(layer.rows, fits, variance, covariance)


def _is_steeper(solution: Array, reach: float) -> bool:
    """Whether the membrane at its puncture pushes back more steeply than the layer did."""
    return float(solution[5] + 2.0 * solution[6] * reach) > max(float(solution[1]), 0.0)


def _membrane(side: Array, fits: MembraneFits, variance: float, covariance: Array) -> Boundary:
    """Mean of the candidates by their likelihood, and the spread of it."""
    best = int(np.argmin(fits.squares))
    likelihood = np.exp(-0.5 * (fits.squares - fits.squares[best]) / variance)
    likelihood /= likelihood.sum()
    length = float(side[-1, DEPTH] - side[0, DEPTH])
    start = float(likelihood @ STARTS)
    step = float(STARTS[1] - STARTS[0])
    spread = float(likelihood @ (STARTS - start) ** 2) + step * step / 12.0
    depth = float(side[0, DEPTH]) + start * length
    speed = float(np.interp(depth, side[:, DEPTH], side[:, SPEED]))
    relative = speed / max(float(side[:, SPEED].mean()), 1e-6) - 1.0
    row = np.array([1.0, start, start**2, relative, relative * start, 0.0, 0.0])
    return Boundary(
        depth_m=depth,
        std_m=float(np.sqrt(spread)) * length,
        force_N=float(side[:, FORCE].mean() + row @ fits.solutions[best]),
        force_var=float(row @ covariance @ row),
        speed_m_s=speed,
    )
