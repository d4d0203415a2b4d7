"""Identification of a layer from its data and the rupture that ended it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.default_config import DefaultConfig
from identification.default_state import LayerData, Traversed
from identification.estimate import LayerEstimate, Rupture
from identification.layer_ending import LayerEnding
from identification.layer_model import (
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    STIFFNESS,
    Information,
    LayerFit,
    add_row,
    layer_fit,
    model_row,
    no_information,
    solve_layer,
)
from identification.layer_prior import add_layer_prior

_DROP_ERROR_SHARE = 0.01
_IDENTIFIED_SHARE = 0.25


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


def close_layer(
    left: LayerData,
    rupture: Rupture,
    ending: LayerEnding,
    bias_var: float,
    config: DefaultConfig,
) -> ClosedLayer:
    """Batch refit of the layer with both sides of its rupture as measurements.

    The force before is tip and friction together, the force after is friction alone: their
    difference is (10), K d = f_drop. With small noise the answer is that of the re-weighting
    (12); here it comes with a covariance.

    Args:
        left: Data of the layer.
        rupture: Its end.
        ending: Forces on both sides of the rupture.
        bias_var: Variance of the sensor's slow error [N^2].
        config: Settings.
    """
    thickness = max(ending.boundary_m - left.start_m, config.track_step_m)
    tip = max(ending.boundary_m - left.tip_m, config.track_step_m)
    before = model_row(thickness, tip, rupture.speed_m_s, 1.0, config.cutting_onset_m)
    after = before.copy()
    after[[2, STIFFNESS]] = 0.0
    own = ending.before_N - _earlier_N(left, before)
    known = left.prior
    if not ending.has_membrane:  # else its spring is in the data
        known = Information(known.matrix + left.data.matrix, known.vector + left.data.vector)
    known = add_layer_prior(known, own, thickness, rupture.speed_m_s, config)
    known = add_row(known, before, ending.before_N, ending.before_var + bias_var)
    law = (_DROP_ERROR_SHARE * ending.drop_N) ** 2
    known = add_row(known, after, ending.after_N, ending.after_var + bias_var + law)
    fit = solve_layer(known)
    return _hand_over(left, rupture, ending, fit, thickness, config)


def _earlier_N(left: LayerData, row: NDArray[np.float64]) -> float:
    """Friction of the layers before, as believed when this one began."""
    matrix = left.prior.matrix[:2, :2] + 1e-9 * np.eye(2)
    return float(row[:2] @ np.linalg.solve(matrix, left.prior.vector[:2]))


def _hand_over(
    left: LayerData,
    rupture: Rupture,
    ending: LayerEnding,
    fit: LayerFit,
    thickness_m: float,
    config: DefaultConfig,
) -> ClosedLayer:
    depth = MM * thickness_m
    carry = np.zeros((2, 6))
    carry[0, 0], carry[0, OWN_COULOMB] = 1.0, depth
    carry[1, 1], carry[1, OWN_VISCOUS] = 1.0, depth
    cumulative, covariance = carry @ np.array(fit.values), carry @ fit.covariance @ carry.T
    prior = np.zeros((6, 6))
    prior[:2, :2] = np.linalg.inv(covariance + 1e-12 * np.eye(2))
    vector = np.zeros(6)
    vector[:2] = prior[:2, :2] @ cumulative
    next_values, next_covariance = np.zeros(6), np.zeros((6, 6))
    next_values[:2], next_covariance[:2, :2] = cumulative, covariance
    next_values[STIFFNESS:] = _guess(ending.next_slope_N_per_mm, rupture.speed_m_s, config)
    return ClosedLayer(
        _estimate(left, rupture, ending, fit, thickness_m),
        Traversed(
            left.start_m,
            thickness_m,
            depth * fit.values[OWN_COULOMB],
            depth * fit.values[OWN_VISCOUS],
        ),
        LayerData(ending.boundary_m, rupture.depth_m, Information(prior, vector), no_information()),
        layer_fit(next_values, next_covariance),
    )


def _guess(
    slope_N_per_mm: float, speed_m_s: float, config: DefaultConfig
) -> tuple[float, float, float]:
    """K, c and b a layer of that slope has by prior."""
    friction = config.friction_share * slope_N_per_mm
    share = config.coulomb_share(speed_m_s)
    viscous = (1.0 - share) * friction / (MM * max(speed_m_s, config.rest_speed_m_s))
    return slope_N_per_mm - friction, share * friction, viscous


def _estimate(
    left: LayerData, rupture: Rupture, ending: LayerEnding, fit: LayerFit, thickness_m: float
) -> LayerEstimate:
    """Back to SI: c in N/m is 1e3 c in N/mm, b in Ns/m^2 is 1e6 b in N/(mm mm/s)."""
    values, std = np.array(fit.values), np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    speed = max(rupture.speed_m_s, 1e-6)
    row = np.zeros(6)
    row[OWN_COULOMB], row[OWN_VISCOUS] = MM * thickness_m, MM * thickness_m * MM * speed
    friction = float(row @ values)
    friction_std = float(np.sqrt(max(row @ fit.covariance @ row, 0.0)))
    stiffness, stiffness_std = MM * float(values[STIFFNESS]), MM * float(std[STIFFNESS])
    coulomb, coulomb_std = MM * float(values[OWN_COULOMB]), MM * float(std[OWN_COULOMB])
    viscous, viscous_std = 1e6 * float(values[OWN_VISCOUS]), 1e6 * float(std[OWN_VISCOUS])
    per_length = 1.0 / (thickness_m * speed)
    return LayerEstimate(
        layer=rupture.layer,
        start_depth_m=left.start_m,
        thickness_m=thickness_m,
        rupture=rupture,
        force_drop_N=ending.drop_N,
        force_drop_std_N=ending.drop_std_N,
        stiffness_N_per_m=stiffness,
        stiffness_std_N_per_m=stiffness_std,
        stiffness_identified=is_identified(stiffness, stiffness_std),
        friction_Ns_per_m2=friction * per_length,
        friction_std_Ns_per_m2=friction_std * per_length,
        friction_identified=is_identified(friction, friction_std),
        friction_N=friction,
        friction_std_N=friction_std,
        coulomb_N_per_m=coulomb,
        coulomb_std_N_per_m=coulomb_std,
        coulomb_identified=is_identified(coulomb, coulomb_std),
        viscous_Ns_per_m2=viscous,
        viscous_std_Ns_per_m2=viscous_std,
        viscous_identified=is_identified(viscous, viscous_std),
    )


def is_identified(value: float, std: float) -> bool:
    """Whether a value is known to within a quarter of itself."""
    return std <= _IDENTIFIED_SHARE * abs(value)
