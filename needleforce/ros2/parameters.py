"""The parameters of the node, as rclpy declares, checks and describes them."""

# pyright: reportMissingImports=false

from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException

from needleforce.ros2.errors import Ros2ParameterError

PARAMETERS: dict[str, tuple[bool | int | float | str, ParameterDescriptor]] = {
    "external_torque_topic": (
        "",
        ParameterDescriptor(
            description="Topic of JointState whose effort is the arm's own estimate of "
            "the external torque [Nm], with the stamps of joint_states; empty to use "
            "the measured torque in the effort of joint_states."
        ),
    ),
    "joint_pattern": (
        "",
        ParameterDescriptor(
            description="Pattern that the names of the arm's joints fit, such as "
            "left_*, where two arms are on the topic; empty for any."
        ),
    ),
    "frame_id": (
        "",
        ParameterDescriptor(
            description="Frame named in wrenches, at the needle's tip with z along the "
            "needle; empty for the tool frame of the robot's description."
        ),
    ),
    "gain_per_s": (
        70.0,
        ParameterDescriptor(
            description="Gain K of the momentum observer [1/s]; the force lags by 1/K.",
            floating_point_range=[FloatingPointRange(from_value=1.0, to_value=500.0)],
        ),
    ),
    "gravity_compensated": (
        False,
        ParameterDescriptor(
            description="Whether the driver has already subtracted gravity from effort."
        ),
    ),
    "queue_depth": (
        1000,
        ParameterDescriptor(
            description="Joint states that wait for the node before the oldest is "
            "lost.",
            integer_range=[IntegerRange(from_value=1, to_value=100_000, step=1)],
        ),
    ),
    "reliable": (
        False,
        ParameterDescriptor(
            description="Whether joint states that are lost are asked for again; then "
            "only reliable publishers are heard."
        ),
    ),
    "autostart": (
        True,
        ParameterDescriptor(
            description="Whether the node configures and activates itself at the "
            "start; false where a lifecycle manager does."
        ),
    ),
    "tare_recording_s": (
        4.0,
        ParameterDescriptor(
            description="Free motion that is recorded before a second tare [s].",
            floating_point_range=[FloatingPointRange(from_value=1.0, to_value=60.0)],
        ),
    ),
    "silence_s": (
        0.08,
        ParameterDescriptor(
            description="Time without a joint state of the arm after which the node "
            "reports silence [s].",
            floating_point_range=[FloatingPointRange(from_value=0.01, to_value=60.0)],
        ),
    ),
}
"""Defaults and descriptions; the robot is described by options of the command."""

CHANGEABLE = "silence_s"
"""The parameter that may be changed while the node runs."""


def declare_parameters(node: Any) -> None:
    """Declare the parameters of a node.

    Args:
        node: Whose parameters that were given are declared already, whatever they are.

    Raises:
        Ros2ParameterError: One is unknown, of another type, or out of its range.
    """
    own = ("use_sim_time", "start_type_description_service", "qos_overrides.")
    for name in node.get_parameters_by_prefix(""):
        if name in PARAMETERS:
            node.undeclare_parameter(name)
        elif not name.startswith(own):
            raise Ros2ParameterError(
                f"there is no parameter {name}; expected one of {', '.join(PARAMETERS)}"
            )
    for name, (default, descriptor) in PARAMETERS.items():
        descriptor.read_only = name != CHANGEABLE
        try:
            node.declare_parameter(name, default, descriptor)
        except ParameterException as error:
            raise Ros2ParameterError(f"{name}: {error}") from error
