"""Errors of `needleforce.control`: one base, and one that is also a `ValueError`."""

from foundation.errors import CodedError, ErrorCode
from foundation.extras import install_command


class ControlCode(ErrorCode):
    """Kinds of errors of the control of an arm."""

    SETTING = (
        "NF-CONTROL-SETTING",
        "A setting or an argument of the control cannot work.",
        "Give what the message expects, in SI units.",
    )
    LIMITS = (
        "NF-CONTROL-LIMITS",
        "The joint limits do not fit the robot, or contradict each other.",
        "Give `JointLimits` one number for each joint, the lower below the upper.",
    )
    TARGET = (
        "NF-CONTROL-TARGET",
        "The target does not lie ahead on the needle's line.",
        "Align the needle with the plan first.",
    )
    FRAME = (
        "NF-CONTROL-FRAME",
        "The session's needle is not along z of the robot's tool frame.",
        "Load the robot with a `tool_frame` whose z axis is the needle.",
    )
    LAG = (
        "NF-CONTROL-LAG",
        "The delay of the arm cannot be measured.",
        "Let the arm take commands, with nothing touching it, away from its limits.",
    )
    TARE_STROKE = (
        "NF-CONTROL-TARE-STROKE",
        "The arm has not made the motion before the tare.",
        "Let the arm take commands, in free air, with room for a stroke and a swivel.",
    )
    EVENT_LOG = (
        "NF-CONTROL-EVENT-LOG",
        "A log of events cannot be written or read.",
        "Give a file that `EventLog` wrote, and data that JSON can hold.",
    )
    LIBRARY = (
        "NF-CONTROL-LIBRARY",
        "A log of events needs a library that is not installed.",
        f"Install it: {install_command('recordings')}.",
    )


class ControlError(CodedError):
    """Base of the errors of this package; those of the estimators pass through."""

    usual_code = ControlCode.SETTING


class SettingError(ControlError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""
