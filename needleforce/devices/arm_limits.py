"""Limits that arms enforce on commands of joint velocity: presets, with their source.

An arm that is sent more stops itself, a Franka with a reflex. Where a vendor publishes
no acceleration or jerk the values are ours, and say so.
"""

import math
from typing import NamedTuple


class PositionStops(NamedTuple):
    """Stops, and the speed that an arm allows at a distance r before them.

        |dq| <= sqrt(2 D r) - O

    Attributes:
        lower_rad: Lowest position of each joint.
        upper_rad: Highest position.
        deceleration_rad_s2: D; infinite where the distance does not count.
        offset_rad_s: O.
    """

    lower_rad: tuple[float, ...]
    upper_rad: tuple[float, ...]
    deceleration_rad_s2: tuple[float, ...] = (math.inf,) * 7
    offset_rad_s: tuple[float, ...] = (0.0,) * 7


class ArmLimits(NamedTuple):
    """What an arm accepts; tuples of one number per joint.

    Attributes:
        speed_rad_s: Highest speed.
        acceleration_rad_s2: Highest acceleration.
        jerk_rad_s3: Highest jerk.
        cycle_s: Time between two commands.
        source: Where the numbers come from; ``ours`` for those that no vendor
            publishes.
        stops: Positions that the arm enforces; None for those of a model.
    """

    speed_rad_s: tuple[float, ...]
    acceleration_rad_s2: tuple[float, ...]
    jerk_rad_s3: tuple[float, ...]
    cycle_s: float
    source: str
    stops: PositionStops | None = None


def limits_with_our_rates(
    speed_rad_s: tuple[float, ...], cycle_s: float, source: str
) -> ArmLimits:
    """Return limits with acceleration and jerk of the FR3: no vendor publishes them."""
    joints = len(speed_rad_s)
    return ArmLimits(
        speed_rad_s,
        acceleration_rad_s2=(10.0,) * joints,
        jerk_rad_s3=(5000.0,) * joints,
        cycle_s=cycle_s,
        source=f"speed: {source}; acceleration and jerk: ours",
    )


FR3 = ArmLimits(
    speed_rad_s=(2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26),
    acceleration_rad_s2=(10.0,) * 7,
    jerk_rad_s3=(5000.0,) * 7,
    cycle_s=1e-3,
    source="libfranka 0.21, rate_limiting.h; speed: its highest, far from the stops; "
    "stops: limit and position_based_velocity_limits of the FR3's own URDF",
    stops=PositionStops(
        lower_rad=(-2.9007, -1.8361, -2.9007, -3.077, -2.8763, 0.4398, -3.0508),
        upper_rad=(2.9007, 1.8361, 2.9007, -0.1169, 2.8763, 4.6216, 3.0508),
        deceleration_rad_s2=(6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0),
        offset_rad_s=(0.652, 0.25, 0.2005, 0.3542, 0.5738, 0.4885, 0.4592),
    ),
)

FER = ArmLimits(
    speed_rad_s=(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
    acceleration_rad_s2=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
    jerk_rad_s3=(7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
    cycle_s=1e-3,
    source="libfranka 0.9, rate_limiting.h, without its margin for lost packets",
)

UR5E = limits_with_our_rates((3.14,) * 6, 2e-3, "UR5e data sheet, 180 degrees/s")

IIWA14 = limits_with_our_rates(
    (1.48, 1.48, 1.74, 1.30, 2.26, 2.35, 2.35), 1e-3, "LBR iiwa 14 R820 data sheet"
)

LWR4PLUS = limits_with_our_rates(
    (1.91, 1.91, 2.23, 2.23, 3.56, 3.21, 3.21),
    1e-3,
    "LWR 4+ data sheet, 110 to 204 degrees/s",
)

ARM_LIMITS = {
    "fr3": FR3,
    "fer": FER,
    "ur5e": UR5E,
    "iiwa14": IIWA14,
    "lwr": LWR4PLUS,
}
"""The presets by name."""
