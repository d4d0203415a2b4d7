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
        lifecycle: Its lifecycle nodes.
        parameter: Its parameters.
        qos: Its qualities of service.
        task: Its futures.
        diagnostic: `diagnostic_msgs.msg`.
        geometry: `geometry_msgs.msg`.
        interfaces: `rcl_interfaces.msg`.
        parameter_services: `rcl_interfaces.srv`.
        sensor: `sensor_msgs.msg`.
        services: `std_srvs.srv`.
        standard: `std_msgs.msg`, which comes with `sensor_msgs`.
        transforms: `tf2_msgs.msg`; None where it is not installed.
    """

    rclpy: Any
    callback_groups: Any
    executors: Any
    lifecycle: Any
    parameter: Any
    qos: Any
    task: Any
    diagnostic: Any
    geometry: Any
    interfaces: Any
    parameter_services: Any
    sensor: Any
    services: Any
    standard: Any
    transforms: Any


OPTIONAL = ("tf2_msgs.msg",)
"""What a ROS 2 without its base packages lacks; rclpy alone has the others."""

_NAMES = RosModules(
    rclpy="rclpy",
    callback_groups="rclpy.callback_groups",
    executors="rclpy.executors",
    lifecycle="rclpy.lifecycle",
    parameter="rclpy.parameter",
    qos="rclpy.qos",
    task="rclpy.task",
    diagnostic="diagnostic_msgs.msg",
    geometry="geometry_msgs.msg",
    interfaces="rcl_interfaces.msg",
    parameter_services="rcl_interfaces.srv",
    sensor="sensor_msgs.msg",
    services="std_srvs.srv",
    standard="std_msgs.msg",
    transforms="tf2_msgs.msg",
)


def import_ros() -> RosModules:
    """Return the modules of the user's ROS 2.

    Raises:
        MissingRosError: One cannot be imported by this Python.
    """
    try:
        return RosModules(*map(_import, _NAMES))
    except ImportError as error:
        version = ".".join(map(str, sys.version_info[:2]))
        raise MissingRosError(
            f"the Python {version} that runs here cannot import ROS 2 ({error}); "
            "expected rclpy, sensor_msgs, geometry_msgs, diagnostic_msgs and std_srvs "
            "of a ROS 2 that is sourced"
        ) from error


def _import(name: str) -> Any:
    """Return a module; None for one that may be missing and is."""
    try:
        return import_module(name)
    except ImportError:
        if name not in OPTIONAL:
            raise
        return None


def import_lbr_state() -> Any:
    """Return `lbr_fri_idl.msg.LBRState` of lbr_fri_ros2_stack.

    Raises:
        MissingRosError: It cannot be imported by this Python.
    """
    try:
        return import_module("lbr_fri_idl.msg").LBRState
    except ImportError as error:
        raise MissingRosError(
            f"lbr_state_topic is given, and lbr_fri_idl cannot be imported ({error}); "
            "expected the workspace of lbr_fri_ros2_stack, sourced"
        ) from error
