"""One track point into the current layer's normal equations."""

import math

import numpy as np
from numpy.typing import NDArray

from identification.default_config import DefaultConfig
from identification.default_state import DefaultState, LayerData
from identification.kink_detector import block_noise_N2
from identification.layer_model import (
    Information,
    LayerFit,
    add_row,
    model_row,
    solve_layer,
)
from identification.layer_prior import add_layer_prior
from identification.track import BLOCKS, BRISTLE, DEPTH, FORCE, SPEED, TRAVEL

_SOLVE_EVERY = 10
_OTHER_SHARE = 0.2


def layer_step(
    state: DefaultState,
    point: NDArray[np.float64],
    config: DefaultConfig,
    *,
    is_solved: bool = True,
) -> DefaultState:
    """Absorb one point; refit every few points.

    A point weighs by its noise and by the error of the linear law, which points within a few
    millimetres share: many points do not make a wrong law right.
    """
    layer = state.layer
    depth = float(point[DEPTH]) - layer.start_m
    speed, force = float(point[SPEED]), float(point[FORCE])
    row = model_row(depth, speed, float(point[BRISTLE]), config.cutting_onset_m)
    earlier = float(row[0]) * state.fit.values[0] + float(row[1]) * state.fit.values[1]
    own = force - earlier
    error = config.model_error_share * max(abs(own), _OTHER_SHARE * abs(force))
    shared = max(config.model_error_m / max(float(point[TRAVEL]), 1e-6), 1.0)
    variance = block_noise_N2(state.detector) / float(point[BLOCKS]) + error * error * shared
    layer = layer._replace(data=add_row(layer.data, row, force, variance), points=layer.points + 1)
    state = state._replace(layer=layer)
    if not is_solved or layer.points % _SOLVE_EVERY:
        return state
    fit = fit_layer(layer, own, depth, speed, config)
    row[2] = row[3] = 0.0
    spread = float(row @ fit.covariance @ row)
    return state._replace(fit=fit, shaft_std_N=math.sqrt(max(spread, 0.0)))


def fit_layer(
    layer: LayerData, own_N: float, layer_depth_m: float, speed_m_s: float, config: DefaultConfig
) -> LayerFit:
    """Fit of the layer with everything known so far."""
    known = Information(
        layer.prior.matrix + layer.data.matrix, layer.prior.vector + layer.data.vector
    )
    return solve_layer(add_layer_prior(known, own_N, layer_depth_m, speed_m_s, config))
