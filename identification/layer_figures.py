"""The figures of a layer that has been left, from the belief about its unknowns."""

from dataclasses import replace
from typing import Any

import numpy as np

from identification.estimate import LayerEstimate, Rupture
from identification.layer_ending import LayerEnding
from identification.layer_hindsight import Belief
from identification.layer_model import MM, OWN_COULOMB, OWN_VISCOUS, STIFFNESS

IDENTIFIED_SHARE = 0.25
"""A value is identified if its standard deviation is no more of it."""


def layer_estimate(
    rupture: Rupture, ending: LayerEnding, start_m: float, thickness_m: float, belief: Belief
) -> LayerEstimate:
    """What is known of a layer that has just been left.

    Args:
        rupture: Its end.
        ending: Forces on both sides of it.
        start_m: Where it begins.
        thickness_m: Its thickness.
        belief: About its unknowns.
    """
    return LayerEstimate(
        layer=rupture.layer,
        start_depth_m=start_m,
        thickness_m=thickness_m,
        rupture=rupture,
        force_drop_N=ending.drop_N,
        force_drop_std_N=ending.drop_std_N,
        **_figures(belief, thickness_m, rupture.speed_m_s),
    )


def revised(estimate: LayerEstimate, belief: Belief) -> LayerEstimate:
    """The same layer with a newer belief about its unknowns."""
    figures = _figures(belief, estimate.thickness_m, estimate.rupture.speed_m_s)
    return replace(estimate, **figures)


def _figures(belief: Belief, thickness_m: float, rupture_speed_m_s: float) -> dict[str, Any]:
    """Back to SI: c in N/m is 1e3 c in N/mm, b in Ns/m^2 is 1e6 b in N/(mm mm/s)."""
    values = np.maximum(belief.values, 0.0)
    std = np.sqrt(np.maximum(np.diag(belief.covariance), 0.0))
    speed = max(rupture_speed_m_s, 1e-6)
    row = np.zeros(6)
    row[OWN_COULOMB], row[OWN_VISCOUS] = MM * thickness_m, MM * thickness_m * MM * speed
    friction = max(float(row @ belief.values), 0.0)
    friction_std = float(np.sqrt(max(row @ belief.covariance @ row, 0.0)))
    stiffness, stiffness_std = MM * float(values[STIFFNESS]), MM * float(std[STIFFNESS])
    coulomb, coulomb_std = MM * float(values[OWN_COULOMB]), MM * float(std[OWN_COULOMB])
    viscous, viscous_std = 1e6 * float(values[OWN_VISCOUS]), 1e6 * float(std[OWN_VISCOUS])
    per_length = 1.0 / (thickness_m * speed)
    return {
        "stiffness_N_per_m": stiffness,
        "stiffness_std_N_per_m": stiffness_std,
        "stiffness_identified": is_identified(stiffness, stiffness_std),
        "friction_Ns_per_m2": friction * per_length,
        "friction_std_Ns_per_m2": friction_std * per_length,
        "friction_identified": is_identified(friction, friction_std),
        "friction_N": friction,
        "friction_std_N": friction_std,
        "coulomb_N_per_m": coulomb,
        "coulomb_std_N_per_m": coulomb_std,
        "coulomb_identified": is_identified(coulomb, coulomb_std),
        "viscous_Ns_per_m2": viscous,
        "viscous_std_Ns_per_m2": viscous_std,
        "viscous_identified": is_identified(viscous, viscous_std),
    }


def is_identified(value: float, std: float) -> bool:
    """Whether a value is known to within a quarter of itself."""
    return std <= IDENTIFIED_SHARE * abs(value)
