"""A layer as the search for its membrane sees it: some rows, scaled."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.layer_rows import merge_rows
from identification.track import BLOCKS, DEPTH, FORCE, SPEED, TRAVEL

_MOST_ROWS = 64
_LEAST_ROWS = 12
_MARGIN_M = 5e-5
_CURVATURE = 0.2
"""Bend of a layer's force over its slope, one standard deviation (tissue stiffens by 0 to 30 %)."""
_SPEED_SHARE = 0.5
"""Change of force with speed over mean force, one standard deviation: friction, part viscous."""
_FREE = 1e-9

Array = NDArray[np.float64]


class ScaledLayer(NamedTuple):
    """Rows of a layer, scaled: position 0 to 1, speed about its mean, root of weights.

    Attributes:
        rows: The rows, see `layer_rows`, shape (n, 6).
        position: Shape (n,).
        speed: Shape (n,).
        root_weight: Shape (n,).
        target: Weighted force about its mean, shape (n,).
        priors: Weights of the priors on the unknowns of a membrane, see `membrane_fit`; shape (7,).
    """

    rows: Array
    position: Array
    speed: Array
    root_weight: Array
    target: Array
    priors: Array


def scale_layer(rows: Array, start_m: float, rupture_m: float) -> ScaledLayer | None:
    """The rows in which a membrane is looked for, or None where they are too few.

    Args:
        rows: Rows of the layer, see `layer_rows`.
        start_m: Depth from which on the layer was met undisturbed.
        rupture_m: Where the rupture happened.
    """
    end = rows[:, DEPTH] + 0.5 * rows[:, TRAVEL]
    side = rows[(rows[:, DEPTH] > start_m) & (end < rupture_m - _MARGIN_M)]
    side = merge_rows(side, -(-len(side) // _MOST_ROWS)) if len(side) else side
    if len(side) < _LEAST_ROWS:
        return None
    depth, force = side[:, DEPTH], side[:, FORCE]
    position = (depth - depth[0]) / (depth[-1] - depth[0])
    weight = np.sqrt(side[:, BLOCKS] / side[:, BLOCKS].mean())
    mean = float(force.mean())
    target = (force - mean) * weight
    return ScaledLayer(
        rows=side,
        position=position,
        speed=side[:, SPEED] / max(float(side[:, SPEED].mean()), 1e-6) - 1.0,
        root_weight=weight,
        target=target,
        priors=_priors(position, force, mean, target),
    )


def _priors(position: Array, force: Array, mean: float, target: Array) -> Array:
    variance = max(0.5 * float(np.var(np.diff(target))), 1e-12)
    half = len(force) // 2
    begin = position[:half] - position[:half].mean()
    rise = float(begin @ force[:half]) / float(begin @ begin)
    slope = max(rise, 0.1 * float(np.ptp(force)), 1e-3)
    weights = np.full(7, _FREE)
    weights[2] += variance / (_CURVATURE * slope) ** 2
    weights[3:5] += variance / (_SPEED_SHARE * max(abs(mean), 0.02)) ** 2
    return weights


def smooth_squares(layer: ScaledLayer) -> float:
    """Sum of squares that a smooth cubic leaves, with the same priors on the speed's share."""
    u, v = layer.position, layer.speed
    columns = np.stack([np.ones_like(u), u, u**2, v, v * u, u**3], axis=1)
    columns = columns * layer.root_weight[:, None]
    weights = np.array([_FREE, _FREE, _FREE, layer.priors[3], layer.priors[4], _FREE])
    vector = columns.T @ layer.target
    solution = np.linalg.solve(columns.T @ columns + np.diag(weights), vector)
    return float(layer.target @ layer.target - vector @ solution)
