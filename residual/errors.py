"""Errors of the `residual` package: one base, each leaf also a standard exception."""

from collections.abc import Iterable
from typing import Any

from foundation.errors import Alternative, CodedError, ErrorCode, StateCode
from residual.estimate import SensorWarning


def named_joints(indices: Iterable[int]) -> str:
    """Return joints as messages name them, ``joints 2, 4``, counted from 1.

    The columns of a log count likewise.
    """
    numbers = [str(int(i) + 1) for i in indices]
    return f"{'joint' if len(numbers) == 1 else 'joints'} {', '.join(numbers)}"


class SensorCode(ErrorCode):
    """Kinds of errors of the virtual sensor."""

    SETTING = (
        "NF-SENSOR-SETTING",
        "A setting of the sensor cannot work.",
        "Correct the field of `SensorConfig`, or the argument, that the message names.",
    )
    FRICTION = (
        "NF-SENSOR-FRICTION",
        "The friction model does not fit the robot's joints.",
        "Give `SensorConfig` a `friction` with one finite number for each joint.",
    )
    LIMITS = (
        "NF-SENSOR-LIMITS",
        "The robot's effort limits are too small to be torques.",
        "Correct the effort limits in the robot's description; 0 where one is unknown.",
    )
    PINOCCHIO = (
        "NF-SENSOR-PINOCCHIO",
        "The installed Pinocchio keeps its intermediate results in another layout.",
        "Install a version of Pinocchio that the package's requirements name.",
    )
    SAMPLE = (
        "NF-SENSOR-SAMPLE",
        "A sample is not usable: wrong shape, not finite, or not in SI units.",
        "Skip the sample and go on; the state has not changed.",
    )
    CLOCK = (
        "NF-SENSOR-CLOCK",
        "The time step of a sample cannot be: not positive, not finite, or a day long.",
        "Skip the sample and go on with the next time step; if it recurs, repair the "
        "clock.",
    )
    SPIKE = (
        "NF-SENSOR-SPIKE",
        "A signal jumped further than an arm can.",
        "Skip the sample; if it recurs, check the cables and the sensor.",
    )
    FROZEN = (
        "NF-SENSOR-FROZEN",
        "Noisy signals of all joints repeat bit for bit.",
        "Check the sensors and the connection to the robot.",
    )
    SATURATED = (
        "NF-SENSOR-SATURATED",
        "A joint torque is at its effort limit.",
        "Unload the arm, or correct the effort limits in the robot's description.",
    )
    MIXED = (
        "NF-SENSOR-MIXED",
        "One stream mixes two kinds of signals.",
        "Keep to `update` or to `update_external_torque`, and to velocities or none; "
        "or call `start_tare_recording` or `reset` first.",
    )
    CONTACT = (
        "NF-SENSOR-CONTACT",
        "A force is seen in what should be motion without contact.",
        "Move in free air, then call `tare` again; `tare(ignore_contact=True)` takes "
        "it as it is.",
    )
    GRAVITY_MISSING = (
        "NF-SENSOR-GRAVITY-MISSING",
        "The torques seem to have gravity removed already.",
        "Set `torque_is_gravity_compensated=True`; `tare(ignore_contact=True)` tares "
        "as it is.",
    )
    GRAVITY_TWICE = (
        "NF-SENSOR-GRAVITY-TWICE",
        "Gravity seems to be added to torques that contain it.",
        "Set `torque_is_gravity_compensated=False`; `tare(ignore_contact=True)` tares "
        "as it is.",
    )
    TORQUE_SIGN = (
        "NF-SENSOR-TORQUE-SIGN",
        "The torques seem to have the opposite sign, of all joints or of some.",
        "Multiply `tau` by {factors}; `tare(ignore_contact=True)` tares as it is.",
    )
    TORQUE_SCALE = (
        "NF-SENSOR-TORQUE-SCALE",
        "The torques are a multiple of those that gravity asks for.",
        "Multiply `tau` by {factors}, once you know why; `tare(ignore_contact=True)` "
        "tares as it is.",
    )
    GRAVITY_DIRECTION = (
        "NF-SENSOR-GRAVITY-DIRECTION",
        "Gravity seems to point elsewhere than was given.",
        "Load the robot with `gravity_m_s2` {gravity}; `tare(ignore_contact=True)` "
        "tares as it is.",
    )
    TORQUE_KIND = (
        "NF-SENSOR-TORQUE-KIND",
        "Measured torques were given where external ones were expected.",
        "Call `update` instead of `update_external_torque`.",
    )
    TORQUE_KIND_SIGN = (
        "NF-SENSOR-TORQUE-KIND-SIGN",
        "Measured torques of opposite sign were given instead of external ones.",
        "Negate them and call `update` instead of `update_external_torque`.",
    )
    JOINT_ORDER = (
        "NF-SENSOR-JOINT-ORDER",
        "The torques of some joints seem to be exchanged.",
        "Give the torques in the order of `Robot.joint_names`: {order} of what was "
        "given.",
    )
    POSITIONS = (
        "NF-SENSOR-POSITIONS",
        "The positions of some joints never change while others move.",
        "Check that `q` holds every joint; if these joints do rest, tare without "
        "contact.",
    )
    PAYLOAD = (
        "NF-SENSOR-PAYLOAD",
        "The robot's model has too much or too little mass at the flange.",
        "Correct the hand, the tool and the `payload` of the robot (on the flange: "
        "{payload}); `identify_payload_static` estimates it.",
    )
    NO_FREE_MOTION = (
        "NF-SENSOR-NO-FREE-MOTION",
        "Too little motion without contact was recorded for a tare.",
        "Call `update` in free air first, in steps no longer than `max_gap_s`, then "
        "`tare`.",
    )
    TARED_ALREADY = (
        "NF-SENSOR-TARED-ALREADY",
        "A tare was asked for twice with nothing recorded in between.",
        "Call `start_tare_recording`, move in free air, then call `tare` again.",
    )
    VELOCITY = (
        "NF-SENSOR-VELOCITY",
        "The measured velocities are not the rate of the measured positions.",
        "Correct the units, signs, order or delay of `dq`, then move in free air anew; "
        "`tare(ignore_contact=True)` tares as it is.",
    )
    VELOCITY_MISSING = (
        "NF-SENSOR-VELOCITY-MISSING",
        "The measured velocities stand still while the positions move.",
        "Pass `dq=None` in every sample, and velocities are estimated from `q`; "
        "`tare(ignore_contact=True)` tares as it is.",
    )


