"""Friction of the joint bearings on the link side of the torque sensor.

Where it acts. The torque sensor sits between the gear and the link. The bearing that carries the
link runs beside it, from one link to the next, so its friction does not pass through the sensor:

    sensor torque + tissue torque + friction torque = M ddq + C dq + g,

with a friction torque against the joint's motion. The sensor therefore reads more torque in the
direction of motion than the rigid arm needs, and a momentum observer, which does not know of
friction, takes the friction torque for an external one: its residual moves AGAINST the motion and
changes sign with it. On a needle that goes in this looks like tissue that pushes back.

Why a bristle and not MuJoCo's ``frictionloss`` or a smoothed sign. An insertion turns the joints by
about 5 mrad/s and ends in rest, so everything happens near standstill. A smoothed sign holds
nothing at rest and is a stiff damper where the joints move; MuJoCo's constraint is regularised (a
loaded joint creeps), has no Stribeck peak and no presliding. The bristle of the LuGre model
(Canudas de Wit et al. 1995) holds a resting joint elastically, for ever, up to the Stribeck peak.
"""

import numpy as np
from numpy.typing import NDArray

from groundtruth.plant_model import PlantModel, drawn_factors

Array = NDArray[np.float64]

STRIBECK_PEAK = 1.5
"""Friction at the onset of sliding over that of fast sliding. Measured ratios of bearings and gears
of robots lie between 1 and 2; with 1.5 both figures published for the real arm are met at once."""
STRIBECK_SPEED_rad_s = 0.05
"""Speed over which the peak falls off. Chosen: above the joint speeds of an insertion (up to 0.01
rad/s), below those of the tare stroke (0.1 rad/s). So what a stroke in air shows of the friction is
less than what the insertion meets, which is the harder case for an estimator."""
PRESLIDING_rad = 1e-4
"""Rotation over which a bearing at rest begins to slide. Chosen: 5 um of rolling at a bearing
radius of 50 mm."""


class BearingFriction:
    """Friction torque of all joints, one physics step at a time."""

    def __init__(self, coulomb_Nm: Array, viscous_Nms_per_rad: Array) -> None:
        """Start at rest with no load on the bristles.

        Args:
            coulomb_Nm: Level of fast sliding per joint, shape (n,).
            viscous_Nms_per_rad: Part proportional to speed, shape (n,).
        """
        self._coulomb_Nm = coulomb_Nm
        self._viscous_Nms_per_rad = viscous_Nms_per_rad
        self._bristle = np.zeros_like(coulomb_Nm)  # in units of the Coulomb level

    def step(self, dq_rad_s: Array, dt_s: float) -> Array:
        """Advance by one step at a held speed and return the torque on the links, shape (n,).

        Exact for the held speed: the bristle closes on the sliding level with the rotation, whose
        sign it takes, so the torque can neither overshoot nor drive the joint.
        """
        speed = np.abs(dq_rad_s)
        level = 1.0 + (STRIBECK_PEAK - 1.0) * np.exp(-np.square(speed / STRIBECK_SPEED_rad_s))
        sliding = np.sign(dq_rad_s) * level
        left = np.exp(-speed * dt_s / (PRESLIDING_rad * level))
        self._bristle = sliding + (self._bristle - sliding) * left
        return -self._coulomb_Nm * self._bristle - self._viscous_Nms_per_rad * dq_rad_s


def drawn_friction(
    plant_model: PlantModel, limit_Nm: Array, rng: np.random.Generator
) -> BearingFriction | None:
    """The bearings of one arm; None on a plant model without friction.

    Args:
        plant_model: Gives the sizes and how far single joints are from them.
        limit_Nm: Effort limits, shape (n,).
        rng: Source of the factor of each joint.
    """
    viscous = np.array(plant_model.joint_viscous_Nms_per_rad)
    coulomb = plant_model.joint_coulomb * limit_Nm
    if not (coulomb.any() or viscous.any()):
        return None
    factors = drawn_factors(plant_model, limit_Nm.shape, rng)
    return BearingFriction(factors * coulomb, factors * viscous)
