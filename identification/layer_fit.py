"""Identification of a layer from its data and the rupture that ended it."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.estimate import LayerEstimate, Rupture
from identification.layer_belief import (
    Gaussian,
    IdentifiedLayer,
    believe,
    carried_friction,
    layer_estimate,
)
from identification.layer_model import (
    CUTTING,
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    STIFFNESS,
    LayerFit,
    NormalEquations,
    add_row,
    layer_fit,
    model_row,
    no_information,
    solve_layer,
)
from identification.multilayer_config import MultilayerConfig
from identification.multilayer_state import LayerData, MultilayerState, Traversed
from identification.resampling import BLOCKS, BRISTLE, DEPTH, FORCE, SPEED, TRAVEL, add_layer_row
from identification.rupture_classifier import (
    NO_RESIDUAL_FORCE,
    ResidualTipForce,
    RuptureMeasurement,
)
from identification.slope_change_detector import block_noise_N2

# What is believed about a layer before its rupture: rows added to the normal equations.


_LEAST_SLOPE = 1e-4


def add_layer_prior(
    information: NormalEquations,
    own_N: float,
    layer_depth_m: float,
    speed_m_s: float,
    config: MultilayerConfig,
    held: ResidualTipForce = NO_RESIDUAL_FORCE,
) -> NormalEquations:
    """Add the priors on shares, scaled by the force the layer has built up so far.

    At constant speed nothing in a layer tells its stiffness from its friction, nor Coulomb from
    viscous: without these rows the answer would be arbitrary, with them it is a stated guess with
    a stated standard deviation that any rupture or change of speed overrides. Cutting counts with
    the elastic force: friction has its share of both.

    Args:
        information: Data and earlier friction.
        own_N: Axial force less the friction of earlier layers, now.
        layer_depth_m: Travel in the layer.
        speed_m_s: Usual speed.
        config: Settings.
        held: Tip force that the layer began with, see `tear`.
    """
    depth, speed = max(MM * layer_depth_m, 1e-3), MM * max(abs(speed_m_s), config.rest_speed_m_s)
    slope = max(own_N / depth, _LEAST_SLOPE)
    rho, kappa = config.friction_share, config.coulomb_share(speed / MM)
    row = np.zeros(6)
    row[CUTTING], row[STIFFNESS] = -rho / depth, -rho
    row[OWN_COULOMB], row[OWN_VISCOUS] = 1.0 - rho, (1.0 - rho) * speed
    kept = -rho * held.mean_N / depth
    information = add_row(information, row, kept, (config.friction_share_std * slope) ** 2)
    row = np.zeros(6)
    row[OWN_COULOMB], row[OWN_VISCOUS] = 1.0 - kappa, -kappa * speed
    information = add_row(
        information, row, 0.0, (config.coulomb_share_std(speed / MM) * rho * slope) ** 2
    )
    row = np.zeros(6)
    row[CUTTING] = 1.0
    reach = MM * config.cutting_reach_m * slope
    return add_row(information, row, held.mean_N, reach * reach + held.variance)


_DROP_ERROR_SHARE = 0.004


class ClosedLayer(NamedTuple):
    """A layer that has been left, and the state in which the next one begins.

    Attributes:
        estimate: What is known of it.
        traversed: Its friction, for the way out.
        next_layer: Next layer, its prior the cumulative friction now known.
        next_fit: Fit with which it begins.
    """

    estimate: LayerEstimate
    traversed: Traversed
    next_layer: LayerData
    next_fit: LayerFit


def identify_layer(
    left: LayerData,
    rupture: Rupture,
    ending: RuptureMeasurement,
    bias_var: float,
    config: MultilayerConfig,
) -> IdentifiedLayer:
    """Batch refit of the layer with both sides of its rupture as measurements.

    The force before is tip and friction together, the force after is friction alone (unless the
    tissue only tore, see `tear`): their difference is (10), K d = f_drop. With small noise the
    answer is that of the re-weighting (12); here it comes with a covariance.

    Args:
        left: Data of the layer.
        rupture: Its end.
        ending: Forces on both sides of the rupture.
        bias_var: Variance of the sensor's slow error [N^2].
        config: Settings.
    """
    boundary, thickness = ending.boundary, _thickness_m(left, ending, config)
    tip = max(boundary.depth_m - left.tip_m, config.track_step_m)
    before = model_row(thickness, tip, boundary.speed_m_s, 1.0, config.cutting_onset_m)
    own = boundary.force_N - _earlier_N(left, before)
    known = left.prior
    if ending.is_one_law:  # else a spring or another layer is in the data
        known = NormalEquations(known.matrix + left.data.matrix, known.vector + left.data.vector)
    known = add_layer_prior(known, own, thickness, boundary.speed_m_s, config, left.held)
    known = add_row(known, before, boundary.force_N, boundary.force_var + bias_var)
    after = _after(ending, bias_var, rupture.speed_m_s)
    fit = solve_layer(_with_after(known, after, thickness, config))
    return IdentifiedLayer(fit, believe(known))


def close_layer(
    left: LayerData,
    rupture: Rupture,
    ending: RuptureMeasurement,
    identified: IdentifiedLayer,
    bias_var: float,
    config: MultilayerConfig,
) -> ClosedLayer:
    """What is told of the layer, and how the next one begins.

    Args:
        left: Data of the layer.
        rupture: Its end.
        ending: Forces on both sides of the rupture.
        identified: Its unknowns.
        bias_var: Variance of the sensor's slow error [N^2].
        config: Settings.
    """
    (fit, belief), thickness = identified, _thickness_m(left, ending, config)
    after = _after(ending, bias_var, rupture.speed_m_s)
    found = Gaussian(np.array(fit.values), fit.covariance)
    return ClosedLayer(
        layer_estimate(rupture, ending, left.start_m, thickness, found),
        Traversed(
            left.start_m,
            thickness,
            MM * thickness * fit.values[OWN_COULOMB],
            MM * thickness * fit.values[OWN_VISCOUS],
            belief,
            ending.end_probability,
        ),
        LayerData(
            ending.boundary.depth_m,
            rupture.depth_m,
            _next_prior(carried_friction(belief, thickness), after, config),
            no_information(),
            held=ending.held,
        ),
        _next_fit(fit, thickness, after, config),
    )


def _thickness_m(left: LayerData, ending: RuptureMeasurement, config: MultilayerConfig) -> float:
    return max(ending.boundary.depth_m - left.start_m, config.track_step_m)


class _After(NamedTuple):
    """The force after a rupture as a measurement.

    Attributes:
        ending: Its value, and the next layer's share in it.
        variance: Of the value [N^2].
        speed_m_s: At the rupture.
    """

    ending: RuptureMeasurement
    variance: float
    speed_m_s: float


def _after(ending: RuptureMeasurement, bias_var: float, speed_m_s: float) -> _After:
    law = (_DROP_ERROR_SHARE * ending.drop_N) ** 2
    return _After(ending, ending.friction_var + bias_var + law, speed_m_s)


def _earlier_N(left: LayerData, row: NDArray[np.float64]) -> float:
    """Friction of the layers before, as believed when this one began."""
    matrix = left.prior.matrix[:2, :2] + 1e-9 * np.eye(2)
    return float(row[:2] @ np.linalg.solve(matrix, left.prior.vector[:2]))


def _with_after(
    known: NormalEquations, after: _After, thickness_m: float, config: MultilayerConfig
) -> NormalEquations:
    """Add the force after the rupture to what is known of the layer left.

    After the puncture of a membrane the next layer springs back along the shaft: it rubs on the
    length that had been pushed in. That share of its slope is here what the prior guesses.
    """
    ending, slope = after.ending, after.ending.next_slope_N_per_mm
    rubbing = ending.pushed_in_mm * slope
    doubt = math.hypot(
        config.friction_share_std * rubbing,
        config.friction_share * slope * MM * ending.boundary.std_m,
    )
    row = model_row(thickness_m, 0.0, after.speed_m_s, 1.0, config.cutting_onset_m)
    value = ending.friction_N - config.friction_share * rubbing
    return add_row(known, row, value, after.variance + doubt**2)


def _next_prior(friction: Gaussian, after: _After, config: MultilayerConfig) -> NormalEquations:
    """What is known when the next layer begins: the friction carried into it, and the force then.

    With a membrane that force holds some of the layer's own friction: what it identifies tells
    later how much.
    """
    matrix, vector = np.zeros((6, 6)), np.zeros(6)
    matrix[:2, :2] = np.linalg.inv(friction.covariance + 1e-12 * np.eye(2))
    vector[:2] = matrix[:2, :2] @ friction.values
    ending = after.ending
    row = model_row(ending.pushed_in_mm / MM, 0.0, after.speed_m_s, 1.0, config.cutting_onset_m)
    edge = config.friction_share * ending.next_slope_N_per_mm * MM * ending.boundary.std_m
    variance = after.variance + edge**2
    return add_row(NormalEquations(matrix, vector), row, ending.friction_N, variance)


def _next_fit(
    fit: LayerFit, thickness_m: float, after: _After, config: MultilayerConfig
) -> LayerFit:
    """Fit with which the next layer begins."""
    friction = carried_friction(Gaussian(np.array(fit.values), fit.covariance), thickness_m)
    values, covariance = np.zeros(6), np.zeros((6, 6))
    values[:2], covariance[:2, :2] = friction
    values[STIFFNESS:] = _guess(after.ending.next_slope_N_per_mm, after.speed_m_s, config)
    return layer_fit(values, covariance)


def _guess(
    slope_N_per_mm: float, speed_m_s: float, config: MultilayerConfig
) -> tuple[float, float, float]:
    """K, c and b a layer of that slope has by prior."""
    friction = config.friction_share * slope_N_per_mm
    share = config.coulomb_share(speed_m_s)
    viscous = (1.0 - share) * friction / (MM * max(speed_m_s, config.rest_speed_m_s))
    return slope_N_per_mm - friction, share * friction, viscous


# One track point into the current layer's normal equations.


_POOLED_BLOCKS = 20.0
"""A row spans 0.1 s or `row_m` of travel, whichever is sooner."""
_OTHER_SHARE = 0.2


def layer_step(
    state: MultilayerState,
    point: NDArray[np.float64],
    config: MultilayerConfig,
    *,
    is_solved: bool = True,
) -> MultilayerState:
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
    state: MultilayerState, config: MultilayerConfig, *, is_solved: bool = True
) -> MultilayerState:
    """Turn the pooled points into one row and fit anew.

    A row weighs by its noise and by the error of the linear law, which rows within a few
    millimetres share: many rows do not make a wrong law right.
    """
    layer, pool = state.layer, state.layer.pool
    if pool is None:
        return state
    point = np.append(pool[:BLOCKS] / pool[BLOCKS], pool[BLOCKS:])
    row, force = _row(layer, point, config), float(point[FORCE])
    own = force - _earlier_N_layer_step(state, row)
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


def _refit(
    state: MultilayerState, point: NDArray[np.float64], config: MultilayerConfig
) -> MultilayerState:
    """Fit the layer with everything known so far, `point` being the newest."""
    layer = state.layer
    row = _row(layer, point, config)
    own = float(point[FORCE]) - _earlier_N_layer_step(state, row)
    known = NormalEquations(
        layer.prior.matrix + layer.data.matrix, layer.prior.vector + layer.data.vector
    )
    depth = float(point[DEPTH]) - layer.start_m
    known = add_layer_prior(known, own, depth, float(point[SPEED]), config, layer.held)
    fit = solve_layer(known)
    row[[CUTTING, STIFFNESS]] = 0.0
    spread = float(row @ fit.covariance @ row)
    return state._replace(fit=fit, shaft_std_N=math.sqrt(max(spread, 0.0)))


def _row(
    layer: LayerData, point: NDArray[np.float64], config: MultilayerConfig
) -> NDArray[np.float64]:
    depth = float(point[DEPTH])
    return model_row(
        depth - layer.start_m,
        depth - layer.tip_m,
        float(point[SPEED]),
        float(point[BRISTLE]),
        config.cutting_onset_m,
    )


def _earlier_N_layer_step(state: MultilayerState, row: NDArray[np.float64]) -> float:
    return float(row[0]) * state.fit.values[0] + float(row[1]) * state.fit.values[1]
