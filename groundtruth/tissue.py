"""The realistic tissue: ruptures of finite travel, membranes, cutting, presliding, relaxation.

It is deliberately not the law the estimators identify (equation 3). What it shares with it is the
geometry and, at each layer's reference speed, the shaft friction.
"""

from dataclasses import dataclass
from typing import NamedTuple

from groundtruth.interface import Interface, interfaces
from groundtruth.layer import Layer
from groundtruth.relaxation import bristle_step, relaxation_step
from groundtruth.sample import NeedleSample, checked_sample
from groundtruth.tissue_force import TissueForce, no_force

UNLOADING_M = 0.5e-3
"""Backward travel over which the tip unloads: it leaves the front of a channel already cut."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueStack:
    """Layers and the boundaries between them, worked out once.

    Attributes:
        layers: First the one the needle meets first.
        interfaces: From the surface to the exit, one more than layers; empty without layers.
    """

    layers: tuple[Layer, ...]
    interfaces: tuple[Interface, ...]


class TissueState(NamedTuple):
    """What the tissue remembers.

    Attributes:
        depth_m: Depth of the tip at the last step; None before the first.
        deepest_m: Deepest point reached: the end of the channel.
        broken: Interfaces given way so far, the surface included.
        relaxed: Relaxation of the tip force, 0 (fresh) to 1 (a long rest).
        bristles: Presliding deflection per layer, -1 to 1.
        force: The force at the last step.
    """

    depth_m: float | None
    deepest_m: float
    broken: int
    relaxed: float
    bristles: tuple[float, ...]
    force: TissueForce


def tissue_step(state: TissueState, sample: NeedleSample, stack: TissueStack) -> TissueState:
    """Advance the tissue by one sample; the new state carries the force.

    Args:
        state: The tissue before.
        sample: Where the needle is now.
        stack: What it is pushed into.
    """
    depth, speed, dt = sample
    travel = 0.0 if state.depth_m is None else depth - state.depth_m
    deepest = max(state.deepest_m, depth)
    broken = state.broken
    boundaries = stack.interfaces
    while broken < len(boundaries) and deepest >= boundaries[broken].onset_m:
        broken += 1
    relaxed = relaxation_step(state.relaxed, speed, dt)
    bristles = tuple(
        [
            bristle_step(w, travel, dt, layer.friction.presliding_m, layer.relaxed_share)
            for w, layer in zip(state.bristles, stack.layers, strict=True)
        ]
    )
    index = broken
    while index > 0 and depth < boundaries[index - 1].depth_m:
        index -= 1
    if index == 0 and depth <= 0.0:
        force = no_force(len(bristles))
    else:
        tip = _tip_force_N(depth, deepest, broken, stack)
        tip *= 1.0 - relaxed * stack.layers[max(min(broken, len(bristles)) - 1, 0)].relaxed_share
        shares = _friction_shares_N(depth, speed, deepest, index, bristles, stack)
        friction = sum(shares)
        force = TissueForce(tip + friction, tip, friction, index, shares)
    return TissueState(depth, deepest, broken, relaxed, bristles, force)


def _tip_force_N(depth: float, deepest: float, broken: int, stack: TissueStack) -> float:
    """Tip force of unrelaxed tissue: what the front holds, and what a rupture still lets go."""
    boundaries = stack.interfaces
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


def _friction_shares_N(
    depth: float,
    speed: float,
    deepest: float,
    index: int,
    bristles: tuple[float, ...],
    stack: TissueStack,
) -> tuple[float, ...]:
    """Friction of each layer on the length of shaft now inside it."""
    shares = [0.0] * len(bristles)
    for i in range(min(index, len(bristles))):
        entry = stack.interfaces[i]
        friction = stack.layers[i].friction
        embedded = min(depth, stack.interfaces[i + 1].depth_m) - entry.depth_m
        if entry.membrane is not None:
            # The pushed-in tissue springs back along the shaft while the membrane lets go.
            embedded *= entry.released(deepest)
        shares[i] = embedded * (
            friction.coulomb_N_per_m * bristles[i] + friction.viscous_Ns_per_m2 * speed
        )
    return tuple(shares)


class Tissue:
    """A stack of realistic layers that a needle goes through and comes back out of."""

    def __init__(self, layers: tuple[Layer, ...]) -> None:
        """Lay fresh, uncut tissue.

        Args:
            layers: First the one the needle meets first; none is free air.
        """
        self._stack = TissueStack(layers=tuple(layers), interfaces=interfaces(tuple(layers)))
        self.reset()

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
        self._state = tissue_step(
            self._state, checked_sample(depth_m, speed_m_s, dt_s), self._stack
        )
        return self._state.force

    def reset(self) -> None:
        """Forget everything: a fresh, uncut tissue."""
        count = len(self._stack.layers)
        self._state = TissueState(None, 0.0, 0, 0.0, (0.0,) * count, no_force(count))
