"""The errors of this package."""

from foundation.errors import CodedError, ErrorCode


class Ros2Code(ErrorCode):
    """Kinds of errors of the ROS 2 node."""

    MISSING = (
        "NF-ROS-MISSING",
        "This Python cannot import rclpy or a message of ROS 2.",
        "Source the setup file of your ROS 2, and use the Python that it was built "
        "for; docs/how-to/ros2.md says how.",
    )
    PARAMETER = (
        "NF-ROS-PARAMETER",
        "A parameter of the node is unknown, or has a value that cannot be.",
        "Give what the message expects.",
    )


class Ros2Error(CodedError):
    """Base of all errors of this package."""

    usual_code = Ros2Code.PARAMETER


class MissingRosError(Ros2Error, ImportError):
    """ROS 2 is not there for this Python; the message says what is missing."""

    usual_code = Ros2Code.MISSING


class Ros2ParameterError(Ros2Error, ValueError):
    """A parameter that is unknown or cannot be; the message says what is expected."""
