"""The realistic tissue: ruptures of finite travel, membranes, cutting, presliding, relaxation.

It is deliberately not the law the estimators identify (equation 3). What it shares with it is the
geometry and, at each layer's reference speed, the shaft friction.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from groundtruth.errors import TissueError
from groundtruth.layers import Interface, Layer, interfaces

# Relaxation: a resting needle is slowly let go, an advancing tip meets fresh tissue.


RELAXATION_S = 10.0
"""Time constant. Real liver (de Jong 2017, 19 holds of 60 s) loses 63 % of what it will lose in
8.5 s (median), the quick loss of viscous friction at the stop included."""
RECOVERY_M = 0.3e-3
"""Travel over which an advancing tip meets fresh tissue: a fraction of its diameter."""


def relaxation_step(relaxed: float, speed_m_s: float, dt_s: float) -> float:
    """Advance the relaxation of the tip force: it grows with time and fades with travel.

    Exact step of dr/dt = (1 - r) / RELAXATION_S - r |v| / RECOVERY_M for a held speed, so any
    step is stable. In motion it stays near zero (1.3 % at 2.3 mm/s).

    Args:
        relaxed: Relaxation before, 0 (fresh) to 1 (a long rest).
        speed_m_s: Speed of the tip.
        dt_s: Length of the step.

    Returns:
        The relaxation after the step, 0 to 1.
    """
    rate = 1.0 / RELAXATION_S + abs(speed_m_s) / RECOVERY_M
    settled = 1.0 / (RELAXATION_S * rate)
    return relaxed - (settled - relaxed) * math.expm1(-rate * dt_s)


def bristle_step(
    bristle: float, travel_m: float, dt_s: float, presliding_m: float, relaxed_share: float
) -> float:
    """Advance the deflection of the shaft's bristles: Dahl's presliding, with relaxation.

    Travel pulls the deflection to the direction of motion, dw/dx = (sign(dx) - w) / presliding
    (Dahl 1968, exponent 1); time lets a deflection beyond 1 - relaxed_share sink to that. Both
    act at once and the step is their exact solution: it cannot leave [-1, 1], whatever its size.

    Args:
        bristle: Deflection before, -1 to 1; the Coulomb force is `coulomb * bristle`.
        travel_m: Signed travel of the shaft during the step.
        dt_s: Length of the step.
        presliding_m: Travel constant of the tissue.
        relaxed_share: Share of the Coulomb force lost after a long rest.

    Returns:
        The deflection after the step.
    """
    pull = abs(travel_m) / presliding_m
    target = math.copysign(pull, travel_m)
    held = 1.0 - relaxed_share
    if abs(bristle) > held:
        fade = dt_s / RELAXATION_S
        pull += fade
        target += fade * math.copysign(held, bristle)
    if pull == 0.0:
        return bristle
    return bristle - (target / pull - bristle) * math.expm1(-pull)


# What a tissue law is told at each step.


class NeedleSample(NamedTuple):
    """Where the needle is and how fast it goes.

    Attributes:
        depth_m: Travel of the tip along the insertion axis since first contact; negative above.
        speed_m_s: Its rate, positive inwards.
        dt_s: Time since the previous sample.
    """

    depth_m: float
    speed_m_s: float
    dt_s: float


def checked_sample(depth_m: float, speed_m_s: float, dt_s: float) -> NeedleSample:
    """Make a sample, refusing what a law could only turn into nonsense.

    Raises:
        TissueError: A value is not finite, or the time step is not positive.
    """
    if math.isfinite(depth_m + speed_m_s + dt_s) and dt_s > 0.0:
        return NeedleSample(depth_m, speed_m_s, dt_s)
    raise TissueError(
        f"depth_m={depth_m!r}, speed_m_s={speed_m_s!r}, dt_s={dt_s!r}: "
        "a tissue law needs finite numbers and dt_s above zero; its state is unchanged"
    )


# What realistic tissue remembers of the needle, and how one sample changes it.


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
    """The memory of the tissue.

    Attributes:
        depth_m: Depth of the tip at the last step; None before the first.
        deepest_m: Deepest point reached: the end of the channel.
        broken: Interfaces given way so far, the surface included.
        relaxed: Relaxation of the tip force, 0 (fresh) to 1 (a long rest).
        bristles: Presliding deflection per layer, -1 to 1.
    """

    depth_m: float | None
    deepest_m: float
    broken: int
    relaxed: float
    bristles: tuple[float, ...]


def fresh_tissue(stack: TissueStack) -> TissueState:
    """The memory of tissue no needle has touched."""
    return TissueState(None, 0.0, 0, 0.0, (0.0,) * len(stack.layers))


def tissue_step(state: TissueState, sample: NeedleSample, stack: TissueStack) -> TissueState:
    """Advance the tissue by one sample.

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
    bristles = tuple(
        [
            bristle_step(w, travel, dt, layer.friction.presliding_m, layer.relaxed_share)
            for w, layer in zip(state.bristles, stack.layers, strict=True)
        ]
    )
    return TissueState(depth, deepest, broken, relaxation_step(state.relaxed, speed, dt), bristles)


# What a tissue law answers at each step, and what every law offers.


class TissueForce(NamedTuple):
    """Force of the tissue on the needle, along its axis.

    A named tuple, not a dataclass: it is made at every physics step.

    Attributes:
        axial_N: Tip force and shaft friction together, positive when tissue pushes back.
        tip_N: Elastic, membrane and cutting force at the tip; never negative.
        friction_N: Friction along the whole shaft; it opposes motion, negative on the way out.
        layer: 0 above the surface (or before its membrane is punctured), i with the tip in layer
            i, number of layers + 1 beyond the last.
        layer_friction_N: The share of each layer in `friction_N`.
    """

    axial_N: float
    tip_N: float
    friction_N: float
    layer: int
    layer_friction_N: tuple[float, ...]


class TissueLaw(Protocol):
    """A law of tissue: depth and speed of the tip in, force out."""

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The layers, first the one the needle meets first."""
        ...

    @property
    def interfaces(self) -> tuple[Interface, ...]:
        """The boundaries, from the surface to the exit, as this law has them give way."""
        ...

    def step(self, depth_m: float, speed_m_s: float, dt_s: float) -> TissueForce:
        """Advance by one step and return the force at its end."""
        ...

    def reset(self) -> None:
        """Forget everything: a fresh, uncut tissue."""
        ...


def no_force(layer_count: int) -> TissueForce:
    """The force on a needle in free air."""
    return TissueForce(0.0, 0.0, 0.0, 0, (0.0,) * layer_count)


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
