"""Layers of tissue, their membranes, friction and boundaries, without state."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import ndtri

from groundtruth.errors import TissueError, require_positive

CUTTING_ONSET_M = 1e-3
"""Travel until the cutting force is there: about one needle diameter (18G 1.27 mm)."""
KEPT_FADE_M = 5e-3
"""Travel over which the tip force kept after an internal rupture fades. Chosen: four
diameters. In a thinner layer the rest goes with its own rupture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Texture:
    """Unevenness of a layer at the tip: a sum of waves along the layer.

        F(x) = std sqrt(2 / n) sum_i cos(k_i x + phase_i)

    Attributes:
        std_N: Standard deviation of the force over a long layer.
        waves: Wave number [rad/m] and phase [rad] of each wave.
    """

    std_N: float
    waves: tuple[tuple[float, float], ...]

    @classmethod
    def drawn(cls, std_N: float, length_m: float, rng: np.random.Generator) -> Self:
        """Draw a texture with correlation exp(-x² / 2 length²) over a distance x."""
        # Number of waves of a texture.
        texture_waves = 16
        # One wave in each quantile of that correlation's spectrum, a normal
        # distribution.
        quantile = (
            np.arange(texture_waves) + rng.uniform(size=texture_waves)
        ) / texture_waves
        wave_number = ndtri(0.5 + 0.5 * quantile) / length_m
        phase = rng.uniform(0.0, 2.0 * np.pi, texture_waves)
        return cls(
            std_N=std_N,
            waves=tuple(zip(wave_number.tolist(), phase.tolist(), strict=True)),
        )

    def force_N(self, penetration_m: float) -> float:
        """Return the force at a depth into the layer, of either sign."""
        total = sum(
            math.cos(number * penetration_m + phase) for number, phase in self.waves
        )
        return self.std_N * math.sqrt(2.0 / len(self.waves)) * total


@dataclass(frozen=True, slots=True)
class StickSlip:
    """Stick and slip of the cut at the tip: a saw of force along the layer.

    The edge sticks while the tissue in front of it is stretched: the force rises in
    proportion to the travel. Then the cut slips on, and that force is gone.

    Attributes:
        places_m: Depths into the layer at which the slope changes, ascending.
        forces_N: Force there beyond that of a layer which is cut evenly.
    """

    places_m: tuple[float, ...]
    forces_N: tuple[float, ...]

    @classmethod
    def drawn(cls, largest_N: float, length_m: float, rng: np.random.Generator) -> Self:
        """Draw the slips on a length.

        Every 0.3 to 2 mm of travel, by a third of the largest to the largest; the last
        one ends before the length does. A slip itself takes 0.02 mm: chosen, a sixtieth
        of a needle's diameter.
        """
        slip_m = 0.02e-3
        count = math.ceil(length_m / 0.3e-3)
        ends_m = np.cumsum(rng.uniform(0.3e-3, 2e-3, count))
        drops_N = rng.uniform(largest_N / 3.0, largest_N, count)
        places_m = [0.0]
        forces_N = [0.0]
        for end_m, drop_N in zip(ends_m[ends_m < length_m], drops_N, strict=False):
            places_m += [end_m - slip_m, end_m]
            forces_N += [drop_N, 0.0]
        return cls(tuple(places_m), tuple(forces_N))

    def force_N(self, penetration_m: float) -> float:
        """Return the force at a depth into the layer, zero behind the last slip."""
        return float(np.interp(penetration_m, self.places_m, self.forces_N))


