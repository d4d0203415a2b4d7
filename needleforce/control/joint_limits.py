"""Limits of the joints, and the box of joint velocities that they leave for a tick."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Vector
from needleforce.control.errors import SettingError, require_positive
from needleforce.devices.arm_limits import ARM_LIMITS, ArmLimits
from urdf import Robot

SLACK_rad_s = 1e-7
"""Speeds and their changes stay this far inside, and a solver may exceed the box by
as much."""


class JointLimits(NamedTuple):
    """What each of n joints may do; arrays of shape (n,), read-only.

    Where the jerk is limited the acceleration is at most the jerk times a cycle: it can
    then end within a cycle, so that neither a stop nor a command that is lost, the one
    before held, exceeds the jerk.

    Attributes:
        position_lower_rad: Lowest position.
        position_upper_rad: Highest position.
        speed_rad_s: Highest speed, either way.
        acceleration_rad_s2: Highest acceleration, either way.
        jerk_rad_s3: Highest jerk, either way; infinite where none is limited.
    """

    position_lower_rad: Vector
    position_upper_rad: Vector
    speed_rad_s: Vector
    acceleration_rad_s2: Vector
    jerk_rad_s3: Vector


class Limits:
    """What the joints may do, checked against the robot's own limits.

    Args:
        robot: Its model names positions and speeds.
        velocity_rad_s: Slower speeds, one or one per joint; the robot's where None.
        acceleration_rad_s2: One or one per joint. A low one lengthens every stop.
        margin_rad: Kept from the position limits, for what moves the arm besides the
            command.
        jerk_rad_s3: One or one per joint; None for no limit. With a limit the
            acceleration is at most the jerk times a cycle, and positions are low-passed
            at 20 Hz about what was commanded, which keeps their noise out of it.
        tip_m_s: Highest speed of the tip; None for no limit.
        cycle_s: Time between two commands, over which a jerk counts.

    Attributes:
        joints: The limits of every joint, the margin and `SLACK_rad_s` subtracted.
        cycle_s: See above; None without a limit of the jerk, where a change counts over
            the time since the sample before.
        tip_m_s: See above.

    Raises:
        SettingError: A limit is missing, not positive, or above the robot's.
    """

    def __init__(
        self,
        robot: Robot,
        velocity_rad_s: ArrayLike | None = None,
        acceleration_rad_s2: ArrayLike = 10.0,
        margin_rad: float = 0.02,
        *,
        jerk_rad_s3: ArrayLike | None = None,
        tip_m_s: float | None = None,
        cycle_s: float = 1e-3,
    ) -> None:
        require_positive(
            {
                "cycle_s": cycle_s,
                "tip_m_s": 1.0 if tip_m_s is None else tip_m_s,
                "margin_rad": margin_rad,
            },
            or_zero=("margin_rad",),
        )
        self.tip_m_s = tip_m_s
        self.cycle_s = None if jerk_rad_s3 is None else cycle_s
        given = (
            robot.position_lower_rad + margin_rad,
            robot.position_upper_rad - margin_rad,
            robot.velocity_limit_rad_s if velocity_rad_s is None else velocity_rad_s,
            acceleration_rad_s2,
            np.inf if jerk_rad_s3 is None else jerk_rad_s3,
        )
        try:
            rows = [np.broadcast_to(np.asarray(row, float), robot.nv) for row in given]
        except (TypeError, ValueError):
            raise SettingError(
                f"limits must be one number or {robot.nv}, one per joint"
            ) from None
        limits = JointLimits(*np.array(rows))
        is_usable = (
            np.isfinite(limits[:4]).all(axis=0)
            & (limits.position_lower_rad < limits.position_upper_rad)
            & (limits.speed_rad_s > 0.0)
            & (limits.speed_rad_s <= robot.velocity_limit_rad_s)
            & (limits.acceleration_rad_s2 > 0.0)
            & (limits.jerk_rad_s3 > 0.0)
        )
        if not is_usable.all():
            raise SettingError(
                f"joints {', '.join(np.array(robot.joint_names)[~is_usable])}: "
                f"expected room beyond a margin of {margin_rad:g} rad from their ends, "
                "positive limits of speed, acceleration and jerk, and speeds not above "
                f"the robot's own, {robot.velocity_limit_rad_s.tolist()} rad/s",
            )
        limits.speed_rad_s[:] -= SLACK_rad_s
        if self.cycle_s is not None:
            # `SLACK_rad_s` is 0.1 rad/s3 at 1 kHz, arms round, and their clocks drift.
            limits.jerk_rad_s3[:] *= 0.98
            limits.acceleration_rad_s2[:] = np.minimum(
                0.98 * limits.acceleration_rad_s2, limits.jerk_rad_s3 * cycle_s
            )
        for values in limits:
            values.setflags(write=False)
        self.joints = limits

    @classmethod
    def of_arm(
        cls,
        robot: Robot,
        name: str | ArmLimits,
        *,
        speed_rad_s: float = 0.5,
        tip_m_s: float | None = 0.1,
    ) -> "Limits":
        """Return the limits of an arm that moves a needle, within `ARM_LIMITS`.

        Args:
            robot: Its model; a lower speed of its own counts.
            name: One of `ARM_LIMITS`, or limits of another arm.
            speed_rad_s: Highest speed of a joint; an arm's own where that is lower.
            tip_m_s: Highest speed of the tip; None for no limit.

        Raises:
            SettingError: The name is unknown, or the robot has other joints.
        """
        if isinstance(name, str) and name not in ARM_LIMITS:
            raise SettingError(
                f"no limits of an arm {name!r}, expected one of "
                f"{', '.join(ARM_LIMITS)}",
            )
        preset = ARM_LIMITS[name] if isinstance(name, str) else name
        joint_count = len(preset.speed_rad_s)
        if joint_count != robot.nv:
            raise SettingError(
                f"limits of {joint_count} joints ({name}), the robot has {robot.nv}",
            )
        return cls(
            robot,
            np.minimum(
                np.minimum(preset.speed_rad_s, speed_rad_s), robot.velocity_limit_rad_s
            ),
            preset.acceleration_rad_s2,
            jerk_rad_s3=preset.jerk_rad_s3,
            tip_m_s=tip_m_s,
            cycle_s=preset.cycle_s,
        )
