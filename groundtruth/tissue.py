"""The material law of simulated tissue, and the ground truth of a whole run.

The law takes depth and speed of the tip and returns the force.

It has ruptures of finite travel, membranes, cutting, presliding and relaxation. It is
not the law that the published method identifies (equation 3): it shares the geometry
with it and, at each layer's reference speed, the shaft friction. Our mixture
estimator does share its form (cutting onset, release, presliding), so
`groundtruth.variations` departs from it.
"""

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from groundtruth.errors import TissueError
from groundtruth.layers import Layer, interfaces

RELAXATION_S = 10.0
"""Time constant. Real liver (de Jong 2017, 19 holds of 60 s) loses 63 % of what it will
lose in 8.5 s (median), the quick loss of viscous friction at the stop included."""
UNLOADING_M = 0.5e-3
"""Backward travel over which the tip unloads: it leaves the channel's front."""


class TissueForce(NamedTuple):
    """Force of the tissue on the needle, along its axis.

    A named tuple, not a dataclass: it is made at every physics step. `layer` is 0 above
    the surface (or before its membrane is punctured), i with the tip in layer i, one
    more beyond the last.

    Attributes:
        axial_N: Tip force and shaft friction together, positive when tissue pushes
            back.
        tip_N: Elastic, membrane and cutting force at the tip; never negative.
        friction_N: Friction along the whole shaft; it opposes motion, negative in
            withdrawal.
        layer: 0 above the surface (or before its membrane is punctured), i with the tip
            in layer i, one more beyond the last.
        layer_friction_N: Part of each layer in `friction_N`.
    """

    axial_N: float
    tip_N: float
    friction_N: float
    layer: int
    layer_friction_N: tuple[float, ...]


def no_force(layer_count: int) -> TissueForce:
    """Return the force on a needle in free air."""
    return TissueForce(0.0, 0.0, 0.0, 0, (0.0,) * layer_count)


def relaxation_step(relaxed: float, speed_m_s: float, dt_s: float) -> float:
    """Return the relaxation of the tip force after a time step.

    It grows with time and fades with travel.

    Tissue slowly relaxes around a resting needle; an advancing tip meets fresh tissue.
    Exact step of dr/dt = (1 - r) / RELAXATION_S - r |v| / recovery_m for a held speed,
    so any step is stable. From 0 (fresh) to 1 (a long rest); in motion near zero (1.3 %
    at 2.3 mm/s).
    """
    # Travel after which the tip meets fresh tissue: a fraction of its diameter.
    recovery_m = 0.3e-3
    rate = 1.0 / RELAXATION_S + abs(speed_m_s) / recovery_m
    settled = 1.0 / (RELAXATION_S * rate)
    return relaxed - (settled - relaxed) * math.expm1(-rate * dt_s)


def bristle_step(
    bristle: float,
    travel_m: float,
    dt_s: float,
    presliding_m: float,
    relaxed_fraction: float,
) -> float:
    """Return the deflection of the shaft's bristles after a time step.

    This is Dahl's presliding, with relaxation.

    Travel pulls the deflection to the direction of motion, dw/dx = (sign(dx) - w) /
    presliding (Dahl 1968, exponent 1); time lets a deflection beyond 1 -
    relaxed_fraction sink to that. Both act at once and the step is their exact
    solution: it cannot leave [-1, 1], whatever its size. The Coulomb force is `coulomb
    * bristle`; a long rest loses the relaxed fraction of it.
    """
    pull = abs(travel_m) / presliding_m
    target = math.copysign(pull, travel_m)
    held = 1.0 - relaxed_fraction
    if abs(bristle) > held:
        fade = dt_s / RELAXATION_S
        pull += fade
        target += fade * math.copysign(held, bristle)
    if pull == 0.0:
        return bristle
    return bristle - (target / pull - bristle) * math.expm1(-pull)


