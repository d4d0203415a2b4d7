"""The realistic tissue: ruptures of finite travel, membranes, cutting, presliding, relaxation.

It is deliberately not the law the estimators identify (equation 3). What it shares with it is the
geometry and, at each layer's reference speed, the shaft friction.
"""

from groundtruth.interface import Interface, interfaces
from groundtruth.layer import Layer
from groundtruth.sample import NeedleSample, checked_sample
from groundtruth.tissue_force import TissueForce, no_force
from groundtruth.tissue_state import TissueStack, TissueState, fresh_tissue, tissue_step

UNLOADING_M = 0.5e-3
"""Backward travel over which the tip unloads: it leaves the front of a channel already cut."""


def tissue_force(state: TissueState, sample: NeedleSample, stack: TissueStack) -> TissueForce:
    """The force on the needle.

    Args:
        state: The tissue, already advanced to the sample.
        sample: Where the needle is.
        stack: What it is pushed into.
    """
    depth = sample.depth_m
    count = len(stack.layers)
    if count == 0 or depth <= 0.0:
        return no_force(count)
    layer = state.broken
    while layer > 0 and depth < stack.interfaces[layer - 1].depth_m:
        layer -= 1
    holding = stack.layers[max(min(state.broken, count) - 1, 0)]
    tip = (1.0 - state.relaxed * holding.relaxed_share) * _fresh_tip_N(state, depth, stack)
    shares = _layer_friction_N(state, sample, stack, min(layer, count))
    friction = sum(shares)
    return TissueForce(tip + friction, tip, friction, layer, shares)


def _fresh_tip_N(state: TissueState, depth: float, stack: TissueStack) -> float:
    """Tip force of unrelaxed tissue: what the front holds, and what a rupture still lets go."""
    boundaries, broken, deepest = stack.interfaces, state.broken, state.deepest_m
    back = (deepest - depth) / UNLOADING_M
    force = 0.0
    if back < 1.0 and broken > 0:
        last = boundaries[broken - 1]
        force = (1.0 - last.released(deepest)) * last.drop_N
        if broken < len(boundaries):
            front = min(deepest, boundaries[broken].depth_m)
            force += stack.layers[broken - 1].tip_force_N(front - last.onset_m)
        force *= (1.0 - back) ** 2
    if broken < len(boundaries):
        membrane = boundaries[broken].membrane
        if membrane is not None:
            force += membrane.force_N(depth - boundaries[broken].depth_m)
    return force


def _layer_friction_N(
    state: TissueState, sample: NeedleSample, stack: TissueStack, count: int
) -> tuple[float, ...]:
    """Friction of each layer on the length of shaft in it; only the first `count` hold any."""
    shares = [0.0] * len(stack.layers)
    for i in range(count):
        entry = stack.interfaces[i]
        friction = stack.layers[i].friction
        embedded = min(sample.depth_m, stack.interfaces[i + 1].depth_m) - entry.depth_m
        if entry.membrane is not None:
            # The pushed-in tissue springs back along the shaft while the membrane lets go.
            embedded *= entry.released(state.deepest_m)
        coulomb = friction.coulomb_N_per_m * state.bristles[i]
        shares[i] = embedded * (coulomb + friction.viscous_Ns_per_m2 * sample.speed_m_s)
    return tuple(shares)


class Tissue:
    """A stack of realistic layers that a needle goes through and comes back out of."""

    def __init__(self, layers: tuple[Layer, ...]) -> None:
        """Lay fresh, uncut tissue.

        Args:
            layers: First the one the needle meets first; none is free air.
        """
        self._stack = TissueStack(layers=tuple(layers), interfaces=interfaces(tuple(layers)))
        self._state = fresh_tissue(self._stack)

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The layers, first the one the needle meets first."""
        return self._stack.layers

    @property
    def interfaces(self) -> tuple[Interface, ...]:
        """The boundaries, from the surface to the exit."""
        return self._stack.interfaces

    @property
    def state(self) -> TissueState:
        """What the tissue remembers (immutable)."""
        return self._state

    def step(self, depth_m: float, speed_m_s: float, dt_s: float) -> TissueForce:
        """Advance by one step and return the force at its end.

        Args:
            depth_m: Travel of the tip since first contact, at the end of the step.
            speed_m_s: Speed of the tip, positive inwards.
            dt_s: Length of the step.

        Raises:
            TissueError: A value is not finite or `dt_s` is not positive; the state is unchanged.
        """
        sample = checked_sample(depth_m, speed_m_s, dt_s)
        self._state = tissue_step(self._state, sample, self._stack)
        return tissue_force(self._state, sample, self._stack)

    def reset(self) -> None:
        """Forget everything: a fresh, uncut tissue."""
        self._state = fresh_tissue(self._stack)