@dataclass(frozen=True, slots=True, kw_only=True)
class Membrane:
    """A membrane on top of a layer: a spring up to its puncture.

    Such are a liver capsule and a latex glove.

    Its force is `puncture_N ((1 - hardening) u + hardening u²)`, u = indentation /
    indentation_m: the second-order spring of Okamura, Simone, O'Leary 2004 for the
    capsule of bovine liver.

    Attributes:
        puncture_N: Force at which it ruptures.
        indentation_m: Indentation at the puncture.
        hardening: Fraction of the quadratic part, 0 (linear) to 1.
        release_m: Travel of the tip over which the force is released after the
            puncture.
    """

    puncture_N: float
    indentation_m: float
    hardening: float
    release_m: float

    def force_N(self, indentation_m: float) -> float:
        """Return the force of the intact membrane; zero where it is untouched.

        Args:
            indentation_m: Travel of the tip from the membrane's place at rest.
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
        coulomb_N_per_m: Part that does not depend on speed.
        viscous_Ns_per_m2: Part per speed, at the reference speed.
        presliding_m: Travel after a reversal at which the Coulomb part is 63 % of the
            way to its new value.
        reference_speed_m_s: Speed at which the friction was measured or calibrated.
        speed_exponent: Power n of the speed in the viscous part, which grows with v^n
            and is the same at the reference speed.
        length_exponent: Power n of the length: friction grows with length^n and is the
            same on the whole layer.
    """

    coulomb_N_per_m: float
    viscous_Ns_per_m2: float
    presliding_m: float
    reference_speed_m_s: float
    speed_exponent: float = 1.0
    length_exponent: float = 1.0

    @classmethod
    def calibrated(
        cls,
        *,
        force_N_per_m: float,
        reference_speed_m_s: float,
        coulomb_fraction: float,
        presliding_m: float,
    ) -> "ShaftFriction":
        """Split the friction of steady sliding into a Coulomb and a viscous part.

        Args:
            force_N_per_m: Friction per embedded length at the reference speed.
            reference_speed_m_s: Speed at which it was measured.
            coulomb_fraction: Fraction of it that does not depend on speed, 0 to 1.
            presliding_m: See `ShaftFriction`.
        """
        return cls(
            coulomb_N_per_m=coulomb_fraction * force_N_per_m,
            viscous_Ns_per_m2=(1.0 - coulomb_fraction)
            * force_N_per_m
            / reference_speed_m_s,
            presliding_m=presliding_m,
            reference_speed_m_s=reference_speed_m_s,
        )

    def sliding_N_per_m(self, speed_m_s: float) -> float:
        """Return the friction per length in steady sliding.

        It has the sign of the speed, and is zero at rest.
        """
        if speed_m_s == 0.0:
            return 0.0
        return math.copysign(self.coulomb_N_per_m, speed_m_s) + self.rising_N_per_m(
            speed_m_s
        )

    def rising_N_per_m(self, speed_m_s: float) -> float:
        """Return the part of the friction per length that grows with speed.

        It has the sign of the speed.
        """
        # Speed below which a power law of speed is linear: no step follows an infinite
        # slope.
        speed_rounding_m_s = 2e-5
        viscous = self.viscous_Ns_per_m2 * speed_m_s
        if self.speed_exponent == 1.0:
            return viscous
        ratio = max(abs(speed_m_s), speed_rounding_m_s) / self.reference_speed_m_s
        return viscous * ratio ** (self.speed_exponent - 1.0)

    def gripped_m(self, embedded_m: float, thickness_m: float) -> float:
        """Return the length with the same friction, were it proportional to length."""
        if self.length_exponent == 1.0 or embedded_m <= 0.0:
            return embedded_m
        return thickness_m * (embedded_m / thickness_m) ** self.length_exponent

    @property
    def equivalent_viscous_Ns_per_m2(self) -> float:
        """The B of equation (3) that gives the same friction at the reference speed."""
        return self.sliding_N_per_m(self.reference_speed_m_s) / self.reference_speed_m_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """Tissue that a needle meets between two ruptures.

    The tip force grows with the penetration up to `exit_force_N`, at which the far end
    ruptures. A fraction of it is a constant cutting force, the rest elastic: the chord
    of that at the end is steeper by `stiffening` than the slope at the start, 0.1 for
    10 %.

    Attributes:
        name: For tables and legends.
        thickness_m: d_i of the paper.
        exit_force_N: Tip force at which the far end ruptures.
        cutting_fraction: Fraction of that force which is constant cutting force.
        stiffening: How much steeper the chord of the elastic force is than its slope at
            the start, 0.1 for 10 %.
        release_m: Travel over which the tip force is released when the tip leaves the
            layer.
        relaxed_fraction: Fraction of tip force and Coulomb friction that a long rest
            loses.
        friction: Friction on the shaft.
        membrane: Membrane to be punctured to enter the layer.
        tip_exponent: Power of the elastic part: 0.5 concave, 2 quadratic; the force at
            the end is the same.
        kept_fraction: Fraction of the tip force that stays when the needle leaves for a
            next layer.
        texture: Unevenness of the tip force, faded over a cutting onset at both ends.
        slips: Stick and slip of the cut, where the tip came in through a rupture.
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
    tip_exponent: float = 1.0
    kept_fraction: float = 0.0
    texture: Texture | None = None
    slips: StickSlip | None = None

    def __post_init__(self) -> None:
        require_positive(
            TissueError, self, "thickness_m exit_force_N release_m tip_exponent"
        )
        least_m = self.entry_m + CUTTING_ONSET_M + self.release_m
        if self.membrane is not None:
            least_m += self.membrane.release_m
        if self.thickness_m <= least_m:
            raise TissueError(
                f"layer {self.name!r} is {self.thickness_m} m thick, but indentation, "
                f"cutting onset and release take {least_m:.4g} m: make it thicker"
            )

    @property
    def entry_m(self) -> float:
        """Depth into the layer at which the tip begins to cut it.

        It is the indentation of the membrane.
        """
        return 0.0 if self.membrane is None else self.membrane.indentation_m

    @property
    def stiffness_N_per_m(self) -> float:
        """Slope of the elastic force from where the tip begins to cut to the far end.

        K = (1 - c) F_exit / (thickness - entry)
        """
        elastic_N = (1.0 - self.cutting_fraction) * self.exit_force_N
        return elastic_N / (self.thickness_m - self.entry_m)

    def tip_force_N(self, penetration_m: float) -> float:
        """Return the elastic and cutting force at the tip, not relaxed.

        With p the penetration as a fraction of the length to cut,

            F = F_exit ((1 - c) (p (1 + k p) / (1 + k))^n + c u (2 - u)) + texture,

        with c the cutting fraction, k the stiffening, n the exponent, and u the
        penetration over `CUTTING_ONSET_M`, at most 1.

        Args:
            penetration_m: Travel since the tip began to cut.
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
        depth_m: Depth in undeformed tissue.
        onset_m: Depth of the tip at which it begins to rupture.
        release_m: Travel over which the force is then released.
        drop_N: Force released, tissue not relaxed; zero at a bare surface.
        membrane: To be punctured there.
        kept_fraction: Fraction of `drop_N` that is not released at once but fades:
            layers hang together.
    """

    depth_m: float
    onset_m: float
    release_m: float
    drop_N: float
    membrane: Membrane | None
    kept_fraction: float = 0.0

    def held(self, deepest_m: float) -> float:
        """Return the fraction of the force that is still held, 1 to 0.

        Args:
            deepest_m: Largest depth that the tip has reached.
        """
        held = 1.0 - self.released(deepest_m)
        fade = max(1.0 - max(deepest_m - self.onset_m, 0.0) / KEPT_FADE_M, 0.0)
        return (1.0 - self.kept_fraction) * held + self.kept_fraction * fade * fade

    def released(self, deepest_m: float) -> float:
        """Return the fraction of the force that is released, 0 to 1.

        A crack starts fast and dies out: 1 - (1 - s)², s the travelled fraction of
        `release_m`.

        Args:
            deepest_m: Largest depth that the tip has reached.
        """
        travelled = min(max(deepest_m - self.onset_m, 0.0) / self.release_m, 1.0)
        remaining = 1.0 - travelled
        return 1.0 - remaining * remaining


def interfaces(layers: tuple[Layer, ...]) -> tuple[Interface, ...]:
    """Return all boundaries of a stack, from the surface to the exit.

    There is one more than layers, or none.
    """
    boundaries: list[Interface] = []
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
        kept_fraction = 0.0
        if i and below is not None:
            above = layers[i - 1]
            kept_fraction = above.kept_fraction * above.exit_force_N / drop
        boundaries.append(
            Interface(depth, onset, release, drop, membrane, kept_fraction)
        )
        depth += 0.0 if below is None else below.thickness_m
    return tuple(boundaries)
