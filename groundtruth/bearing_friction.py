"""Friction of the joint bearings, on the link side of the torque sensor.

The sensor sits between gear and link; the bearing that carries the link runs beside it, from link
to link, so its friction does not pass through the sensor:

    sensor torque + tissue torque + friction torque = M ddq + C dq + g.

The friction torque is against the joint's motion. The sensor reads that much more torque along the
motion than a rigid arm needs, and a momentum observer takes the friction torque for an external
one: while a needle goes in it looks like tissue that pushes back, and it changes sign on the way
out.

An insertion turns the joints by 5 mrad/s and ends in rest, so standstill decides. MuJoCo's
``frictionloss`` creeps under load and has no Stribeck peak; the bristle of the LuGre model (Canudas
de Wit et al. 1995) holds a joint at rest elastically, for ever, up to the peak.
"""

import numpy as np

from groundtruth.errors import Array
from groundtruth.plant_model import PlantModel, drawn_factors

STRIBECK_PEAK = 1.5
"""Friction at the onset of sliding over that of fast sliding. Chosen; with it one Coulomb level
meets both errors published for the real arm."""
STRIBECK_SPEED_rad_s = 0.05
"""Speed over which the peak falls off. Chosen between the joint speeds of an insertion (0.005
rad/s) and of the tare stroke (0.1 rad/s): the stroke in air shows less friction than the insertion
meets."""
PRESLIDING_rad = 1e-4
"""Rotation over which a bearing begins to slide. Chosen: 5 um at a bearing radius of 50 mm."""


def bearings(
    plant_model: PlantModel, limit_Nm: Array, rng: np.random.Generator
) -> "BearingFriction | None":
    """The bearings of an arm with these effort limits, shape (n,); None without friction."""
    if plant_model.joint_coulomb == 0.0 and not any(plant_model.joint_viscous_Nms_per_rad):
        return None
    return BearingFriction(plant_model, limit_Nm, rng)


class BearingFriction:
    """Friction torque of all joints, one physics step at a time, from rest without load."""

    def __init__(self, plant_model: PlantModel, limit_Nm: Array, rng: np.random.Generator) -> None:
        """Draw the bearings of an arm with these effort limits, shape (n,)."""
        factors = drawn_factors(plant_model, limit_Nm.shape, rng)
        self._coulomb_Nm = factors * plant_model.joint_coulomb * limit_Nm
        self._viscous_Nms = factors * np.array(plant_model.joint_viscous_Nms_per_rad)
        self._bristle = np.zeros_like(limit_Nm)  # in units of the Coulomb level

    def step(self, dq_rad_s: Array, dt_s: float) -> Array:
        """Advance at a held speed, exactly, and return the torque on the links, shape (n,)."""
        speed = np.abs(dq_rad_s)
        level = 1.0 + (STRIBECK_PEAK - 1.0) * np.exp(-np.square(speed / STRIBECK_SPEED_rad_s))
        sliding = np.sign(dq_rad_s) * level
        left = np.exp(-speed * dt_s / (PRESLIDING_rad * level))
        self._bristle = sliding + (self._bristle - sliding) * left
        return -self._coulomb_Nm * self._bristle - self._viscous_Nms * dq_rad_s
