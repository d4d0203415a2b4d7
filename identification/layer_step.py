"""One track point into the current layer's normal equations."""

import math

import numpy as np
from numpy.typing import NDArray

from identification.default_config import DefaultConfig
from identification.default_state import DefaultState, LayerData
from identification.kink_detector import block_noise_N2
from identification.layer_model import (
    CUTTING,
    STIFFNESS,
    Information,
    add_row,
    model_row,
    solve_layer,
)
from identification.layer_prior import add_layer_prior
from identification.layer_rows import add_layer_row
from identification.track import BLOCKS, BRISTLE, DEPTH, FORCE, SPEED, TRAVEL

_POOLED_BLOCKS = 20.0
"""A row spans 0.1 s or `row_m` of travel, whichever is sooner."""
_OTHER_SHARE = 0.2


def layer_step(
    state: DefaultState,
    point: NDArray[np.float64],
    config: DefaultConfig,
    *,
    is_solved: bool = True,
) -> DefaultState:
    """Absorb one point; every few of them make one row, and a new fit.

    Rows of many points average the noise of the speed: in a regressor it would look like a change
    of speed without a change of force, that is, like Coulomb friction.
    """
    layer = state.layer
    pool = point.copy()
    pool[:BLOCKS] *= point[BLOCKS]
    if layer.pool is not None:
        pool += layer.pool
    state = state._replace(layer=layer._replace(pool=pool, points=layer.points + 1))
    if pool[BLOCKS] < _POOLED_BLOCKS and pool[TRAVEL] < config.row_m:
        return state
    return settle_pool(state, config, is_solved=is_solved)


def settle_pool(
    state: DefaultState, config: DefaultConfig, *, is_solved: bool = True
) -> DefaultState:
    """Turn the pooled points into one row and fit anew.

    A row weighs by its noise and by the error of the linear law, which rows within a few
    millimetres share: many rows do not make a wrong law right.
    """
    layer, pool = state.layer, state.layer.pool
    if pool is None:
        return state
    point = np.append(pool[:BLOCKS] / pool[BLOCKS], pool[BLOCKS:])
    row, force = _row(layer, point, config), float(point[FORCE])
    own = force - _earlier_N(state, row)
    error = config.model_error_share * max(abs(own), _OTHER_SHARE * abs(force))
    shared = max(config.model_error_m / max(float(point[TRAVEL]), 1e-6), 1.0)
    variance = block_noise_N2(state.detector) / float(point[BLOCKS]) + error * error * shared
    layer = layer._replace(
        data=add_row(layer.data, row, force, variance),
        rows=add_layer_row(layer.rows, point),
        pool=None,
    )
    state = state._replace(layer=layer)
    return _refit(state, point, config) if is_solved else state


def _refit(state: DefaultState, point: NDArray[np.float64], config: DefaultConfig) -> DefaultState:
    """Fit the layer with everything known so far, `point` being the newest."""
    layer = state.layer
    row = _row(layer, point, config)
    own = float(point[FORCE]) - _earlier_N(state, row)
    known = Information(
        layer.prior.matrix + layer.data.matrix, layer.prior.vector + layer.data.vector
    )
    depth = float(point[DEPTH]) - layer.start_m
    known = add_layer_prior(known, own, depth, float(point[SPEED]), config, layer.held)
    fit = solve_layer(known)
    row[[CUTTING, STIFFNESS]] = 0.0
    spread = float(row @ fit.covariance @ row)
    return state._replace(fit=fit, shaft_std_N=math.sqrt(max(spread, 0.0)))


def _row(
    layer: LayerData, point: NDArray[np.float64], config: DefaultConfig
) -> NDArray[np.float64]:
    depth = float(point[DEPTH])
    return model_row(
        depth - layer.start_m,
        depth - layer.tip_m,
        float(point[SPEED]),
        float(point[BRISTLE]),
        config.cutting_onset_m,
    )


def _earlier_N(state: DefaultState, row: NDArray[np.float64]) -> float:
    return float(row[0]) * state.fit.values[0] + float(row[1]) * state.fit.values[1]
