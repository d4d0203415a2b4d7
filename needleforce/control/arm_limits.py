"""Limits of arms by their names."""

from needleforce.control.errors import RIGHT_LIMITS, SettingError
from needleforce.devices.arm_limits import ARM_LIMITS, ArmLimits


def limits_of_arm(name: str) -> ArmLimits:
    """Return the preset of an arm.

    Raises:
        SettingError: No arm has that name.
    """
    if name not in ARM_LIMITS:
        raise SettingError(
            f"no limits of an arm {name!r}, expected one of {', '.join(ARM_LIMITS)}",
            RIGHT_LIMITS,
        )
    return ARM_LIMITS[name]
