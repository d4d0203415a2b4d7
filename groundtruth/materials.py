"""Every calibration number of the tissues, with its reason.

Friction. Table I gives the friction of the paper's three gels as the product B d,
measured over one constant and one sinusoidal speed profile: 113, 283, 534 Ns/m, for
layers 28.2, 37.7 and 32.2 mm thick (the authors' own gels). At 2.3 mm/s that is 0.26,
0.65 and 1.23 N.

Coulomb fraction. The two profiles of Table I pass the far end of a gel at 2.3 and about
3 mm/s and differ by 7-12 % of the mean: purely viscous friction would give the same B
at both, purely Coulomb friction B values 25-30 % apart. Two fifths Coulomb fit, and
leave after a sinusoidal exit the remaining force the paper describes (Fig. 9). Real
liver (de Jong 2017, 19 insertions at 5 mm/s to 85 mm, where the force is mostly
friction) loses 20 % within a second of the stop: four fifths Coulomb.

Relaxation. Over the 60 s hold the same recordings fall to 37 % of the force before the
stop (median), that is to 0.45 of the part that does not depend on speed. For the gels
there is no recording: it is assumed that a set gel creeps far less than tissue.

Presliding. On the reversal of the same recordings 63 % of the change is done after 0.9
mm.

Tip force. Fig. 8: the 70 % gel peaks at 2.5-3 N, half of it gone within a second after
the exit. 1.4 N at the tip and 1.23 N of friction make 2.6 N. The others follow with the
friction; a tenth of the tip force is cutting, the rest elastic, its chord 10 % steeper
at the end than at the start.
"""

from dataclasses import replace
from typing import Any

from groundtruth.layers import Layer, Membrane, ShaftFriction

# The paper's constant speed: at it, gel friction is Table I's.
TABLE_I_SPEED_M_S = 2.3e-3
TABLE_I_FRICTION_NS_PER_M = {25: 113.0, 50: 283.0, 70: 534.0}
"""B d of each gel (isinglass per cent), offline column."""
GEL_THICKNESS_M = {25: 28.2e-3, 50: 37.7e-3, 70: 32.2e-3}  # measured by the authors
GEL_TIP_FORCE_N = {25: 0.30, 50: 0.75, 70: 1.40}
"""At the far end of the gel; about as much as its friction at 2.3 mm/s, as in Fig.
8."""

# Median pull-out force per embedded length (de Jong 2017).
LIVER_FRICTION_N_PER_M = 10.6
# About that of the abdomen's sinusoid inside the tissue (4.6 to 7.2 mm/s).
ABDOMEN_SPEED_M_S = 6e-3


def _layer(
    name: str,
    thickness_m: float,
    exit_force_N: float,
    friction: ShaftFriction,
    **others: Any,
) -> Layer:
    """Return a layer of organic tissue, but for what ``others`` change."""
    usual: dict[str, Any] = {
        "cutting_fraction": 0.1,
        "stiffening": 0.1,
        "release_m": 0.5e-3,  # fibrous tissue ruptures more gradually than gel
        "relaxed_fraction": 0.55,
    }
    return Layer(
        name=name,
        thickness_m=thickness_m,
        exit_force_N=exit_force_N,
        friction=friction,
        **(usual | others),
    )


def gel(percent: int, *, membrane: Membrane | None = None) -> Layer:
    """Return one of the paper's gels, of 25, 50 or 70 %."""
    thickness = GEL_THICKNESS_M[percent]
    friction = ShaftFriction.calibrated(
        force_N_per_m=TABLE_I_FRICTION_NS_PER_M[percent]
        * TABLE_I_SPEED_M_S
        / thickness,
        reference_speed_m_s=TABLE_I_SPEED_M_S,
        coulomb_fraction=0.4,
        # A fraction of a needle diameter: gel sticks little to a wet shaft.
        presliding_m=0.2e-3,
    )
    return _layer(
        f"gel {percent} %",
        thickness,
        GEL_TIP_FORCE_N[percent],
        friction,
        release_m=0.3e-3,  # clean fracture of a brittle gel
        relaxed_fraction=0.2,
        membrane=membrane,
    )


def soft_tissue_friction(
    force_N_per_m: float, nominal_speed_m_s: float
) -> ShaftFriction:
    """Return friction of organic tissue, from its force at the recordings' 5 mm/s.

    At the nominal speed, the scenario's, the law of equation (3) shall agree.
    """
    measured = ShaftFriction.calibrated(
        force_N_per_m=force_N_per_m,
        reference_speed_m_s=5e-3,
        coulomb_fraction=0.8,
        presliding_m=0.9e-3,
    )
    return replace(measured, reference_speed_m_s=nominal_speed_m_s)


GLOVE = Membrane(puncture_N=1.0, indentation_m=4e-3, hardening=0.6, release_m=0.5e-3)
"""Latex of a glove under a blunt needle: around a newton, stretched by a few
millimetres."""

BOVINE_CAPSULE = Membrane(
    puncture_N=1.43, indentation_m=11.2e-3, hardening=1.0, release_m=0.5e-3
)
"""Okamura 2004: contact at 8 mm, puncture at 19.2 mm with 1.43 N, almost nothing
afterwards."""

# Synthetic skin around the liver of an abdominal phantom: thinner than a real capsule.
_PHANTOM_CAPSULE = Membrane(
    puncture_N=0.6, indentation_m=4e-3, hardening=0.5, release_m=0.4e-3
)
BOVINE_LIVER = _layer(
    "liver",
    32e-3,
    # Human liver peaks at 1.1-3.4 N over 85 mm, friction included: this is mid-range.
    0.9,
    soft_tissue_friction(LIVER_FRICTION_N_PER_M, TABLE_I_SPEED_M_S),
    membrane=BOVINE_CAPSULE,
)
"""A slice of bovine liver behind its capsule, 32 mm: 9 s from puncture to exit in
Fig. 13."""

_PHANTOM_LIVER = soft_tissue_friction(LIVER_FRICTION_N_PER_M, ABDOMEN_SPEED_M_S)
ABDOMEN = (
    # Slippery and soft; its end is the transition the paper's method misses (Fig. 14).
    _layer("fat", 25e-3, 0.12, soft_tissue_friction(4.0, ABDOMEN_SPEED_M_S)),
    # Fibres grip the shaft about twice as hard as liver does.
    _layer("muscle", 15e-3, 1.0, soft_tissue_friction(20.0, ABDOMEN_SPEED_M_S)),
    _layer("liver", 40e-3, 1.1, _PHANTOM_LIVER, membrane=_PHANTOM_CAPSULE),
)
"""Fat, muscle and liver of the abdominal phantom."""
