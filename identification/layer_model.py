"""Force of the current layer as a linear model, fitted with priors and without negative values.

Equation (3) with friction beyond viscous: f = s C + v V + F_c g(x) + K x + s c dz + v b dz, with
s the presliding deflection (1 when sliding inwards), C and V the Coulomb and viscous friction of
the layers traversed, F_c the cutting force building up over g, and K, c, b of the current layer.
dz is the length of shaft in the layer, x the travel of the tip in it: less than dz by what a
membrane was pushed in before its puncture.
Lengths are in millimetres in here, so that all six unknowns are of similar size.

Behind a membrane the friction measured after the puncture is that of the layer left *and* of the
length of the next one that had been pushed in: only the next layer's own rupture separates the
two. The posterior of each layer is therefore kept as it was before that measurement, and what
becomes known of the sum is carried back (the smoother of Rauch, Tung, Striebel 1965).
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from identification.estimate import LayerEstimate

MM = 1e3
COULOMB, VISCOUS, CUTTING, STIFFNESS, OWN_COULOMB, OWN_VISCOUS = range(6)
"""Places of C [N], V [N/(mm/s)], F_c [N], K [N/mm], c [N/mm], b [N/(mm mm/s)] in a vector."""
IDENTIFIED_FRACTION = 0.25
"""A value is identified if its standard deviation is no more of it."""
_SIZE = 6
_TINY = 1e-12
_RIDGE = 1e-10 * np.eye(_SIZE)

Array = NDArray[np.float64]


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
    return NormalEquations(np.zeros((_SIZE, _SIZE)), np.zeros(_SIZE))


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
    """Stiffness and friction of a layer left as fields of `LayerEstimate`.

    Back to SI: c in N/m is 1e3 c in N/mm, b in Ns/m^2 is 1e6 b in N/(mm mm/s).
    """
    values = np.maximum(layer.values, 0.0)
    std = np.sqrt(np.maximum(np.diag(layer.covariance), 0.0))
    speed = max(rupture_speed_m_s, 1e-6)
    row = np.zeros(6)
    row[OWN_COULOMB], row[OWN_VISCOUS] = MM * thickness_m, MM * thickness_m * MM * speed
    friction = max(float(row @ layer.values), 0.0)
    friction_std = float(np.sqrt(max(row @ layer.covariance @ row, 0.0)))
    stiffness, stiffness_std = MM * float(values[STIFFNESS]), MM * float(std[STIFFNESS])
    coulomb, coulomb_std = MM * float(values[OWN_COULOMB]), MM * float(std[OWN_COULOMB])
    viscous, viscous_std = 1e6 * float(values[OWN_VISCOUS]), 1e6 * float(std[OWN_VISCOUS])
    per_length = 1.0 / (thickness_m * speed)
    return {
        "stiffness_N_per_m": stiffness,
        "stiffness_std_N_per_m": stiffness_std,
        "stiffness_identified": _is_identified(stiffness, stiffness_std),
        "friction_Ns_per_m2": friction * per_length,
        "friction_std_Ns_per_m2": friction_std * per_length,
        "friction_identified": _is_identified(friction, friction_std),
        "friction_N": friction,
        "friction_std_N": friction_std,
        "coulomb_N_per_m": coulomb,
        "coulomb_std_N_per_m": coulomb_std,
        "coulomb_identified": _is_identified(coulomb, coulomb_std),
        "viscous_Ns_per_m2": viscous,
        "viscous_std_Ns_per_m2": viscous_std,
        "viscous_identified": _is_identified(viscous, viscous_std),
    }


def revised(estimate: LayerEstimate, layer: Gaussian) -> LayerEstimate:
    """The same layer with a newer distribution of its unknowns."""
    speed_m_s = estimate.rupture.speed_m_s
    return replace(estimate, **layer_outputs(layer, estimate.thickness_m, speed_m_s))


def _is_identified(value: float, std: float) -> bool:
    return std <= IDENTIFIED_FRACTION * abs(value)
