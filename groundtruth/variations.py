"""Tissues outside the law that our mixture estimator assumes, each with its source.

A catalogued layer has a nearly linear tip force that is released altogether within
half a millimetre, friction in proportion to the embedded length, no texture, and a cut
that does not slip. The estimator expects such a layer first, others with smaller
priors. A variation changes one of these in every layer, and nothing else.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from groundtruth.layers import Layer, StickSlip, Texture


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueVariation:
    """Differences of each layer; every default leaves the layer as it is.

    Attributes:
        texture_N: Standard deviation of a texture of the tip force.
        release_m: Travel of a rupture's release, membranes included.
        tip_exponent: Power of the elastic tip force over penetration.
        cutting_fraction: Constant cutting force in the tip force.
        kept_fraction: Fraction of the tip force that stays after an internal rupture,
            fading over 5 mm.
        length_exponent: Power of the embedded length with which friction grows.
        speed_exponent: Power of the speed with which all friction grows: no Coulomb
            part.
        friction_fraction: Fraction of friction in the force at the end of a layer,
            which stays the same.
        slip_N: The largest drop of the cut's stick and slip; the least is a third.
    """

    texture_N: float = 0.0
    release_m: float | None = None
    tip_exponent: float = 1.0
    cutting_fraction: float | None = None
    kept_fraction: float = 0.0
    length_exponent: float = 1.0
    speed_exponent: float = 1.0
    friction_fraction: float | None = None
    slip_N: float = 0.0

    def layer(self, layer: Layer, rng: np.random.Generator) -> Layer:
        """Return the layer under this variation, texture and slips drawn.

        `TissueError` if the layer is too thin.
        """
        friction = layer.friction
        tip_N = layer.exit_force_N
        coulomb = friction.coulomb_N_per_m
        viscous = friction.viscous_Ns_per_m2
        if self.speed_exponent != 1.0:
            coulomb = 0.0
            viscous = friction.equivalent_viscous_Ns_per_m2
        if self.friction_fraction is not None:
            shaft_N = (
                friction.sliding_N_per_m(friction.reference_speed_m_s)
                * layer.thickness_m
            )
            scale = self.friction_fraction * (shaft_N + tip_N) / shaft_N
            coulomb = scale * coulomb
            viscous = scale * viscous
            tip_N += (1.0 - scale) * shaft_N
        friction = replace(
            friction,
            coulomb_N_per_m=coulomb,
            viscous_Ns_per_m2=viscous,
            length_exponent=self.length_exponent,
            speed_exponent=self.speed_exponent,
        )
        change: dict[str, Any] = {"tip_exponent": self.tip_exponent}
        if self.texture_N:
            # It is correlated over half a millimetre.
            change["texture"] = Texture.drawn(self.texture_N, 0.5e-3, rng)
        if self.slip_N:
            cut_m = layer.thickness_m - layer.entry_m
            change["slips"] = StickSlip.drawn(self.slip_N, cut_m, rng)
        if self.cutting_fraction is not None:
            change["cutting_fraction"] = self.cutting_fraction
        if self.release_m is not None:
            membrane = layer.membrane and replace(
                layer.membrane, release_m=self.release_m
            )
            change |= {"release_m": self.release_m, "membrane": membrane}
        change |= {
            "friction": friction,
            "exit_force_N": tip_N,
            "kept_fraction": self.kept_fraction,
        }
        return replace(layer, **change)


# "Liver": 19 insertions into real liver at 5 mm/s to 85 mm (de Jong 2017). "Barnett":
# needles in tissue ex vivo (Barnett, Lee, Moore 2015): 61 % of the force tears, 18
# spreads, 21 is friction.
VARIATIONS = {
    # Liver: 15 to 19 mN within 3 mm.
    "texture-15mN": TissueVariation(texture_N=15e-3),
    "texture-20mN": TissueVariation(texture_N=20e-3),
    # Liver: falls of the force take 0.5 to 2 mm.
    "release-1mm": TissueVariation(release_m=1e-3),
    "release-2mm": TissueVariation(release_m=2e-3),
    # Chosen: a channel that yields the more the deeper the tip.
    "concave": TissueVariation(tip_exponent=0.5),
    # Okamura, Simone, O'Leary 2004: second-order spring of bovine liver.
    "quadratic": TissueVariation(tip_exponent=2.0),
    # Barnett: 61 of 61 + 18 % of the tip force are cutting.
    "plateau": TissueVariation(cutting_fraction=0.77),
    # Liver: 2.5 falls inside one organ. That force stays, and how much, is chosen.
    "kept-30": TissueVariation(kept_fraction=0.3),
    "kept-60": TissueVariation(kept_fraction=0.6),
    # Liver: pull-out over insertion force falls from 0.95 at 20 mm to 0.65 at 78 mm:
    # friction with length^0.7, where the insertion force grows with the length.
    "length-0.6": TissueVariation(length_exponent=0.6),
    # Table I: from 2.3 to 3 mm/s the gels' friction rises by 7 to 12 %: speed^0.25 to
    # ^0.43.
    "speed-0.3": TissueVariation(speed_exponent=0.3),
    # Barnett: 21 %. Liver: 65 to 95 %.
    "friction-20": TissueVariation(friction_fraction=0.2),
    "friction-75": TissueVariation(friction_fraction=0.75),
    # Chosen: drops of 0.05 to 0.15 N every 0.3 to 2 mm, which a force sensor of 10 mN
    # sees as clearly as small ruptures.
    "stick-slip": TissueVariation(slip_N=0.15),
}
"""One change at a time, by name."""


def random_variation(rng: np.random.Generator) -> TissueVariation:
    """Draw the law of one layer within the ranges of the variations but stick-slip.

    A plateau, kept force and a power law of speed are kinds, not degrees: one layer in
    four, in two, in four has them.
    """
    # Arguments are drawn in this order: another order gives other tissues for the same
    # seed.
    return TissueVariation(
        texture_N=rng.uniform(1e-3, 20e-3),
        release_m=float(np.exp(rng.uniform(*np.log((0.1e-3, 2e-3))))),
        tip_exponent=2.0 ** rng.uniform(-1.0, 1.0),
        cutting_fraction=rng.uniform(0.2, 0.8)
        if rng.random() < 0.25
        else rng.uniform(0.0, 0.2),
        kept_fraction=rng.uniform(0.3, 0.6) if rng.random() < 0.5 else 0.0,
        length_exponent=rng.uniform(0.6, 1.0),
        speed_exponent=0.3 if rng.random() < 0.25 else 1.0,
        friction_fraction=rng.uniform(0.2, 0.75),
    )