class Tissue:
    """A stack of realistic layers that a needle is pushed through and withdrawn from.

    Attributes:
        layers: First the one the needle meets first.
        interfaces: The boundaries, from the surface to the exit; none without layers.
    """

    def __init__(self, layers: tuple[Layer, ...]) -> None:
        """Begin with fresh, uncut tissue; no layers are free air."""
        self.layers = tuple(layers)
        self.interfaces = interfaces(self.layers)
        self._onsets_m = [boundary.onset_m for boundary in self.interfaces]  # ascending
        self._depth_m: float | None = None  # at the last step
        self._deepest_m = 0.0  # the end of the channel
        self._ruptured = 0  # interfaces ruptured so far, a bare surface included
        self._relaxed = 0.0  # relaxation of the tip force, 0 (fresh) to 1 (a long rest)
        # Presliding deflection of each layer, -1 to 1.
        self._bristles = [0.0] * len(self.layers)

    @property
    def is_air(self) -> bool:
        """Whether there is nothing to meet."""
        return not self.layers

    def step(self, depth_m: float, speed_m_s: float, dt_s: float) -> TissueForce:
        """Advance by one step and return the force at its end.

        Args:
            depth_m: Travel of the tip since first contact, at the end of the step;
                negative above.
            speed_m_s: Speed of the tip, positive inwards.
            dt_s: Length of the step.

        Raises:
            TissueError: A value is not finite or `dt_s` is not positive; the state is
                unchanged.
        """
        if not (math.isfinite(depth_m + speed_m_s + dt_s) and dt_s > 0.0):
            raise TissueError(
                f"depth_m={depth_m!r}, speed_m_s={speed_m_s!r}, dt_s={dt_s!r}: a "
                "tissue needs finite numbers and dt_s above zero; its state is "
                "unchanged"
            )
        # The first step says where the needle is, not how far it came: no presliding
        # yet.
        travel = 0.0 if self._depth_m is None else depth_m - self._depth_m
        self._depth_m = depth_m
        self._deepest_m = max(self._deepest_m, depth_m)
        self._ruptured = bisect_right(self._onsets_m, self._deepest_m)
        self._bristles = [
            bristle_step(
                bristle,
                travel,
                dt_s,
                layer.friction.presliding_m,
                layer.relaxed_fraction,
            )
            for bristle, layer in zip(self._bristles, self.layers, strict=True)
        ]
        self._relaxed = relaxation_step(self._relaxed, speed_m_s, dt_s)
        return self._force(depth_m, speed_m_s)

    def _force(self, depth_m: float, speed_m_s: float) -> TissueForce:
        """Return the force of the present state."""
        count = len(self.layers)
        if count == 0 or depth_m <= 0.0:
            return no_force(count)
        # Behind its deepest point the tip is in a layer above the last one it ruptured.
        layer = self._ruptured
        while layer > 0 and depth_m < self.interfaces[layer - 1].depth_m:
            layer -= 1
        holding = self.layers[max(min(self._ruptured, count) - 1, 0)]
        unrelaxed = 1.0 - self._relaxed * holding.relaxed_fraction
        tip = unrelaxed * self._fresh_tip_N(depth_m)
        per_layer = self._layer_friction_N(depth_m, speed_m_s, min(layer, count))
        friction = sum(per_layer)
        return TissueForce(tip + friction, tip, friction, layer, per_layer)

    def _fresh_tip_N(self, depth_m: float) -> float:
        """Return the tip force of unrelaxed tissue.

        It is what the front holds, and what a rupture has not released yet.
        """
        boundaries = self.interfaces
        ruptured = self._ruptured
        deepest = self._deepest_m
        back = (deepest - depth_m) / UNLOADING_M
        force = 0.0
        if back < 1.0 and ruptured > 0:
            behind = boundaries[ruptured - 1]
            force = behind.held(deepest) * behind.drop_N
            if ruptured < len(boundaries):
                penetration_m = (
                    min(deepest, boundaries[ruptured].depth_m) - behind.onset_m
                )
                layer = self.layers[ruptured - 1]
                force += layer.tip_force_N(penetration_m)
                # A bare surface does not rupture.
                if layer.slips is not None and behind.drop_N > 0.0:
                    force += layer.slips.force_N(penetration_m)
            force *= (1.0 - back) ** 2
        if ruptured < len(boundaries):
            membrane = boundaries[ruptured].membrane
            if membrane is not None:
                force += membrane.force_N(depth_m - boundaries[ruptured].depth_m)
        return force

    def _layer_friction_N(
        self, depth_m: float, speed_m_s: float, count: int
    ) -> tuple[float, ...]:
        """Return the friction of each layer on the length of shaft in it.

        Args:
            depth_m: Depth of the tip.
            speed_m_s: Its speed.
            count: Number of layers that hold any.
        """
        per_layer = [0.0] * len(self.layers)
        for i in range(count):
            entry = self.interfaces[i]
            friction = self.layers[i].friction
            embedded = min(depth_m, self.interfaces[i + 1].depth_m) - entry.depth_m
            if entry.membrane is not None:
                # The pushed-in tissue springs back along the shaft while the membrane
                # ruptures.
                embedded *= entry.released(self._deepest_m)
            embedded = friction.gripped_m(embedded, self.layers[i].thickness_m)
            coulomb = friction.coulomb_N_per_m * self._bristles[i]
            per_layer[i] = embedded * (coulomb + friction.rising_N_per_m(speed_m_s))
        return tuple(per_layer)


