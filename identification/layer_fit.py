"""Identification of a layer: from its points while the tip is inside, and from its rupture."""

import math
from typing import NamedTuple

import numpy as np

from identification.config import MultilayerConfig
from identification.estimate import LayerEstimate, Rupture
from identification.friction_compensation import LayerFriction
from identification.layer_model import (
    CUTTING,
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    STIFFNESS,
    Array,
    Gaussian,
    NormalEquations,
    add_row,
    carried_friction,
    layer_outputs,
    model_row,
    no_information,
    posterior,
    solve_layer,
)
from identification.multilayer_state import LayerData, MultilayerState, TraversedLayer
from identification.resampling import BLOCKS, TRAVEL, add_layer_row
from identification.rupture_classifier import RuptureMeasurement
from identification.slope_change_detector import block_noise_N2

_LEAST_SLOPE = 1e-4
_DROP_ERROR = 0.004
"""Relative error of the law by which the drop is extrapolated."""
_POOLED_BLOCKS = 20.0
"""A row spans 0.1 s or `row_m` of travel, whichever is sooner."""
_OTHER_ERROR = 0.2
"""Weight of the whole force, beside the layer's own, in the error of the linear law."""


def add_layer_prior(
    known: NormalEquations,
    own_N: float,
    layer_depth_m: float,
    speed_m_s: float,
    config: MultilayerConfig,
    residual: tuple[float, float],
) -> NormalEquations:
    """Add the priors on fractions of the force, scaled by what the layer has built up so far.

    At constant speed nothing in a layer separates its stiffness from its friction, nor Coulomb from
    viscous: without these rows the answer would be arbitrary, with them it is a stated guess with
    a stated standard deviation that any rupture or change of speed overrides. Cutting counts with
    the elastic force: friction is a fraction of both.

    Args:
        known: Data and earlier friction.
        own_N: Axial force less the friction of earlier layers, now.
        layer_depth_m: Travel in the layer.
        speed_m_s: Usual speed.
        config: Settings.
        residual: Mean and variance of the tip force that the layer began with.
    """
    depth, speed = max(MM * layer_depth_m, 1e-3), MM * max(abs(speed_m_s), config.rest_speed_m_s)
    slope = max(own_N / depth, _LEAST_SLOPE)
    mean_N, variance = residual
    rho, kappa = config.friction_fraction, config.coulomb_fraction(speed / MM)
    row = np.zeros(6)
    row[CUTTING], row[STIFFNESS] = -rho / depth, -rho
    row[OWN_COULOMB], row[OWN_VISCOUS] = 1.0 - rho, (1.0 - rho) * speed
    kept = -rho * mean_N / depth
    known = add_row(known, row, kept, (config.friction_fraction_std * slope) ** 2)
    row = np.zeros(6)
    row[OWN_COULOMB], row[OWN_VISCOUS] = 1.0 - kappa, -kappa * speed
    kappa_std = config.coulomb_fraction_std(speed / MM)
    known = add_row(known, row, 0.0, (kappa_std * rho * slope) ** 2)
    row = np.zeros(6)
    row[CUTTING] = 1.0
    reach = MM * config.cutting_reach_m * slope
    return add_row(known, row, mean_N, reach * reach + variance)


# One track point after the other, while the tip is inside.


def add_point(
    state: MultilayerState, point: Array, config: MultilayerConfig, *, is_solved: bool = True
) -> MultilayerState:
    """Use one point; every few of them make one row, and a new fit.

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
    millimetres have in common: many rows do not make a wrong law right.
    """
    layer, pool = state.layer, state.layer.pool
    if pool is None:
        return state
    point = np.append(pool[:BLOCKS] / pool[BLOCKS], pool[BLOCKS:])
    depth, speed, force, bristle, blocks, travel = point.tolist()
    row = model_row(
        depth - layer.start_m, depth - layer.tip_m, speed, bristle, config.cutting_onset_m
    )
    before = state.fit.values
    own = force - float(row[0] * before[0] + row[1] * before[1])
    error = config.model_error_fraction * max(abs(own), _OTHER_ERROR * abs(force))
    common = max(config.model_error_m / max(travel, 1e-6), 1.0)
    variance = block_noise_N2(state.detector) / blocks + error * error * common
    layer = layer._replace(
        data=add_row(layer.data, row, force, variance),
        rows=add_layer_row(layer.rows, point),
        pool=None,
    )
    if not is_solved:
        return state._replace(layer=layer)
    known = layer.prior.plus(layer.data)
    inside = depth - layer.start_m
    fit = solve_layer(add_layer_prior(known, own, inside, speed, config, layer.residual))
    row[[CUTTING, STIFFNESS]] = 0.0
    spread = float(row @ fit.covariance @ row)
    return state._replace(layer=layer, fit=fit, shaft_std_N=math.sqrt(max(spread, 0.0)))


# The rupture at its end.


class ClosedLayer(NamedTuple):
    """A layer that has been left, and the state in which the next one begins."""

    estimate: LayerEstimate  # What is known of it
    traversed: TraversedLayer  # Its friction, for the withdrawal
    next_layer: LayerData  # Next layer, its prior the cumulative friction now known
    next_fit: Gaussian  # Fit with which it begins


