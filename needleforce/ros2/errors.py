"""The errors of this package."""

import sys
from importlib import import_module

from foundation.errors import NeedleforceError


class Ros2Error(NeedleforceError):
    """Base of all errors of this package."""


class MissingRosError(Ros2Error, ImportError):
    """ROS 2 is not there for this Python; the message says what is missing."""

    usual_advice = (
        "Source the setup file of your ROS 2, and use the Python that it was built "
        "for; docs/how-to/ros2.md says how."
    )


class Ros2ParameterError(Ros2Error, ValueError):
    """A parameter that is unknown or cannot be; the message says what is expected."""


def require_ros(*modules: str) -> None:
    """Find out whether this Python can import ROS 2.

    Args:
        modules: Names of modules; none for those that the node and the arm need.

    Raises:
        MissingRosError: It cannot.
    """
    usual = ("rclpy", "sensor_msgs.msg", "geometry_msgs.msg", "diagnostic_msgs.msg")
    for name in modules or (*usual, "std_srvs.srv"):
        try:
            import_module(name)
        except ImportError as error:
            raise MissingRosError(
                f"Python {sys.version.split()[0]} cannot import {name} of ROS 2 "
                f"({error})"
            ) from error
