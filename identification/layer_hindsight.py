"""What later data tell about a layer already left.

Behind a membrane the friction measured after the puncture is that of the layer left *and* of the
length of the next one that had been pushed in: only the next layer's own rupture tells the two
apart. The belief about each layer is therefore kept as it was before that measurement, and what
becomes known of the sum is carried back (the smoother of Rauch, Tung, Striebel 1965).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.layer_model import MM, OWN_COULOMB, OWN_VISCOUS, Information, LayerFit

_TINY = 1e-12
_RIDGE = 1e-10 * np.eye(6)

Array = NDArray[np.float64]


class Belief(NamedTuple):
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
    belief: Belief


def believe(known: Information) -> Belief:
    """The belief that normal equations stand for, negative values not excluded."""
    scale = 1.0 / np.sqrt(np.maximum(known.matrix.diagonal(), _TINY))
    both = scale[:, None] * scale
    covariance = np.linalg.inv(known.matrix * both + _RIDGE) * both
    return Belief(covariance @ known.vector, covariance)


def carried_friction(belief: Belief, thickness_m: float) -> Belief:
    """Friction up to and with the layer: the next layer's C and V, shapes (2,) and (2, 2)."""
    carry = _carry(thickness_m)
    return Belief(carry @ belief.values, carry @ belief.covariance @ carry.T)


def look_back(belief: Belief, thickness_m: float, friction: Belief) -> Belief:
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
    return Belief(
        belief.values + gain @ (friction.values - expected.values),
        belief.covariance + gain @ change @ gain.T,
    )


def _carry(thickness_m: float) -> Array:
    depth = MM * thickness_m
    carry = np.zeros((2, 6))
    carry[0, 0], carry[0, OWN_COULOMB] = 1.0, depth
    carry[1, 1], carry[1, OWN_VISCOUS] = 1.0, depth
    return carry
