"""The sensor that options describe, and what is read of a log for it."""

from functools import partial
from typing import NamedTuple

from needleforce.cli.logs.log_joints import find_log_joints
from needleforce.cli.logs.log_session import mapping_from_options
from needleforce.cli.logs.sensor_replay import SensorReplay
from needleforce.cli.logs.tare_schedule import parse_tare_window
from needleforce.cli.robot import robot_from_options, sensor_config, with_friction
from needleforce.cli.shared_options import JointColumns, RobotOptions, SensorOptions
from needleforce.cli.terminal import CommandError
from needleforce.recordings.channel_request import ChannelRequest
from urdf import Robot


def torque_channel(sensor: SensorOptions) -> str:
    """Return the channel of the torques that the sensor takes."""
    return "tau_ext" if sensor.external_torque else "tau"


class PreparedReplay(NamedTuple):
    """What is run over a log, and what is read of it.

    Attributes:
        replay: The sensor.
        request: Which channels are read.
    """

    replay: SensorReplay
    request: ChannelRequest


def robot_of_log(
    source: str,
    robot_options: RobotOptions,
    sensor: SensorOptions,
    columns: JointColumns,
) -> Robot:
    """Return the robot of the options; the log may say which joints it has."""
    mapping = mapping_from_options(columns)
    find_joints = partial(find_log_joints, source, mapping, torque_channel(sensor))
    return robot_from_options(robot_options, columns.mapping, find_joints)


def prepare(
    source: str,
    robot_options: RobotOptions,
    sensor: SensorOptions,
    columns: JointColumns,
) -> PreparedReplay:
    """Return the sensor that the options describe, and which channels it needs.

    Args:
        source: The log as the command line names it.
        robot_options: The robot.
        sensor: How joint signals become a force.
        columns: Which columns are which channels.

    Raises:
        CommandError: Options contradict each other, or the robot cannot be loaded.
    """
    robot = robot_of_log(source, robot_options, sensor, columns)
    _check_tare_options(sensor)
    robot, friction = with_friction(robot, sensor.friction)
    config = sensor_config(sensor, friction)
    request = ChannelRequest(
        mapping=mapping_from_options(columns),
        required=("q", torque_channel(sensor)),
        optional=("dq",),
        joints=robot.joint_names,
    )
    return PreparedReplay(SensorReplay(robot, config, sensor), request)


def _check_tare_options(sensor: SensorOptions) -> None:
    """Refuse options on the tare that are wrong, before a log is waited for."""
    if sensor.no_tare and (sensor.force_tare or sensor.tare is not None):
        option = "--tare" if sensor.tare is not None else "--force-tare"
        raise CommandError(
            f"{option} and --no-tare contradict each other, expected one of them"
        )
    if sensor.tare is not None:
        parse_tare_window(sensor.tare, 0.0)
