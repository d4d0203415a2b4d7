"""Force of the current layer as a linear model, fitted with priors and without negative values.

Equation (3) with friction beyond viscous: f = s C + v V + F_c g(x) + K x + s c dz + v b dz, with
s the presliding deflection (1 when sliding inwards), C and V the Coulomb and viscous friction of
the layers traversed, F_c the cutting force building up over g, and K, c, b of the current layer.
dz is the length of shaft in the layer, x the travel of the tip in it: less than dz by what a
membrane was pushed in before its puncture.
Lengths are in millimetres in here, so that all six unknowns are of similar size.

Behind a membrane the friction measured after the puncture is that of the layer traversed *and* of
the length of the next one that had been pushed in: only the next layer's own rupture separates the
two. The posterior of each layer is therefore kept as it was before that measurement, and what
becomes known of the sum is carried back (the smoother of Rauch, Tung, Striebel 1965).
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import nnls

from identification.config import MultilayerConfig
from identification.estimate import Array, LayerEstimate

MM = 1e3
COULOMB, VISCOUS, CUTTING, STIFFNESS, OWN_COULOMB, OWN_VISCOUS = range(6)
"""Places of C [N], V [N/(mm/s)], F_c [N], K [N/mm], c [N/mm], b [N/(mm mm/s)] in a vector."""
IDENTIFIED_FRACTION = 0.25
"""A value is identified if its standard deviation is no more of it."""
_TINY = 1e-12
_RIDGE = 1e-10 * np.eye(6)
_LEAST_SLOPE = 1e-4


class NormalEquations(NamedTuple):
    """Weighted normal equations: all that is known about the six unknowns."""

    matrix: Array  # Sum of w phi phi', shape (6, 6)
    vector: Array  # Sum of w phi f, shape (6,)

    def plus(self, other: "NormalEquations") -> "NormalEquations":
        """What both know."""
        return NormalEquations(self.matrix + other.matrix, self.vector + other.vector)


class Gaussian(NamedTuple):
    """Distribution of the six unknowns, or of the first two."""

    values: Array  # Mean, shape (n,)
    covariance: Array  # Shape (n, n)


def no_information() -> NormalEquations:
    """Nothing known."""
    return NormalEquations(np.zeros((6, 6)), np.zeros(6))


def model_row(
    layer_depth_m: float, tip_depth_m: float, speed_m_s: float, bristle: float, onset_m: float
) -> Array:
    """Regressor phi, shape (6,); the cutting force is a parabola to 1 at `onset_m` of the tip."""
    depth, speed = MM * max(layer_depth_m, 0.0), MM * speed_m_s
    reach = min(max(tip_depth_m / onset_m, 0.0), 1.0)
    tip, onset = MM * max(tip_depth_m, 0.0), reach * (2.0 - reach)
    return np.array([bristle, speed, onset, tip, depth * bristle, depth * speed])


def add_row(known: NormalEquations, row: Array, value: float, variance: float) -> NormalEquations:
    """Add a measurement row @ x = value with the given variance."""
    weighted = row / max(variance, _TINY)
    return NormalEquations(known.matrix + weighted[:, None] * row, known.vector + weighted * value)


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
    the elastic force: friction is a fraction of both. `own_N` is the axial force less the friction
    of earlier layers, `residual` mean and variance of the tip force that the layer began with.
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


def solve_layer(known: NormalEquations) -> Gaussian:
    """Most likely non-negative values, and the covariance of the unconstrained ones."""
    scale = 1.0 / np.sqrt(np.maximum(known.matrix.diagonal(), _TINY))
    both = scale[:, None] * scale
    factor = np.linalg.cholesky(known.matrix * both + _RIDGE)
    target = np.linalg.solve(factor, known.vector * scale)
    values, _ = nnls(factor.T, target)
    inverse = np.linalg.inv(factor)
    return Gaussian(values * scale, (inverse.T @ inverse) * both)


def posterior(known: NormalEquations) -> Gaussian:
    """The distribution that normal equations stand for, negative values not excluded."""
    scale = 1.0 / np.sqrt(np.maximum(known.matrix.diagonal(), _TINY))
    both = scale[:, None] * scale
    covariance = np.linalg.inv(known.matrix * both + _RIDGE) * both
    return Gaussian(covariance @ known.vector, covariance)


def carried_friction(layer: Gaussian, thickness_m: float) -> Gaussian:
    """Friction up to and with the layer: the next layer's C and V, shapes (2,) and (2, 2)."""
    carry = _carry(thickness_m)
    return Gaussian(carry @ layer.values, carry @ layer.covariance @ carry.T)


def smoothed_layer(layer: Gaussian, thickness_m: float, friction: Gaussian) -> Gaussian:
    """The posterior of a layer once its carried friction is known better."""
    expected = carried_friction(layer, thickness_m)
    spread = expected.covariance + _TINY * np.eye(2)
    gain = np.linalg.solve(spread, _carry(thickness_m) @ layer.covariance).T
    change = friction.covariance - expected.covariance
    return Gaussian(
        layer.values + gain @ (friction.values - expected.values),
        layer.covariance + gain @ change @ gain.T,
    )


def _carry(thickness_m: float) -> Array:
    depth = MM * thickness_m
    carry = np.zeros((2, 6))
    carry[0, 0], carry[0, OWN_COULOMB] = 1.0, depth
    carry[1, 1], carry[1, OWN_VISCOUS] = 1.0, depth
    return carry


def layer_outputs(layer: Gaussian, thickness_m: float, rupture_speed_m_s: float) -> dict[str, Any]:
    """Stiffness and friction of a layer traversed as fields of `LayerEstimate`.

    Back to SI: c in N/m is 1e3 c in N/mm, b in Ns/m^2 is 1e6 b in N/(mm mm/s).
    """
    values = np.maximum(layer.values, 0.0).tolist()
    std = np.sqrt(np.maximum(np.diag(layer.covariance), 0.0)).tolist()
    speed = max(rupture_speed_m_s, 1e-6)
    row = np.zeros(6)
    row[OWN_COULOMB], row[OWN_VISCOUS] = MM * thickness_m, MM * thickness_m * MM * speed
    friction = max(float(row @ layer.values), 0.0)
    friction_std = float(np.sqrt(max(row @ layer.covariance @ row, 0.0)))
    per_length = 1.0 / (thickness_m * speed)
    fields: dict[str, Any] = {"friction_N": friction, "friction_std_N": friction_std}
    for name, unit, scale, value, deviation in (
        ("stiffness", "N_per_m", MM, values[STIFFNESS], std[STIFFNESS]),
        ("friction", "Ns_per_m2", per_length, friction, friction_std),
        ("coulomb", "N_per_m", MM, values[OWN_COULOMB], std[OWN_COULOMB]),
        ("viscous", "Ns_per_m2", 1e6, values[OWN_VISCOUS], std[OWN_VISCOUS]),
    ):
        fields[f"{name}_{unit}"], fields[f"{name}_std_{unit}"] = scale * value, scale * deviation
        fields[f"{name}_identified"] = deviation <= IDENTIFIED_FRACTION * abs(value)
    return fields


def revised(estimate: LayerEstimate, layer: Gaussian) -> LayerEstimate:
    """The same layer with a newer distribution of its unknowns."""
    speed_m_s = estimate.rupture.speed_m_s
    return replace(estimate, **layer_outputs(layer, estimate.thickness_m, speed_m_s))