def identify_layer(
    left: LayerData,
    rupture: Rupture,
    end: RuptureMeasurement,
    bias_var: float,
    config: MultilayerConfig,
) -> tuple[Gaussian, Gaussian]:
    """Batch refit of the layer with both sides of its rupture as measurements.

    The force before is tip and friction together, the force after is friction alone (unless the
    rupture was partial): their difference is (10), K d = f_drop. With small noise the answer is
    that of the re-weighting (12); here it comes with a covariance.

    Returns:
        See `ForceDropMeasurement.layer`.
    """
    boundary, thickness = end.boundary, _thickness_m(left, end, config)
    speed, onset = boundary.speed_m_s, config.cutting_onset_m
    tip = max(boundary.depth_m - left.tip_m, config.track_step_m)
    before = model_row(thickness, tip, speed, 1.0, onset)
    # Friction of the layers before, as expected when this one began.
    matrix = left.prior.matrix[:2, :2] + 1e-9 * np.eye(2)
    own = boundary.force_N - float(before[:2] @ np.linalg.solve(matrix, left.prior.vector[:2]))
    # Without one law a spring or another layer is in the data.
    known = left.prior.plus(left.data) if end.is_one_law else left.prior
    known = add_layer_prior(known, own, thickness, speed, config, left.residual)
    known = add_row(known, before, boundary.force_N, boundary.force_var + bias_var)
    # After the puncture of a membrane the next layer springs back along the shaft: it rubs on the
    # length that had been pushed in. Which fraction of its slope that is, the prior guesses here.
    slope = end.next_slope_N_per_mm
    rubbing = end.pushed_in_mm * slope
    uncertain = math.hypot(
        config.friction_fraction_std * rubbing,
        config.friction_fraction * slope * MM * boundary.std_m,
    )
    row = model_row(thickness, 0.0, rupture.speed_m_s, 1.0, onset)
    value = end.friction_N - config.friction_fraction * rubbing
    fit = solve_layer(add_row(known, row, value, _after_var(end, bias_var) + uncertain**2))
    return fit, posterior(known)


def close_layer(
    left: LayerData,
    rupture: Rupture,
    end: RuptureMeasurement,
    identified: tuple[Gaussian, Gaussian],
    bias_var: float,
    config: MultilayerConfig,
    *,
    is_final: bool,
) -> ClosedLayer:
    """What to report of the layer, and how the next one begins."""
    (fit, known), thickness = identified, _thickness_m(left, end, config)
    friction, speed = carried_friction(known, thickness), rupture.speed_m_s
    own_coulomb, own_viscous = fit.values[[OWN_COULOMB, OWN_VISCOUS]].tolist()
    return ClosedLayer(
        LayerEstimate(
            layer=rupture.layer,
            is_final=is_final,
            start_depth_m=left.start_m,
            thickness_m=thickness,
            rupture=rupture,
            force_drop_N=end.drop_N,
            force_drop_std_N=end.drop_std_N,
            **layer_outputs(fit, thickness, speed),
        ),
        TraversedLayer(
            LayerFriction(
                left.start_m,
                thickness,
                MM * thickness * own_coulomb,
                MM * thickness * own_viscous,
            ),
            known,
            end.end_probability,
        ),
        LayerData(
            end.boundary.depth_m,
            rupture.depth_m,
            _next_prior(friction, end, _after_var(end, bias_var), speed, config),
            no_information(),
            residual=end.residual,
        ),
        _next_fit(carried_friction(fit, thickness), end.next_slope_N_per_mm, speed, config),
    )


def _thickness_m(left: LayerData, end: RuptureMeasurement, config: MultilayerConfig) -> float:
    return max(end.boundary.depth_m - left.start_m, config.track_step_m)


def _after_var(end: RuptureMeasurement, bias_var: float) -> float:
    """Variance of the force after the rupture as a measurement of friction [N^2]."""
    law = (_DROP_ERROR * end.drop_N) ** 2
    return end.friction_var + bias_var + law


def _next_prior(
    friction: Gaussian,
    end: RuptureMeasurement,
    after_var: float,
    speed_m_s: float,
    config: MultilayerConfig,
) -> NormalEquations:
    """What is known when the next layer begins: the friction carried into it, and the force then.

    With a membrane that force holds some of the layer's own friction: what it identifies reveals
    later how much.
    """
    matrix, vector = np.zeros((6, 6)), np.zeros(6)
    matrix[:2, :2] = np.linalg.inv(friction.covariance + 1e-12 * np.eye(2))
    vector[:2] = matrix[:2, :2] @ friction.values
    row = model_row(end.pushed_in_mm / MM, 0.0, speed_m_s, 1.0, config.cutting_onset_m)
    edge = config.friction_fraction * end.next_slope_N_per_mm * MM * end.boundary.std_m
    return add_row(NormalEquations(matrix, vector), row, end.friction_N, after_var + edge**2)


def _next_fit(
    friction: Gaussian, slope_N_per_mm: float, speed_m_s: float, config: MultilayerConfig
) -> Gaussian:
    """Fit with which the next layer begins; K, c and b are the prior of a layer of that slope."""
    values, covariance = np.zeros(6), np.zeros((6, 6))
    values[:2], covariance[:2, :2] = friction
    own = config.friction_fraction * slope_N_per_mm
    coulomb = config.coulomb_fraction(speed_m_s)
    viscous = (1.0 - coulomb) * own / (MM * max(speed_m_s, config.rest_speed_m_s))
    values[STIFFNESS:] = slope_N_per_mm - own, coulomb * own, viscous
    return Gaussian(values, covariance)
