"""The sensor that options describe, and what is read of a log for it."""

import math
from functools import partial

from needleforce.cli.logs.log_joints import find_log_joints
from needleforce.cli.logs.log_session import mapping_from_options
from needleforce.cli.robot import robot_from_options, sensor_config, with_friction
from needleforce.cli.shared_options import JointColumns, RobotOptions, SensorOptions
from needleforce.cli.terminal import CHOOSE_TARE, CommandError
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.sensor_replay import SensorReplay, TareWindow
from urdf import Robot


def torque_channel(sensor: SensorOptions) -> str:
    """Return the channel of the torques that the sensor takes."""
    return "tau_ext" if sensor.external_torque else "tau"


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
) -> tuple[SensorReplay, ChannelRequest]:
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
    find_window = None
    if sensor.tare is not None:
        find_window = partial(parse_tare_window, sensor.tare)
    replay = SensorReplay(
        robot,
        config,
        is_external=sensor.external_torque,
        is_tared=not sensor.no_tare,
        find_window=find_window,
        ignore_contact=sensor.force_tare,
    )
    return replay, request


def _check_tare_options(sensor: SensorOptions) -> None:
    """Refuse options on the tare that are wrong, before a log is waited for."""
    if sensor.no_tare and (sensor.force_tare or sensor.tare is not None):
        option = "--tare" if sensor.tare is not None else "--force-tare"
        raise CommandError(
            f"{option} and --no-tare contradict each other, expected one of them"
        )
    if sensor.tare is not None:
        parse_tare_window(sensor.tare, 0.0)


def parse_tare_window(text: str, first_s: float) -> TareWindow:
    """Return the window that ``--tare`` names.

    Args:
        text: Value of the option, START:END.
        first_s: Time of the log's first row [s].

    Raises:
        CommandError: The text names no window.
    """
    start, colon, end = text.partition(":")
    if not colon:
        raise CommandError(f"--tare {text}: expected START:END", CHOOSE_TARE)
    start_s = _parse_log_time(text, start, first_s) if start.strip() else first_s
    end_s = _parse_log_time(text, end, first_s)
    return TareWindow(start_s, end_s, name=f"--tare {text}")


def _parse_log_time(option: str, text: str, first_s: float) -> float:
    """Return a time on the log's clock [s]; after a + it counts from the first row."""
    try:
        time_s = float(text)
    except ValueError:
        time_s = math.nan
    if not math.isfinite(time_s):
        raise CommandError(
            f"--tare {option}: {text!r} is no time, expected START:END",
            CHOOSE_TARE,
        )
    return first_s + time_s if text.strip().startswith("+") else time_s
