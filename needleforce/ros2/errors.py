"""The errors of this package."""

from foundation.errors import CodedError, ErrorCode


class Ros2Code(ErrorCode):
    """Kinds of errors of the ROS 2 node."""

    MISSING = (
        "NF-ROS2-MISSING",
        "This Python cannot import rclpy or a message of ROS 2.",
        "Source your ROS (`source /opt/ros/DISTRO/setup.bash`) and use its Python: "
        "`python3 -m venv --system-site-packages`; docs/how-to/ros2.md.",
    )
    PARAMETER = (
        "NF-ROS2-PARAMETER",
        "A parameter of the node is unknown, or has a value that cannot be.",
        "Give what the message expects: `-p NAME:=VALUE` after `--ros-args`, or a "
        "parameter file.",
    )


class Ros2Error(CodedError):
    """Base of all errors of this package."""

    usual_code = Ros2Code.PARAMETER


class MissingRosError(Ros2Error, ImportError):
    """ROS 2 is not there for this Python; the message says what is missing."""

    usual_code = Ros2Code.MISSING


class Ros2ParameterError(Ros2Error, ValueError):
    """A parameter that is unknown or cannot be; the message says what is expected."""