class ResidualError(CodedError):
    """Base of every error that `residual` raises."""

    usual_code = SensorCode.SETTING


class ConfigurationError(ResidualError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""


class SampleError(ResidualError, ValueError):
    """A sample that must not be used: wrong shape, not finite, or time not advancing.

    The state of the object that raises it is as before the call.

    Attributes:
        warning: Of valid numbers that are no measurement, why: a spike, a frozen or a
            saturated torque.
    """

    usual_code = SensorCode.SAMPLE

    def __init__(
        self,
        message: str,
        code: ErrorCode = SensorCode.SAMPLE,
        warning: SensorWarning = SensorWarning.NONE,
    ) -> None:
        super().__init__(message, code)
        self.warning = warning


class TareError(ResidualError, RuntimeError):
    """A tare that would be wrong.

    There are no data, a contact is in sight, torques are of another kind, or velocities
    are not rates of positions.

    Args:
        message: As of `CodedError`, like ``code`` and ``places``.
        code: Kind of the error.
        alternatives: Causes that would explain it as well.
        diagnosis: What the motion shows of the torques, a `TorqueDiagnosis`; None where
            they were not looked at.
    """

    usual_code = SensorCode.CONTACT

    def __init__(
        self,
        message: str = "",
        code: ErrorCode | None = None,
        *,
        alternatives: tuple[Alternative, ...] = (),
        diagnosis: Any = None,
        **places: str,
    ) -> None:
        self.alternatives = alternatives
        self.diagnosis = diagnosis
        super().__init__(message, code, **places)


class VelocityError(TareError):
    """A tare with measured velocities that are not the rate of the positions."""

    usual_code = SensorCode.VELOCITY


class SnapshotError(ResidualError, ValueError):
    """A snapshot that cannot be restored here: the message says what it is of."""

    usual_code = StateCode.DAMAGED
