"""What later data tell about a layer already left.

Behind a membrane the friction measured after the puncture is that of the layer left *and* of the
length of the next one that had been pushed in: only the next layer's own rupture tells the two
apart. The belief about each layer is therefore kept as it was before that measurement, and what
becomes known of the sum is carried back (the smoother of Rauch, Tung, Striebel 1965).
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.estimate import LayerEstimate, Rupture
from identification.layer_model import (
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    STIFFNESS,
    LayerFit,
    NormalEquations,
)
from identification.rupture_classifier import RuptureMeasurement

_TINY = 1e-12
_RIDGE = 1e-10 * np.eye(6)

Array = NDArray[np.float64]


class Gaussian(NamedTuple):
    """Gaussian belief about the six unknowns of a layer, see `layer_model`.

    Attributes:
        values: Mean, shape (6,).
        covariance: Shape (6, 6).
    """

    values: Array
    covariance: Array


class IdentifiedLayer(NamedTuple):
    """What is known of the unknowns of a layer that has been left.

    Attributes:
        fit: None of them negative.
        belief: Without what the force after the rupture tells.
    """

    fit: LayerFit
    belief: Gaussian


def believe(known: NormalEquations) -> Gaussian:
    """The belief that normal equations stand for, negative values not excluded."""
    scale = 1.0 / np.sqrt(np.maximum(known.matrix.diagonal(), _TINY))
    both = scale[:, None] * scale
    covariance = np.linalg.inv(known.matrix * both + _RIDGE) * both
    return Gaussian(covariance @ known.vector, covariance)


def carried_friction(belief: Gaussian, thickness_m: float) -> Gaussian:
    """Friction up to and with the layer: the next layer's C and V, shapes (2,) and (2, 2)."""
    carry = _carry(thickness_m)
    return Gaussian(carry @ belief.values, carry @ belief.covariance @ carry.T)


def look_back(belief: Gaussian, thickness_m: float, friction: Gaussian) -> Gaussian:
    """The belief about a layer once its carried friction is known better.

    Args:
        belief: About the layer, when it was left.
        thickness_m: Its thickness.
        friction: What is known now of the next layer's C and V, that belief included.
    """
    expected = carried_friction(belief, thickness_m)
    spread = expected.covariance + _TINY * np.eye(2)
    gain = np.linalg.solve(spread, _carry(thickness_m) @ belief.covariance).T
    change = friction.covariance - expected.covariance
    return Gaussian(
        belief.values + gain @ (friction.values - expected.values),
        belief.covariance + gain @ change @ gain.T,
    )


def _carry(thickness_m: float) -> Array:
    depth = MM * thickness_m
    carry = np.zeros((2, 6))
    carry[0, 0], carry[0, OWN_COULOMB] = 1.0, depth
    carry[1, 1], carry[1, OWN_VISCOUS] = 1.0, depth
    return carry


# The figures of a layer that has been left, from the belief about its unknowns.


IDENTIFIED_SHARE = 0.25
"""A value is identified if its standard deviation is no more of it."""


def layer_estimate(
    rupture: Rupture,
    ending: RuptureMeasurement,
    start_m: float,
    thickness_m: float,
    belief: Gaussian,
) -> LayerEstimate:
    """What is known of a layer that has just been left.

    Args:
        rupture: Its end.
        ending: Forces on both sides of it.
        start_m: Where it begins.
        thickness_m: Its thickness.
        belief: About its unknowns.
    """
    return LayerEstimate(
        layer=rupture.layer,
        start_depth_m=start_m,
        thickness_m=thickness_m,
        rupture=rupture,
        force_drop_N=ending.drop_N,
        force_drop_std_N=ending.drop_std_N,
        **_figures(belief, thickness_m, rupture.speed_m_s),
    )


def revised(estimate: LayerEstimate, belief: Gaussian) -> LayerEstimate:
    """The same layer with a newer belief about its unknowns."""
    figures = _figures(belief, estimate.thickness_m, estimate.rupture.speed_m_s)
    return replace(estimate, **figures)


def _figures(belief: Gaussian, thickness_m: float, rupture_speed_m_s: float) -> dict[str, Any]:
    """Back to SI: c in N/m is 1e3 c in N/mm, b in Ns/m^2 is 1e6 b in N/(mm mm/s)."""
    values = np.maximum(belief.values, 0.0)
    std = np.sqrt(np.maximum(np.diag(belief.covariance), 0.0))
    speed = max(rupture_speed_m_s, 1e-6)
    row = np.zeros(6)
    row[OWN_COULOMB], row[OWN_VISCOUS] = MM * thickness_m, MM * thickness_m * MM * speed
    friction = max(float(row @ belief.values), 0.0)
    friction_std = float(np.sqrt(max(row @ belief.covariance @ row, 0.0)))
    stiffness, stiffness_std = MM * float(values[STIFFNESS]), MM * float(std[STIFFNESS])
    coulomb, coulomb_std = MM * float(values[OWN_COULOMB]), MM * float(std[OWN_COULOMB])
    viscous, viscous_std = 1e6 * float(values[OWN_VISCOUS]), 1e6 * float(std[OWN_VISCOUS])
    per_length = 1.0 / (thickness_m * speed)
    return {
        "stiffness_N_per_m": stiffness,
        "stiffness_std_N_per_m": stiffness_std,
        "stiffness_identified": is_identified(stiffness, stiffness_std),
        "friction_Ns_per_m2": friction * per_length,
        "friction_std_Ns_per_m2": friction_std * per_length,
        "friction_identified": is_identified(friction, friction_std),
        "friction_N": friction,
        "friction_std_N": friction_std,
        "coulomb_N_per_m": coulomb,
        "coulomb_std_N_per_m": coulomb_std,
        "coulomb_identified": is_identified(coulomb, coulomb_std),
        "viscous_Ns_per_m2": viscous,
        "viscous_std_Ns_per_m2": viscous_std,
        "viscous_identified": is_identified(viscous, viscous_std),
    }


def is_identified(value: float, std: float) -> bool:
    """Whether a value is known to within a quarter of itself."""
    return std <= IDENTIFIED_SHARE * abs(value)
