"""The modules of the user's ROS 2: rclpy and the messages of the node."""

import sys
from importlib import import_module
from typing import Any, NamedTuple

from needleforce.ros2.errors import MissingRosError


class RosModules(NamedTuple):
    """Modules of ROS 2.

    Attributes:
        rclpy: The client library.
        callback_groups: What may run while a callback waits.
        executors: Its executors.
        parameter: Its parameters.
        qos: Its qualities of service.
        task: Its futures.
        diagnostic: `diagnostic_msgs.msg`.
        geometry: `geometry_msgs.msg`.
        interfaces: `rcl_interfaces.msg`.
        sensor: `sensor_msgs.msg`.
        services: `std_srvs.srv`.
    """

    rclpy: Any
    callback_groups: Any
    executors: Any
    parameter: Any
    qos: Any
    task: Any
    diagnostic: Any
    geometry: Any
    interfaces: Any
    sensor: Any
    services: Any


_NAMES = RosModules(
    rclpy="rclpy",
    callback_groups="rclpy.callback_groups",
    executors="rclpy.executors",
    parameter="rclpy.parameter",
    qos="rclpy.qos",
    task="rclpy.task",
    diagnostic="diagnostic_msgs.msg",
    geometry="geometry_msgs.msg",
    interfaces="rcl_interfaces.msg",
    sensor="sensor_msgs.msg",
    services="std_srvs.srv",
)


def import_ros() -> RosModules:
    """Return the modules of the user's ROS 2.

    Raises:
        MissingRosError: One cannot be imported by this Python.
    """
    try:
        return RosModules(*map(import_module, _NAMES))
    except ImportError as error:
        version = ".".join(map(str, sys.version_info[:2]))
        raise MissingRosError(
            f"the Python {version} that runs here cannot import ROS 2 ({error}); "
            "expected rclpy, sensor_msgs, geometry_msgs, diagnostic_msgs and std_srvs "
            "of a ROS 2 that is sourced"
        ) from error