class ReadOnlyArrays:
    """A frozen dataclass whose arrays are read-only."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for item in fields(cast(Any, self)):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rupture:
    """A boundary that ruptures under the advancing tip.

    The visible drop is the fall of the axial force from the onset to its least value
    before the end: smaller than `drop_N` where the next layer or its friction already
    pushes, a little larger where the needle slows down meanwhile.

    Attributes:
        onset_s: Time at which the release begins; between samples, by interpolation.
        end_s: Time at which it ends; the end of the run if the needle stopped within
            it.
        onset_m: Depth of the tip at the onset.
        layer: Layer that the tip leaves; 0 for a membrane on the surface.
        drop_N: Force the tip loses: elastic, membrane and cutting force held at the
            onset.
        visible_drop_N: Fall of the axial force from the onset to its least value before
            the end: smaller than `drop_N` where the next layer or its friction already
            pushes, a little larger where the needle slows down meanwhile.
        layer_friction_N: Friction of the layer that the tip leaves, at the onset.
        friction_N: Friction of the whole shaft when the release has ended.
    """

    onset_s: float
    end_s: float
    onset_m: float
    layer: int
    drop_N: float
    visible_drop_N: float
    layer_friction_N: float
    friction_N: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TissueTruth(ReadOnlyArrays):
    """The ground truth of the tissue at n samples, see `TissueForce`.

    Attributes:
        axial_N: Axial force, shape (n,), positive when tissue pushes back.
        tip_N: Tip force, shape (n,).
        friction_N: Shaft friction, shape (n,), negative in withdrawal.
        layer_friction_N: Friction of each layer, shape (n, number of layers).
        layer: Layer of the tip, shape (n,).
        ruptures: Ruptures in the order in which they happened.
        contact_s: Time at which the tip first touches the undeformed surface; nan if it
            never does.
        withdrawn_s: Time at which it leaves that surface in withdrawal; nan if it does
            not.
    """

    axial_N: Array
    tip_N: Array
    friction_N: Array
    layer_friction_N: Array
    layer: NDArray[np.int64]
    ruptures: tuple[Rupture, ...]
    contact_s: float
    withdrawn_s: float

    @property
    def rupture_s(self) -> Array:
        """Onset of each rupture, shape (number of ruptures,)."""
        return np.array(
            [rupture.onset_s for rupture in self.ruptures], dtype=np.float64
        )


def collect_truth(
    law: Tissue, t_s: Array, depth_m: Array, forces: Sequence[TissueForce]
) -> TissueTruth:
    """Return the ground truth of a run.

    Args:
        law: The tissue.
        t_s: Times of the n samples.
        depth_m: True depths.
        forces: The n forces that the law returned.
    """
    columns = np.array([force[:3] for force in forces], dtype=np.float64)
    per_layer = np.array([force.layer_friction_N for force in forces], dtype=np.float64)
    contact_s = np.nan if law.is_air else _first_crossing_s(t_s, depth_m, 0.0)
    deepest = int(np.argmax(depth_m))
    withdrawn_s = _first_crossing_s(t_s[deepest:], -depth_m[deepest:], 0.0)
    return TissueTruth(
        axial_N=columns[:, 0],
        tip_N=columns[:, 1],
        friction_N=columns[:, 2],
        layer_friction_N=per_layer,
        layer=np.array([force.layer for force in forces], dtype=np.int64),
        ruptures=tuple(_ruptures(law, t_s, depth_m, columns[:, 1], per_layer)),
        contact_s=contact_s,
        withdrawn_s=np.nan if np.isnan(contact_s) else withdrawn_s,
    )


def _first_crossing_s(t_s: Array, signal: Array, level: float) -> float:
    """Return the time at which a signal first reaches a level from below.

    It is interpolated linearly; nan if there is none.
    """
    reached = np.flatnonzero(signal >= level)
    if reached.size == 0:
        return float("nan")
    around = slice(max(reached[0] - 1, 0), reached[0] + 1)
    return float(np.interp(level, signal[around], t_s[around]))


def _ruptures(
    law: Tissue, t_s: Array, depth_m: Array, tip_N: Array, layer_friction_N: Array
) -> Iterator[Rupture]:
    """Yield the ruptures in the order in which they happen.

    They are timed from the depth that the needle went through.
    """
    friction_N = layer_friction_N.sum(axis=1)
    axial_N = tip_N + friction_N
    for above, boundary in enumerate(law.interfaces):
        onset_s = _first_crossing_s(t_s, depth_m, boundary.onset_m)
        # A bare surface holds no force and is no rupture.
        if boundary.drop_N == 0.0 or np.isnan(onset_s):
            continue
        end_s = _first_crossing_s(t_s, depth_m, boundary.onset_m + boundary.release_m)
        end_s = float(t_s[-1]) if np.isnan(end_s) else end_s
        # The samples before the onset and after the end.
        first = max(int(np.searchsorted(t_s, onset_s)) - 1, 0)
        final = min(int(np.searchsorted(t_s, end_s)), t_s.size - 1)
        yield Rupture(
            onset_s=onset_s,
            end_s=end_s,
            onset_m=boundary.onset_m,
            layer=above,
            drop_N=float(tip_N[first]),
            visible_drop_N=float(axial_N[first] - axial_N[first : final + 1].min()),
            layer_friction_N=float(layer_friction_N[first, above - 1])
            if above
            else 0.0,
            friction_N=float(friction_N[final]),
        )
