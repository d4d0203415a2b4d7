"""Named reports and forces as ROS 2 messages, and joint states read from them."""

from collections.abc import Iterable
from typing import Any

from foundation.arrays import Array
from needleforce.ros2.joint_samples import NS_PER_S, JointMessage
from needleforce.ros2.named_report import NamedReport
from needleforce.ros2.ros_modules import RosModules


def read_joint_state(message: Any) -> JointMessage:
    """Return what a `sensor_msgs/JointState` carries."""
    stamp = message.header.stamp
    return JointMessage(
        stamp_ns=stamp.sec * NS_PER_S + stamp.nanosec,
        names=tuple(message.name),
        position=message.position,
        velocity=message.velocity,
        effort=message.effort,
    )


def read_lbr_state(message: Any, joints: tuple[str, ...]) -> JointMessage:
    """Return what a `lbr_fri_idl/LBRState` carries: its external torques as efforts.

    It names no joints: they are in the order of KUKA's interface, A1 to A7. It has no
    velocities, and its stamp is of the controller's clock.

    Args:
        message: Whose fields are read by name, whatever its type.
        joints: Names of the arm's joints, in its order.
    """
    return JointMessage(
        stamp_ns=message.time_stamp_sec * NS_PER_S + message.time_stamp_nano_sec,
        names=joints,
        position=message.measured_joint_position,
        velocity=(),
        effort=message.external_torque,
    )


def fill_stamp(message: Any, stamp_ns: int) -> None:
    """Write the time stamp of a message's header."""
    stamp = message.header.stamp
    stamp.sec = stamp_ns // NS_PER_S
    stamp.nanosec = stamp_ns % NS_PER_S


def fill_vector(vector: Any, values: Array) -> None:
    """Write the components of a `geometry_msgs/Vector3`."""
    vector.x = float(values[0])
    vector.y = float(values[1])
    vector.z = float(values[2])


def report_array(
    ros: RosModules, reports: Iterable[NamedReport], stamp_ns: int, hardware: str
) -> Any:
    """Return reports as a `diagnostic_msgs/DiagnosticArray`.

    Args:
        ros: The modules of ROS 2.
        reports: One status each.
        stamp_ns: Of the header [ns].
        hardware: The arm.
    """
    message = ros.diagnostic.DiagnosticArray()
    fill_stamp(message, stamp_ns)
    message.status = [
        ros.diagnostic.DiagnosticStatus(
            # A constant of type `byte`, which Python has as bytes.
            level=bytes([report.level]),
            name=report.name,
            message=report.message,
            hardware_id=hardware,
            values=[
                ros.diagnostic.KeyValue(key=key, value=value)
                for key, value in report.values.items()
            ],
        )
        for report in reports
    ]
    return message
