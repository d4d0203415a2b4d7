"""The layers left, with what has been felt since."""

import numpy as np

from identification.default_standing import open_rupture
from identification.default_state import DefaultState
from identification.estimate import LayerEstimate
from identification.layer_figures import revised
from identification.layer_hindsight import Belief, look_back


def default_layers(state: DefaultState) -> tuple[LayerEstimate, ...]:
    """The layers left, as all that has been felt since tells them."""
    pending = open_rupture(state)
    fit = state.fit if pending is None else pending.left_fit
    friction = Belief(np.array(fit.values[:2]), fit.covariance[:2, :2])
    layers: list[LayerEstimate] = []
    for estimate, left in zip(reversed(state.layers), reversed(state.traversed), strict=True):
        belief = look_back(left.belief, left.thickness_m, friction)
        layers.append(revised(estimate, belief))
        friction = Belief(belief.values[:2], belief.covariance[:2, :2])
    return tuple(reversed(layers))
