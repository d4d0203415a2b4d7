"""Layers of tissue, their membranes, friction and boundaries: descriptions without
state.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import ndtri

from groundtruth.errors import (
    TissueError,
    require_fraction,
    require_non_negative,
    require_positive,
)

CUTTING_ONSET_M = (
    1e-3  # Until the cutting force is there: about one needle diameter (18G 1.27 mm)
)
KEPT_FADE_M = 5e-3
"""Travel over which the tip force kept after an internal rupture fades. Chosen: four
diameters. In a thinner layer the rest goes with its own rupture."""
SPEED_ROUNDING_M_S = (
    2e-5  # A power law of speed is linear below: no step follows an infinite slope
)
TEXTURE_WAVES = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Texture:
    """Unevenness of a layer at the tip: a sum of waves (rad/m, rad) that depends on
    the place.
    """

    std_N: float
    waves: tuple[tuple[float, float], ...]

    @classmethod
    def drawn(cls, std_N: float, length_m: float, rng: np.random.Generator) -> Self:
        """Draw a texture with correlation exp(-x² / 2 length²) over a distance x."""
        require_positive(TissueError, std_N=std_N, length_m=length_m)
        # One wave in each quantile of that correlation's spectrum, a normal
        # distribution.
        quantile = (
            np.arange(TEXTURE_WAVES) + rng.uniform(size=TEXTURE_WAVES)
        ) / TEXTURE_WAVES
        wave_number = ndtri(0.5 + 0.5 * quantile) / length_m
        phase = rng.uniform(0.0, 2.0 * np.pi, TEXTURE_WAVES)
        return cls(
            std_N=std_N,
            waves=tuple(zip(wave_number.tolist(), phase.tolist(), strict=True)),
        )

    def force_N(self, penetration_m: float) -> float:
        """Force at a depth into the layer, of either sign."""
        total = sum(
            math.cos(number * penetration_m + phase) for number, phase in self.waves
        )
        return self.std_N * math.sqrt(2.0 / len(self.waves)) * total


@dataclass(frozen=True, slots=True, kw_only=True)
class Membrane:
    """A membrane (liver capsule, latex glove) on top of a layer: a spring up to its
    puncture.

    Its force is `puncture_N ((1 - hardening) u + hardening u²)`, u = indentation /
    indentation_m: the second-order spring of Okamura, Simone, O'Leary 2004 for the
    capsule of bovine liver.

    Attributes:
        puncture_N: Force at which it ruptures.
        indentation_m: How far it has then been pushed in.
        hardening: Fraction of the quadratic part, 0 (linear) to 1.
    """

    puncture_N: float
    indentation_m: float
    hardening: float
    release_m: (
        float  # travel of the tip over which the force is released after the puncture
    )

    def __post_init__(self) -> None:
        require_positive(TissueError, self, "puncture_N indentation_m release_m")
        require_fraction(TissueError, self, "hardening")

    def force_N(self, indentation_m: float) -> float:
        """Force of the intact membrane, pushed in from its place at rest; zero if
        untouched.
        """
        if indentation_m <= 0.0:
            return 0.0
        u = indentation_m / self.indentation_m
        return self.puncture_N * u * (1.0 + self.hardening * (u - 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class ShaftFriction:
    """Friction of one tissue on a needle shaft, per unit of embedded length.

    In steady sliding the force per length is `coulomb sign(v) + viscous v`. Around a
    reversal the tissue first moves along with the shaft: the Coulomb part builds up
    over `presliding_m` (Dahl's model, see `groundtruth.tissue.bristle_step`).

    Attributes:
        presliding_m: Where the Coulomb part is 63 % of the way to its new value.
        reference_speed_m_s: At which the friction was measured or calibrated.
    """

    coulomb_N_per_m: float
    viscous_Ns_per_m2: float
    presliding_m: float
    reference_speed_m_s: float
    speed_exponent: float = (
        1.0  # the second part grows with v^n, alike at the reference speed
    )
    length_exponent: float = (
        1.0  # friction grows with length^n, alike on the whole layer
    )

    def __post_init__(self) -> None:
        positive = "presliding_m reference_speed_m_s speed_exponent length_exponent"
        require_positive(TissueError, self, positive)
        require_non_negative(TissueError, self, "coulomb_N_per_m viscous_Ns_per_m2")

    @classmethod
    def calibrated(
        cls,
        *,
        force_N_per_m: float,
        reference_speed_m_s: float,
        coulomb_fraction: float,
        presliding_m: float,
    ) -> "ShaftFriction":
        """Split the friction of steady sliding at one speed into Coulomb and viscous
        part.

        `TissueError` if the fraction is outside 0 to 1, or a value is not physical.
        """
        require_fraction(TissueError, coulomb_fraction=coulomb_fraction)
        require_positive(TissueError, reference_speed_m_s=reference_speed_m_s)
        return cls(
            coulomb_N_per_m=coulomb_fraction * force_N_per_m,
            viscous_Ns_per_m2=(1.0 - coulomb_fraction)
            * force_N_per_m
            / reference_speed_m_s,
            presliding_m=presliding_m,
            reference_speed_m_s=reference_speed_m_s,
        )

    def sliding_N_per_m(self, speed_m_s: float) -> float:
        """Friction per length in steady sliding; it has the sign of the speed, zero
        at rest.
        """
        if speed_m_s == 0.0:
            return 0.0
        return math.copysign(self.coulomb_N_per_m, speed_m_s) + self.rising_N_per_m(
            speed_m_s
        )

    def rising_N_per_m(self, speed_m_s: float) -> float:
        """The part of the friction per length that grows with speed, with the
        speed's sign.
        """
        viscous = self.viscous_Ns_per_m2 * speed_m_s
        if self.speed_exponent == 1.0:
            return viscous
        ratio = max(abs(speed_m_s), SPEED_ROUNDING_M_S) / self.reference_speed_m_s
        return viscous * ratio ** (self.speed_exponent - 1.0)

    def gripped_m(self, embedded_m: float, thickness_m: float) -> float:
        """Length with the same friction, were it proportional to length."""
        if self.length_exponent == 1.0 or embedded_m <= 0.0:
            return embedded_m
        return thickness_m * (embedded_m / thickness_m) ** self.length_exponent

    @property
    def equivalent_viscous_Ns_per_m2(self) -> float:
        """The B of equation (3) that gives the same friction at the reference speed."""
        return self.sliding_N_per_m(self.reference_speed_m_s) / self.reference_speed_m_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """What a needle meets between two ruptures.

    The tip force grows with the penetration up to `exit_force_N`, at which the far end
    ruptures. A fraction of it is a constant cutting force, the rest elastic: the chord
    of that at the end is steeper by `stiffening` than the slope at the start, 0.1 for
    10 %.

    Attributes:
        name: For tables and legends.
        thickness_m: d_i of the paper.
        release_m: Travel over which the tip force is released when the tip leaves the
            layer.
        relaxed_fraction: Of tip force and Coulomb friction, lost after a long rest.
        membrane: To be punctured to enter the layer.
    """

    name: str
    thickness_m: float
    exit_force_N: float
    cutting_fraction: float
    stiffening: float
    release_m: float
    relaxed_fraction: float
    friction: ShaftFriction
    membrane: Membrane | None = None
    tip_exponent: float = (
        1.0  # power of the elastic part: 0.5 concave, 2 quadratic; it ends alike
    )
    kept_fraction: float = (
        0.0  # of the tip force, when the needle leaves for a next layer
    )
    texture: Texture | None = (
        None  # of the tip force, faded over a cutting onset at both ends
    )

    def __post_init__(self) -> None:
        require_positive(
            TissueError, self, "thickness_m exit_force_N release_m tip_exponent"
        )
        require_non_negative(TissueError, self, "stiffening")
        require_fraction(
            TissueError, self, "kept_fraction cutting_fraction relaxed_fraction"
        )
        taken = self.entry_m + CUTTING_ONSET_M + self.release_m
        if self.membrane is not None:
            taken += self.membrane.release_m
        if self.thickness_m <= taken:
            raise TissueError(
                f"layer {self.name!r} is {self.thickness_m} m thick, but indentation, cutting "
                f"onset and release take {taken:.4g} m: make it thicker"
            )

    @property
    def entry_m(self) -> float:
        """Depth into the layer at which the tip begins to cut it: the membrane's
        indentation.
        """
        return 0.0 if self.membrane is None else self.membrane.indentation_m

    def tip_force_N(self, penetration_m: float) -> float:
        """Elastic and cutting force, not relaxed, after this travel since the tip
        began to cut.
        """
        if penetration_m <= 0.0:
            return 0.0
        cut_m = self.thickness_m - self.entry_m
        p = penetration_m / cut_m
        elastic = (
            p * (1.0 + self.stiffening * p) / (1.0 + self.stiffening)
        ) ** self.tip_exponent
        onset = min(penetration_m / CUTTING_ONSET_M, 1.0)
        cutting = onset * (2.0 - onset)
        c = self.cutting_fraction
        force = self.exit_force_N * ((1.0 - c) * elastic + c * cutting)
        if self.texture is None:
            return force
        inside = min(onset, max(cut_m - penetration_m, 0.0) / CUTTING_ONSET_M)
        # Tissue does not pull at the tip.
        return max(force + inside * self.texture.force_N(penetration_m), 0.0)


@dataclass(frozen=True, slots=True)
class Interface:
    """The boundary above a layer, or behind the last one.

    A membrane at a boundary backs up the tissue above it: the tip force of the layer
    above is held while the membrane is pushed in, and both are released together at the
    puncture. So each boundary gives one rupture.

    Attributes:
        depth_m: In undeformed tissue.
        onset_m: Depth of the tip at which it begins to rupture.
        release_m: Travel over which the force is then released.
        drop_N: Force released, tissue not relaxed; zero at a bare surface.
        membrane: To be punctured there.
    """

    depth_m: float
    onset_m: float
    release_m: float
    drop_N: float
    membrane: Membrane | None
    kept_fraction: float = (
        0.0  # of `drop_N`, not released but fading: layers hang together
    )

    def held(self, deepest_m: float) -> float:
        """Fraction of the force held, 1 to 0, once the tip has been as deep as
        `deepest_m`.
        """
        held = 1.0 - self.released(deepest_m)
        kept = max(1.0 - max(deepest_m - self.onset_m, 0.0) / KEPT_FADE_M, 0.0)
        return (1.0 - self.kept_fraction) * held + self.kept_fraction * kept * kept

    def released(self, deepest_m: float) -> float:
        """Fraction of the force released, 0 to 1, once the tip has been as deep as
        `deepest_m`.

        A crack starts fast and dies out: 1 - (1 - s)², s the travelled fraction of
        `release_m`.
        """
        rest = 1.0 - min(max(deepest_m - self.onset_m, 0.0) / self.release_m, 1.0)
        return 1.0 - rest * rest


def interfaces(layers: tuple[Layer, ...]) -> tuple[Interface, ...]:
    """All boundaries of a stack, from the surface to the exit: one more than layers,
    or none.
    """
    found: list[Interface] = []
    depth = 0.0
    for i, below in enumerate((*layers, None) if layers else ()):
        membrane = None if below is None else below.membrane
        onset = depth
        drop = layers[i - 1].exit_force_N if i else 0.0
        release = layers[max(i - 1, 0)].release_m
        if membrane is not None:
            onset = depth + membrane.indentation_m
            drop = drop + membrane.puncture_N
            release = membrane.release_m
        kept = 0.0
        if i and below is not None:
            kept = layers[i - 1].kept_fraction * layers[i - 1].exit_force_N / drop
        found.append(Interface(depth, onset, release, drop, membrane, kept))
        depth += 0.0 if below is None else below.thickness_m
    return tuple(found)
