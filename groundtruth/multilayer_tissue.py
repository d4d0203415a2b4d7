"""The textbook tissue: exactly the multi-layer model the estimators identify."""

from dataclasses import replace
from typing import NamedTuple

from groundtruth.layers import Interface, Layer, interfaces
from groundtruth.tissue import NeedleSample, TissueForce, checked_sample, no_force


class MultilayerTissueState(NamedTuple):
    """What the textbook tissue remembers.

    Attributes:
        traversed: Layers whose far end the tip has reached; their elastic part is gone for good.
        force: The force at the last step.
    """

    traversed: int
    force: TissueForce


def textbook_step(
    state: MultilayerTissueState, sample: NeedleSample, layers: tuple[Layer, ...]
) -> MultilayerTissueState:
    """Advance by one sample: f = K_i Δz_i + B_i Δz_i v + B̄_d v, equation (3) of the paper.

    The elastic part of a layer ends for good when the tip reaches its far end, so there is none
    after the exit and none on the way back. Membranes and cutting force are not in equation (3)
    and are left out; K_i and B_i are the layer's textbook values.

    Args:
        state: The tissue before.
        sample: Where the needle is now.
        layers: First the one the needle meets first.
    """
    z, v, _ = sample
    traversed, index, top, tip = state.traversed, 0, 0.0, 0.0
    shares = [0.0] * len(layers)
    for i, layer in enumerate(layers):
        if z <= top:
            break
        index = i + 1
        d = layer.thickness_m
        shares[i] = layer.friction.textbook_Ns_per_m2 * min(z - top, d) * v
        if z - top >= d:
            traversed = max(traversed, index)
            index += 1
        elif i >= traversed:
            tip = layer.stiffness_N_per_m * (z - top)
        top += d
    friction = sum(shares)
    return MultilayerTissueState(
        traversed, TissueForce(tip + friction, tip, friction, index, tuple(shares))
    )


class MultilayerTissue:
    """A stack of layers under equation (3), for proofs of algebra only."""

    def __init__(self, layers: tuple[Layer, ...]) -> None:
        """Lay fresh tissue.

        Args:
            layers: First the one the needle meets first; none is free air.
        """
        self._layers = tuple(layers)
        self.reset()

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The layers, first the one the needle meets first."""
        return self._layers

    @property
    def interfaces(self) -> tuple[Interface, ...]:
        """The boundaries; the tip force of the layer above vanishes at once, membranes are bare."""
        return tuple(
            replace(
                boundary,
                onset_m=boundary.depth_m,
                release_m=0.0,
                drop_N=0.0 if i == 0 else self._layers[i - 1].exit_force_N,
                membrane=None,
            )
            for i, boundary in enumerate(interfaces(self._layers))
        )

    def step(self, depth_m: float, speed_m_s: float, dt_s: float) -> TissueForce:
        """Advance by one step and return the force at its end.

        Args:
            depth_m: Travel of the tip since first contact, at the end of the step.
            speed_m_s: Speed of the tip, positive inwards.
            dt_s: Length of the step; equation (3) has no memory of time, it is only checked.

        Raises:
            TissueError: A value is not finite or `dt_s` is not positive; the state is unchanged.
        """
        sample = checked_sample(depth_m, speed_m_s, dt_s)
        self._state = textbook_step(self._state, sample, self._layers)
        return self._state.force

    def reset(self) -> None:
        """Forget everything: a fresh, uncut tissue."""
        self._state = MultilayerTissueState(0, no_force(len(self._layers)))
