"""What is believed about a layer before its rupture: rows added to the normal equations."""

import numpy as np

from identification.default_config import DefaultConfig
from identification.layer_model import (
    CUTTING,
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    STIFFNESS,
    Information,
    add_row,
)
from identification.tear import NOTHING_HELD, Held

_LEAST_SLOPE = 1e-4


def add_layer_prior(
    information: Information,
    own_N: float,
    layer_depth_m: float,
    speed_m_s: float,
    config: DefaultConfig,
    held: Held = NOTHING_HELD,
) -> Information:
    """Add the priors on shares, scaled by the force the layer has built up so far.

    At constant speed nothing in a layer tells its stiffness from its friction, nor Coulomb from
    viscous: without these rows the answer would be arbitrary, with them it is a stated guess with
    a stated standard deviation that any rupture or change of speed overrides. Cutting counts with
    the elastic force: friction has its share of both.

    Args:
        information: Data and earlier friction.
        own_N: Axial force less the friction of earlier layers, now.
        layer_depth_m: Travel in the layer.
        speed_m_s: Usual speed.
        config: Settings.
        held: Tip force that the layer began with, see `tear`.
    """
    depth, speed = max(MM * layer_depth_m, 1e-3), MM * max(abs(speed_m_s), config.rest_speed_m_s)
    slope = max(own_N / depth, _LEAST_SLOPE)
    rho, kappa = config.friction_share, config.coulomb_share(speed / MM)
    row = np.zeros(6)
    row[CUTTING], row[STIFFNESS] = -rho / depth, -rho
    row[OWN_COULOMB], row[OWN_VISCOUS] = 1.0 - rho, (1.0 - rho) * speed
    kept = -rho * held.mean_N / depth
    information = add_row(information, row, kept, (config.friction_share_std * slope) ** 2)
    row = np.zeros(6)
    row[OWN_COULOMB], row[OWN_VISCOUS] = 1.0 - kappa, -kappa * speed
    information = add_row(
        information, row, 0.0, (config.coulomb_share_std(speed / MM) * rho * slope) ** 2
    )
    row = np.zeros(6)
    row[CUTTING] = 1.0
    reach = MM * config.cutting_reach_m * slope
    return add_row(information, row, held.mean_N, reach * reach + held.variance)
